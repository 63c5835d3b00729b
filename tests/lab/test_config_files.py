"""Configurations: what is read, and one clear message for what is not."""

import numpy as np
import pytest
from lab.lab_configs import HALF_BALL, STAGE

from palpate.errors import RecordError
from palpate.geometry import enclosed_volume, write_mesh
from palpate.lab import Arm, Calibration, Head, Pictures, read_lab_config
from palpate.lab.config_files import built_in
from palpate.lab.specimens import block


@pytest.fixture
def read(tmp_path):
    """Reads a text as a configuration."""

    def reader(text):
        file = tmp_path / "config.toml"
        file.write_text(text)
        return read_lab_config(file)

    return reader


def test_a_configuration_is_read_whole(read):
    config = read(HALF_BALL)
    assert (config.name, config.seed) == ("small half ball", 3)
    assert config.material.young_modulus == 52e3
    assert config.arm == Arm(radius=6e-3, misalignment=2.0)
    assert (config.head.columns, config.head.rows, config.head.distance) == (200, 160, 0.5)
    assert config.pictures == Pictures(samples=8)
    assert config.calibration == Calibration()
    (probe,) = config.probes
    assert (probe.name, probe.depth, probe.force, probe.steps) == ("n01", 4e-3, None, 2)
    np.testing.assert_array_equal(probe.point, [0.0, 0.0, 0.04])
    # The flat face, and nothing else, is held.
    body = config.specimen.body
    assert (np.abs(body.vertices[body.triangles[config.specimen.held]][:, :, 2]) < 1e-12).all()
    ball = 2.0 / 3.0 * np.pi * 0.04**3
    lost = [1.0 - enclosed_volume(mesh) / ball for mesh in (config.specimen.mesh, body)]
    # What is pressed is rounder than its mesh, nine times by the square of the edge.
    assert lost[1] < lost[0] / 6.0
    assert config.specimen.element == 0.01


def test_a_stage_needs_no_probes_and_defaults_are_the_papers(read):
    config = read(STAGE)
    assert config.probes == ()
    assert (config.stage.steps, config.stage.rotation) == (2, 3.0)
    assert config.seed == 1
    assert Head().layout == "trinocular"
    assert (Head().distance, Head().columns, Head().rows) == (0.8, 640, 480)


def test_a_mesh_of_ones_own(read, tmp_path):
    mesh = block(length=0.05, width=0.04, height=0.03, edge=0.01)
    write_mesh(tmp_path / "own.ply", mesh)
    shape = 'shape = "half-ball"\nradius = 0.04\nedge = 0.008\nelement = 0.01'
    with_own_mesh = HALF_BALL.replace(shape, 'mesh = "own.ply"').replace("0.04]", "0.03]")
    config = read(with_own_mesh + "[support]\nbox = { min = [-1, -1, -1], max = [1, 1, 1e-6] }\n")
    np.testing.assert_allclose(config.specimen.mesh.vertices, mesh.vertices, atol=1e-9)
    assert len(config.specimen.held) == 2 * 5 * 4
    # By default elements are as large as the mesh's triangles: an equilateral one of that area.
    assert config.specimen.element == pytest.approx(np.sqrt(0.5e-4 * 4 / np.sqrt(3)), rel=1e-6)


def test_a_rig_of_ones_own_lies_beside_the_configuration(read, tmp_path):
    config = read(HALF_BALL.replace("[head]\n", '[head]\nfile = "rig.toml"\n'))
    assert config.head.file == str(tmp_path / "rig.toml")
    elsewhere = str(tmp_path.parent / "rig.toml")
    config = read(HALF_BALL.replace("[head]\n", f'[head]\nfile = "{elsewhere}"\n'))
    assert config.head.file == elsewhere


def test_a_support_on_springs_is_the_base_unless_said_otherwise_and_the_session_gets_it(read):
    rigid, springs = read(HALF_BALL), read(HALF_BALL + '[support]\nstiffness = "20 kPa/mm"\n')
    assert rigid.specimen.support_stiffness is None
    assert springs.specimen.support_stiffness == 20e6
    np.testing.assert_array_equal(springs.specimen.held, rigid.specimen.held)
    assert springs.specimen.support == {**rigid.specimen.support, "stiffness": 20e6}


@pytest.mark.parametrize("name", built_in())
def test_built_in_configurations_are_sound_and_say_what_they_are(name):
    file = built_in()[name]
    config = read_lab_config(file)
    assert file.read_text().startswith("# ")
    assert bool(config.probes) != (config.stage is not None)
    assert len(config.probes) == {"half-ball": 17, "demo": 3}.get(name, len(config.probes))


