"""The error budget: each source changes one thing, and only that, of a bench without errors.

The sessions and their estimates are replaced: the chain behind them has tests of its own.
"""

from dataclasses import fields, replace

import numpy as np
import pytest
from lab.planned_sessions import planned_session

from palpate.errors import InputError
from palpate.geometry import closest_points
from palpate.lab import Calibration, Material, Sensor, Variant, read_lab_config
from palpate.lab.config_files import built_in
from palpate.paper import budget
from palpate.paper.budget import SourceErrors, budget_picture, budget_table, sizes_table
from palpate.paper.constants import constant_errors
from palpate.pipeline import with_pictures_measured
from palpate.records import Constant, DisplacementField, ProbeEstimate, read_rig, read_session

NAMES = [
    "none", "image noise", "tip misalignment", "tip placement", "mesh size", "nonlinearity",
    "force noise", "calibration", "registration", "table 3",
]  # fmt: skip


@pytest.fixture(scope="module")
def config():
    return read_lab_config(built_in()["half-ball"])


@pytest.fixture
def session(tmp_path):
    return read_session(planned_session(tmp_path))


def changed(first, other, prefix=""):
    """Names of the parts in which two configurations differ, by their numbers."""
    names = set()
    for field in fields(first):
        a, b = getattr(first, field.name), getattr(other, field.name)
        if hasattr(a, "__dataclass_fields__") and field.name not in ("mesh", "body"):
            names |= changed(a, b, f"{prefix}{field.name}.")
        elif not (a is b or np.array_equal(a, b)):
            names.add(f"{prefix}{field.name}")
    return names


def with_displacements(session):
    """The session with some displacement of its vertices."""
    point = session.mesh.vertices
    field = DisplacementField(
        points=point, displacement=np.zeros_like(point), std=None, vertex=None,
        surface=closest_points(session.mesh, point), source="none",
    )  # fmt: skip
    probings = tuple(replace(probing, displacement=field) for probing in session.probings)
    return replace(session, probings=probings)


def test_what_was_measured_is_not_measured_again(session):
    known = with_displacements(session)
    # Other forces over the same pictures: nothing is left to measure.
    forces = budget._with_forces(known, Sensor(noise=0.01), np.random.default_rng(1))
    assert with_pictures_measured(forces, pose="given") is forces
    # There are no pictures in this folder.
    with pytest.raises(InputError, match="rest_c0"):
        with_pictures_measured(session, pose="given")


def test_where_it_begins_no_error_is_left(config):
    noisy = replace(
        config,
        calibration=Calibration(1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
        force_sensor=Sensor(1.0, 1.0, np.ones(3), 1.0),
        pictures=replace(config.pictures, full_well=1e4, gain_drift=0.1),
        material=replace(config.material, law="neo-hookean"),
    )
    exact = budget._exact(noisy)
    assert changed(exact.calibration, Calibration()) == set()
    assert changed(exact.force_sensor, Sensor()) == set()
    assert (exact.arm.misalignment, exact.arm.placement) == (0.0, 0.0)
    pictures = exact.pictures
    assert (pictures.noise, pictures.full_well, pictures.gain_drift) == (0.0, None, 0.0)
    assert exact.material.law == "linear"
    assert (exact.arm.tip, exact.arm.radius) == (config.arm.tip, config.arm.radius)


def bench(config, name):
    """The bench that has this source's error alone."""
    return next(source.bench for source in budget._sources(config) if source.name == name)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("none", set()),
        ("image noise", {"pictures.noise"}),
        ("tip misalignment", {"arm.misalignment"}),
        ("tip placement", {"arm.placement"}),
        ("mesh size", {"specimen.mesh"}),
        ("nonlinearity", {"material.law"}),
    ],
)
def test_a_source_changes_one_thing_only(config, name, parts):
    assert changed(bench(config, name), budget._exact(config)) == parts


def test_the_last_source_is_the_bench_itself(config):
    last = budget._sources(config)[-1]
    assert last.name == "table 3"
    assert last.bench is config


def test_the_coarse_mesh_is_of_the_same_body(config):
    coarse = bench(config, "mesh size").specimen
    fine = config.specimen
    assert len(fine.mesh.vertices) / len(coarse.mesh.vertices) == pytest.approx(4.0, rel=0.25)
    # Vertices of both lie on the ball of 40 mm or on its base.
    away = np.linalg.norm(coarse.mesh.vertices, axis=1)
    on_ball = np.isclose(away, 0.04, atol=1e-9)
    assert (on_ball | (np.abs(coarse.mesh.vertices[:, 2]) < 1e-12)).all()
    assert coarse.body is fine.body
    assert coarse.held is fine.held


def test_forces_are_read_with_the_sensors_noise(session):
    sensor = Sensor(noise=0.01)
    errors = []
    for seed in range(300):
        disturbed = budget._with_forces(session, sensor, np.random.default_rng(seed))
        for probing, true in zip(disturbed.probings, session.probings, strict=True):
            np.testing.assert_allclose(probing.force_std, 0.01)
            errors.append(probing.force - true.force)
    # 1800 numbers: their deviation is known to 1 / sqrt(3600), 1.7 %; four times that.
    assert np.std(errors) == pytest.approx(0.01, rel=0.07)
    assert (session.probings[0].force == [0, 0, -0.5]).all()


