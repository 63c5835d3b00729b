"""Sessions that the standard reader reads, nothing lost, with a truth that holds."""

import pickle
import tomllib
from dataclasses import replace

import cv2
import numpy as np
import pytest
from lab.lab_configs import HALF_BALL, STAGE
from scipy.spatial.transform import Rotation

from palpate.errors import InputError, MeshError
from palpate.lab import (
    Sensor,
    choose_variant,
    facility,
    make_session,
    make_sessions,
    read_lab_config,
)
from palpate.lab.config import Stage
from palpate.lab.facility import probe_tables, step_tables, write_session
from palpate.records import Sphere, read_rig, read_session
from palpate.solids import Press, Tip
from palpate.solids.finite_elements import make_body
from palpate.vision import project, read_pictures


@pytest.fixture(scope="module")
def together(tmp_path_factory):
    """Folders of sessions that were made in one go, by name, how many bodies that took, and the
    configurations."""
    folders, configs, bodies = {}, {}, []
    for name, text in (("ball", HALF_BALL), ("toy", STAGE)):
        file = tmp_path_factory.mktemp(name) / "config.toml"
        file.write_text(text)
        configs[name], folders[name] = read_lab_config(file), file.parent / "out"
    # Pictures of a sixteenth of the pixels, of sessions that are made once more or compared only.
    small = replace(configs["ball"].head, columns=50, rows=40)
    configs["small"] = replace(configs["ball"], head=small)
    configs["other"] = replace(configs["small"], seed=4)
    for name in ("small", "other"):
        folders[name] = folders["ball"].parent / name
    for folder in folders.values():
        folder.mkdir()

    def counted(*arguments, **options):
        bodies.append(make_body(*arguments, **options))
        return bodies[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("palpate.lab.arm.make_body", counted)
        wanted = [(config, folders[name]) for name, config in configs.items()]
        make_sessions(wanted, variant=choose_variant())
    return folders, len(bodies), configs


@pytest.fixture(scope="module")
def made(together):
    """Folder by name of the configuration."""
    return together[0]


class _Killed(BaseException):
    """The process ends."""


def test_an_interrupted_measurement_goes_on_to_the_same_bytes(tmp_path, monkeypatch):
    # Pictures of a sixteenth of the pixels: rendering them is most of the work.
    text = STAGE.replace("columns = 200", "columns = 50").replace("rows = 160", "rows = 40")
    (tmp_path / "config.toml").write_text(text)
    plan = read_lab_config(tmp_path / "config.toml")
    variant, parts = choose_variant(), tmp_path / "parts"

    def killed_in_the_last(stage, _):
        if stage == f"step s{plan.stage.steps}":
            raise _Killed

    for name in ("whole", "first", "second"):
        (tmp_path / name).mkdir()
    make_session(plan, tmp_path / "whole", variant=variant)
    with pytest.raises(_Killed):
        make_session(
            plan, tmp_path / "first", variant=variant, progress=killed_in_the_last, parts=parts
        )
    taken = []
    real = facility.photograph
    monkeypatch.setattr(facility, "photograph", lambda *a, **k: (taken.append(1), real(*a, **k))[1])
    make_session(plan, tmp_path / "second", variant=variant, parts=parts)
    assert len(taken) == 1
    whole = tmp_path / "whole"
    names = sorted(path.relative_to(whole) for path in whole.rglob("*.*"))
    # Pictures of three instants, at least.
    assert len(names) > 3 * (plan.stage.steps + 1)
    for name in names:
        assert (tmp_path / "second" / name).read_bytes() == (whole / name).read_bytes()
    # Another seed finds nothing of it.
    (tmp_path / "third").mkdir()
    make_session(replace(plan, seed=99), tmp_path / "third", variant=variant, parts=parts)
    assert len(taken) == 1 + plan.stage.steps + 1


@pytest.mark.parametrize("kind", ["toy", pytest.param("small", marks=pytest.mark.slow)])
def test_distributed_work_gives_the_same_bytes(made, together, tmp_path, kind):
    """What travels to another process and back, in any order, is all that a session needs."""
    taken = []

    def sent(function, items):
        sent_items = pickle.loads(pickle.dumps((function, list(items))))
        function, items = sent_items
        results = [function(item) for item in reversed(items)]
        taken.extend(items)
        return iter(pickle.loads(pickle.dumps(results[::-1])))

    config = together[2][kind]
    make_session(config, tmp_path, variant=choose_variant(), distribute=sent)
    assert len(taken) == (len(config.probes) if config.stage is None else config.stage.steps + 1)
    names = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.*"))
    assert len(names) > 6
    for name in names:
        assert (tmp_path / name).read_bytes() == (made[kind] / name).read_bytes()


def _truth(folder):
    return tomllib.loads((folder / "truth.toml").read_text())


def test_a_probed_specimen_is_an_ordinary_session(made):
    session = read_session(made["ball"])
    (probing,) = session.probings
    assert session.notes == ()
    assert len(session.held_triangles) > 20
    assert (probing.contact.tool.shape, probing.contact.tool.radius) == ("sphere", 6e-3)
    np.testing.assert_array_equal(probing.contact.point, [0.0, 0.0, 0.04])
    assert len(probing.images.loaded) == 2
    rig = read_rig(session.rig)
    for pattern in (probing.images.rest, *probing.images.loaded):
        grey = read_pictures(rig, pattern, folder=made["ball"], what="it").grey
        assert all(picture.shape == (160, 200) for picture in grey)
        # Lit, not saturated, and full of contrast.
        assert all(150 < picture.max() < 255 and picture[picture > 20].std() > 30
                   for picture in grey)  # fmt: skip


def test_readings_are_the_truth_with_the_sensors_noise(made):
    (probing,) = read_session(made["ball"]).probings
    (truth,) = _truth(made["ball"])["probe"]
    force = np.array(truth["force"])
    assert np.abs(probing.force - force).max() < 5 * 0.002
    assert (probing.force != force).all()
    travel = truth["depth"] * np.array(truth["direction"])
    assert np.abs(probing.tip_displacement - travel).max() < 5 * 5e-5
    np.testing.assert_allclose(probing.force_std, 0.002)
    np.testing.assert_allclose(probing.tip_displacement_std, 5e-5)


def test_truth_is_that_of_an_elastic_ball_under_a_round_tip(made):
    truth = _truth(made["ball"])
    (probe,) = truth["probe"]
    assert (truth["young_modulus"], truth["poisson_ratio"]) == (52e3, 0.21)
    assert truth["shear_modulus"] == pytest.approx(52e3 / 2.42)
    direction, force = np.array(probe["direction"]), np.array(probe["force"])
    # Straight down but for two degrees of misalignment about each axis, and free of friction.
    assert 0.0 < np.degrees(np.arccos(-direction[2])) < 8.0
    assert force @ direction > 0.99 * np.linalg.norm(force)
    # Hertz for a sphere of 6 mm on one of 40 mm: 4/3 E* sqrt(R) d^1.5, R = 1 / (1/6 + 1/40) mm.
    # The held base stiffens, and elements of 1 mm find some of it only.
    both = 1.0 / (1.0 / 6e-3 + 1.0 / 40e-3)
    hertz = 4.0 / 3.0 * 52e3 / (1.0 - 0.21**2) * np.sqrt(both) * 4e-3**1.5
    assert np.linalg.norm(force) == pytest.approx(hertz, rel=0.15)
    assert probe["contact_radius"] == pytest.approx(np.sqrt(both * 4e-3), rel=0.2)
    assert probe["load_steps"] == [0.5, 1.0]
    # Where it was sent: the arm is not misplaced, only turned.
    np.testing.assert_allclose(probe["contact_point"], [0.0, 0.0, 0.04], atol=1e-6)


def test_truth_map_moves_what_the_camera_sees(made):
    content = np.load(made["ball"] / "truth_n01.npz")
    rig = read_rig(made["ball"] / "rig_true.toml")
    pixel = np.stack([content["pixel"] % 200, content["pixel"] // 200], axis=1)
    assert content["shape"].tolist() == [160, 200]
    np.testing.assert_allclose(
        project(rig.cameras[0], content["X"].astype(float)), pixel, atol=0.01
    )
    # Down under the tip, and nowhere more than the tip went.
    assert 1e-3 < np.linalg.norm(content["U"], axis=1).max() < 4.3e-3
    assert content["U"][:, 2].mean() < 0.0
    assert ((content["hidden_loaded"] & 1) > 0).sum() > 20


def test_pictures_move_by_the_truth(made):
    """Independent of the flow of this program: OpenCV's dense optical flow."""
    content = np.load(made["ball"] / "truth_n01.npz")
    rig = read_rig(made["ball"] / "rig_true.toml")
    rest, loaded = (
        cv2.imread(str(made["ball"] / "images" / f"{name}_c0.png"), 0) for name in ("rest", "n01")
    )
    engine = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    engine.setFinestScale(0)
    flow = engine.calc(rest, loaded, None).reshape(-1, 2)[content["pixel"]]
    point = content["X"].astype(float)
    there = project(rig.cameras[0], point + content["U"])
    truth = there - project(rig.cameras[0], point)
    open_view = (content["hidden_rest"] | content["hidden_loaded"]) == 0
    shape = tuple(content["shape"])
    inner = np.zeros(shape, dtype=np.uint8)
    inner.ravel()[content["pixel"][open_view]] = 1
    inner = cv2.erode(inner, np.ones((13, 13))).ravel()[content["pixel"]] > 0
    moved = np.linalg.norm(truth, axis=1)
    seen = inner & (moved > 0.1)
    assert seen.sum() > 1000
    # Its own error on such pictures is 0.02 to 0.05 px, and its patches only shift.
    error = np.median(np.linalg.norm(flow - truth, axis=1)[seen])
    assert error < 0.03
    assert error < 0.25 * np.median(moved[seen])


def test_a_stage_turns_about_its_centre_and_goes_on_evenly():
    centre, step = np.array([0.1, 0.2, 0.3]), np.array([1e-3, -2e-3, 3e-3])
    axis = np.array([1.0, 2.0, -2.0])
    stage = Stage(3, translation=step, rotation=10.0, axis=axis, centre=centre)
    motions = facility.stage_motions(stage)
    assert motions.shape == (4, 4, 4)
    for k, motion in enumerate(motions):
        turn = Rotation.from_rotvec(np.radians(10.0 * k) * axis / 3.0).as_matrix()
        np.testing.assert_allclose(motion[:3, :3], turn, atol=1e-14)
        np.testing.assert_allclose(motion[:3, :3] @ centre + motion[:3, 3], centre + k * step)
        np.testing.assert_array_equal(motion[3], [0.0, 0.0, 0.0, 1.0])


def test_a_stage_moves_the_toy_rigidly(made):
    session, truth = read_session(made["toy"]), _truth(made["toy"])
    assert [step.name for step in session.steps] == ["s0", "s1", "s2"]
    assert session.probings == ()
    last = truth["step"][2]
    angle = np.radians(6.0)
    np.testing.assert_allclose(np.array(last["R"])[:2, :2],
                               [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]],
                               atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(last["t"], [2e-3, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(last["encoder"], last["t"], atol=1e-15)


@pytest.mark.slow
def test_sessions_made_together_have_the_bytes_of_those_made_alone(together, tmp_path):
    made, bodies, _ = together
    # One body for all balls, and the one with the same configuration comes out the same.
    assert bodies == 1
    config = read_lab_config(made["ball"].parent / "config.toml")
    config = replace(config, head=replace(config.head, columns=50, rows=40))
    make_session(config, tmp_path, variant=choose_variant())
    names = sorted(file.relative_to(tmp_path) for file in tmp_path.rglob("*.*"))
    assert len(names) > 10
    for name in names:
        assert (made["small"] / name).read_bytes() == (tmp_path / name).read_bytes()
    # Another seed: other noise, another texture, another misalignment.
    for name in ("images/rest_c0.png", "images/n01_c2.png"):
        assert (made["small"] / name).read_bytes() != (made["other"] / name).read_bytes()
    (here,), (there,) = _truth(made["small"])["probe"], _truth(made["other"])["probe"]
    assert here["direction"] != there["direction"]


def test_bodies_are_shared_only_where_nothing_of_them_differs(tmp_path):
    (tmp_path / "config.toml").write_text(HALF_BALL)
    config = read_lab_config(tmp_path / "config.toml")
    law = replace(config.material, law="neo-hookean")
    same = replace(config, seed=9, arm=replace(config.arm, misalignment=0.0), material=law)
    assert facility._body_key(config) == facility._body_key(same)
    for other in (
        replace(config, specimen=replace(config.specimen, element=8e-3)),
        replace(config, material=replace(config.material, poisson_ratio=0.3)),
        replace(config, arm=replace(config.arm, radius=5e-3)),
        replace(config, probes=(replace(config.probes[0], depth=3e-3),)),
        read_lab_config(tmp_path / "config.toml"),
    ):
        assert facility._body_key(config) != facility._body_key(other)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("point = [0, 0, 0.04]", "point = [0, 0, 0.02]", "its point is .* mm inside the body"),
        ("point = [0, 0, 0.04]", "point = [0, 0, 0.06]", "its point is .* mm away from the body"),
        ("depth = 4e-3", "depth = 4e-3\ndirection = [0, 0, 1]", "leads out of the body"),
        ("rows = 160", "rows = 160\nfocal = 2000", r"camera 'c0' has \d+ % of the object in its"),
        ('size = 4e-3', 'size = 4e-3\ntexture = "poor"', "grey levels of contrast beside a noise"),
        ("distance = 0.5", "distance = 0.05", "less than the object's size"),
    ],
)  # fmt: skip
def test_what_cannot_be_measured_is_refused_before_a_picture_is_kept(tmp_path, old, new, text):
    (tmp_path / "config.toml").write_text(HALF_BALL.replace(old, new))
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(InputError, match=text):
        make_session(read_lab_config(tmp_path / "config.toml"), out, variant=choose_variant())
    assert list(out.iterdir()) == []


def test_a_body_that_cannot_be_filled_is_refused_before_anything_is_rendered(tmp_path, monkeypatch):
    def refused(*_, **__):
        raise MeshError("cannot be filled")

    def rendered(*_, **__):
        raise AssertionError("light was made")

    monkeypatch.setattr(facility, "solid_under", refused)
    monkeypatch.setattr(facility, "make_studio", rendered)
    (tmp_path / "config.toml").write_text(HALF_BALL)
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(MeshError, match="cannot be filled"):
        make_session(read_lab_config(tmp_path / "config.toml"), out, variant=choose_variant())
    assert list(out.iterdir()) == []


@pytest.fixture
def written(tmp_path):
    """Writes a measurement that a configuration and a function of it give; reads both files."""

    def writer(text, measure, **changes):
        (tmp_path / "config.toml").write_text(text)
        config = replace(read_lab_config(tmp_path / "config.toml"), **changes)
        write_session(tmp_path, config, measure(config))
        return [
            tomllib.loads((tmp_path / name).read_text(encoding="utf-8"))
            for name in ("session.toml", "truth.toml")
        ]

    return writer


def _pressed(config):
    """One probing to two depths, every number with all its digits."""
    (probe,) = config.probes
    rng = np.random.default_rng(0)
    tip = Tip(Sphere(6e-3), np.array([0.0, 0.0, 0.046]), np.array([0.1, -0.2, -0.9]))
    load = np.zeros((1, 3))
    states = [
        Press(depth, tip.point, rng.normal(size=3), 1.0 / 300.0, load, load)
        for depth in (1e-3, 3e-3)
    ]
    return [probe_tables(config, probe, tip, states, rng=rng)]


def test_a_probing_comes_back_digit_by_digit(written):
    name = 'a "quoted" \\ name\nwith ümlauts'
    session, truth = written(HALF_BALL, _pressed, name=name)
    assert session["name"] == name
    assert session["support"]["plane"] == {"point": [0, 0, 0], "normal": [0, 0, 1],
                                           "tolerance": 1e-9}  # fmt: skip
    (probe,), (true,) = session["probe"], truth["probe"]
    assert probe["contact"] == {"point": [0.0, 0.0, 0.04], "tool": "sphere",
                                "tool_radius": 6e-3, "friction": "slides"}  # fmt: skip
    assert probe["images"]["loaded"] == ["images/n01_1_{camera}.png", "images/n01_{camera}.png"]
    rng = np.random.default_rng(0)
    assert true["force"] == rng.normal(size=(2, 3))[1].tolist()
    assert true["load_steps"] == [1e-3 / 3e-3, 1.0]
    assert (true["depth"], true["contact_radius"]) == (3e-3, 1.0 / 300.0)
    assert (truth["seed"], truth["law"]) == (3, "linear")
    assert (probe["force_std"], probe["tip_displacement_std"]) == (0.002, 5e-5)


def test_perfect_sensors_state_no_standard_deviation(written):
    perfect = {"force_sensor": Sensor(), "position_sensor": Sensor()}
    session, truth = written(HALF_BALL, _pressed, **perfect)
    (probe,) = session["probe"]
    assert {"force_std", "tip_displacement_std"}.isdisjoint(probe)
    assert probe["force"] == truth["probe"][0]["force"]


def test_a_step_comes_back_and_has_no_support(written):
    motion = np.eye(4)
    motion[:3] = np.random.default_rng(1).normal(size=(3, 4))
    session, truth = written(
        STAGE, lambda config: [step_tables(config, "s1", motion, rng=np.random.default_rng(0))]
    )
    assert "support" not in session
    assert session["step"] == [{"name": "s1", "images": "images/s1_{camera}.png"}]
    (step,) = truth["step"]
    assert step["R"] == motion[:3, :3].tolist()
    assert step["t"] == step["encoder"] == motion[:3, 3].tolist()