BAD = [
    (
        "[look]",
        "[support]\nstiffness = -1.0\n[look]",
        r"\[support\] stiffness: is -1 N/m\^3; must be positive",
    ),
    (
        "poisson_ratio = 0.21",
        'poisson_ratio = 0.21\nlaw = "neo-hookean"\n[support]\nstiffness = 1e6',
        r"objects on springs are linear",
    ),
    ("palpate-lab/1", "palpate-lab/2", r"format: is 'palpate-lab/2'; must be 'palpate-lab/1'"),
    ("[look]", "[looks]", r"unknown key 'looks'; did you mean 'look'"),
    ('"half-ball"', '"half-bal"', r"\[specimen\] shape: is 'half-bal'; did you mean 'half-ball'"),
    ("radius = 0.04", "radius = -1.0", r"\[specimen\]: radius is -1 m; must be positive"),
    ("edge = 0.008", "edges = 0.008", r"\[specimen\]: unknown key 'edges'; did you mean 'edge'"),
    ("element = 0.01", "element = 0", r"\[specimen\] element: is 0 m; must be positive"),
    ("poisson_ratio = 0.21", "poisson_ratio = 0.5", r"\[material\]: poisson_ratio is 0.5"),
    ("young_modulus = 52e3", 'law = "linear"', r"\[material\]: the key 'young_modulus' is miss"),
    ("size = 4e-3", 'texture = "speckles"', r"\[look\] texture: is 'speckles'; did you mean 'spec"),
    ("size = 4e-3", "size = 4e-3\ngloss = 2", r"\[look\]: gloss is 2; must be in 0 to 1"),
    ("misalignment = 2.0", "misalignment = -2.0", r"\[arm\]: misalignment is -2; must be 0 to 45"),
    ("noise = 0.002", 'noise = "much"', r"\[force_sensor\] noise: is 'much'; must be a finite num"),
    ("noise = 0.002", "bias = [0, 1]", r"\[force_sensor\] bias: is \[0, 1\]; must be three finite"),
    ("columns = 200", "columns = 20", r"\[head\]: columns is 20; must be 32 to 20000 px"),
    ("columns = 200", "columns = 200.5", r"\[head\] columns: is 200.5; must be a whole number"),
    ("columns = 200", "toward = [0, 0, 0]", r"\[head\]: toward is .*; must be a dir"),
    ("columns = 200", "focal = 0", r"\[head\]: focal is 0; must be 1 to 1e[+]06 px"),
    ("columns = 200", "cameras = 5", r"\[head\]: cameras is 5; must be 2, 3 or 4"),
    ("samples = 8", "full_well = 0", r"\[pictures\]: full_well is 0; must be positive"),
    ("samples = 8", "noise = -1", r"\[pictures\]: noise is -1; must be 0 to 255"),
    ("samples = 8", "response = -0.1", r"\[pictures\]: response is -0.1; must be 0 to 100"),
    ("samples = 8", "bits = 10", r"\[pictures\]: bits is 10; must be 8 or 12"),
    ("depth = 4e-3", "", r"\[\[probe\]\]: 'n01' needs a depth or a force, one of them"),
    ("depth = 4e-3", "depth = 4e-3\nforce = 1", r"\[\[probe\]\]: 'n01' needs a depth or a force"),
    ("steps = 2", "steps = 0", r"\[\[probe\]\]: steps is 0; must be 1 to 1000"),
    ("seed = 3", "seed = -1", r"seed is -1; must be 0 to 2\^32 - 1"),
    ("seed = 3", "seed = true", r"seed: is True; must be a whole number"),
    ("steps = 2", "steps = 2\n[stage]\nsteps = 1", r"give \[\[probe\]\] tables or a \[stage\]"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "text"), BAD)
def test_a_wrong_configuration_gets_one_clear_message(read, old, new, text):
    assert old in HALF_BALL
    with pytest.raises(RecordError, match=text):
        read(HALF_BALL.replace(old, new))


def test_twins_are_refused(read):
    probe = HALF_BALL[HALF_BALL.index("[[probe]]") :]
    with pytest.raises(RecordError, match="probing 'n01': there are files named 'n01' already"):
        read(HALF_BALL + probe)


def test_neither_probe_nor_stage_is_refused(read):
    with pytest.raises(RecordError, match="one of them"):
        read(HALF_BALL[: HALF_BALL.index("[[probe]]")])