def test_the_misjudged_rig_is_another_file_and_the_true_one_stays(session, tmp_path):
    before = session.rig.read_bytes()
    file = tmp_path / "misjudged.toml"
    known = with_displacements(session)
    misjudged = budget.with_misjudged_rig(
        known, np.random.default_rng(1), file, error=Calibration(centre=2.0)
    )
    assert misjudged.rig == file
    # What the first rig saw of the motion is not what this one would have seen.
    assert all(probing.displacement is None for probing in misjudged.probings)
    assert session.rig.read_bytes() == before
    off = [
        camera.matrix[:2, 2] - true.matrix[:2, 2]
        for camera, true in zip(read_rig(file).cameras, read_rig(session.rig).cameras, strict=True)
    ]
    assert np.abs(off).min() > 0.0
    assert 0.5 < np.std(off) < 5.0


def test_errors_are_against_the_truth():
    truth = Material(52e3, 0.21)
    shear, nu, young = (
        Constant(value, 0.1, (0.9 * value, 1.1 * value))
        for value in (1.01 * truth.shear_modulus, 0.23, 0.97 * 52e3)
    )
    probe = ProbeEstimate("n01", shear, nu, young, 9, 0, 0, 1e-5, None)
    np.testing.assert_allclose(constant_errors([probe, probe], truth), [[0.02, 0.01, -0.03]] * 2)


def test_every_source_has_its_sessions_and_draws(config, tmp_path, monkeypatch):
    made, rigs = [], []

    def make(wanted, *, variant, progress, parts, distribute):
        assert distribute is map
        progress("making", 1.0)
        for wanted_bench, folder in wanted:
            made.append((wanted_bench, folder.name))
            planned_session(folder)

    def errors(session, truth, parts):
        rigs.append(session.rig.name)
        assert truth is config.material
        return np.zeros((2, 3)), np.zeros((1, 3))

    monkeypatch.setattr(budget, "make_sessions", make)
    monkeypatch.setattr(budget, "_errors", errors)
    monkeypatch.setattr(budget, "with_pictures_measured", lambda session, pose, parts: session)
    said, variant, parts = [], Variant("none", "", None), tmp_path / "parts"
    for name in ("first", "again"):
        (tmp_path / name).mkdir()
    sources = budget.error_budget(
        config, tmp_path / "first", variant=variant, draws=3, parts=parts,
        progress=lambda text, share: said.append(share),
    )  # fmt: skip
    # What was finished is not estimated again.
    count = len(rigs)
    again = budget.error_budget(config, tmp_path / "again", variant=variant, draws=3, parts=parts)
    assert [source.name for source in again] == NAMES
    assert len(rigs) == count == 16
    del made[7:]
    assert [source.name for source in sources] == NAMES
    assert [len(source.joint) for source in sources] == [1] * 6 + [3] * 3 + [1]
    assert len(made) == 7
    assert said == sorted(said)
    assert said[-1] < 1.0
    assert rigs[:9] == ["rig.toml"] * 9
    assert len(set(rigs[9:15])) == 6


# As a table and a picture

NONE = SourceErrors("none", "", np.array([[0.01, 0.0, 0.03], [-0.01, 0.0, 0.04]]),
                   np.array([[0.002, 0.0, -0.01]]))  # fmt: skip
FORCE = SourceErrors("force noise", "1 N", np.array([[0.02, 0.0, -0.06]]),
                    np.array([[0.003, 0.0, 0.03], [-0.004, 0.0, 0.04]]))  # fmt: skip


def _row(table, number):
    return dict(zip(table.columns, table.rows[number], strict=True))


def test_means_and_root_mean_squares_of_single_and_joint_errors():
    table = budget_table([NONE, FORCE])
    none, force = _row(table, 0), _row(table, 1)
    assert (none["source"], force["source"]) == ("none", "force noise")
    assert sizes_table([NONE, FORCE]).rows[1] == ("force noise", "1 N")
    assert (none["draws"], force["draws"]) == (1, 2)
    assert none["E mean (%)"] == pytest.approx(3.5)
    assert none["E rms (%)"] == pytest.approx(100 * np.sqrt((0.03**2 + 0.04**2) / 2))
    assert none["nu mean"] == pytest.approx(0.0)
    assert none["nu rms"] == pytest.approx(0.01)
    assert none["all: E rms (%)"] == pytest.approx(1.0)
    assert force["E mean (%)"] == pytest.approx(-6.0)
    assert force["all: E rms (%)"] == pytest.approx(100 * np.sqrt((0.03**2 + 0.04**2) / 2))
    assert force["all: nu rms"] == pytest.approx(np.sqrt((0.003**2 + 0.004**2) / 2))


def test_a_larger_error_has_a_longer_bar():
    def inked(factor):
        longer = SourceErrors("a", "", factor * FORCE.single, FORCE.joint)
        widest = SourceErrors("b", "", 4.0 * FORCE.single, FORCE.joint)
        picture = budget_picture([NONE, longer, widest]).astype(int)
        # The bars' pale blue.
        return int((np.abs(picture[..., :3] - [0xC9, 0xE2, 0xF2]).max(axis=2) < 3).sum())

    # None's bars and the widest one's stay: twice the middle one's is its own length more.
    first, second, third = inked(1.0), inked(2.0), inked(3.0)
    assert second - first == pytest.approx(third - second, rel=0.05)
    assert second - first > 1000
