"""The whole way with the virtual bench, its pictures drawn: a session whole after each push."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from bench.drawn_world import Script, drawn_bench, hand_bench, small_config
from fault_injection import all_states, in_child
from scipy.spatial.transform import Rotation

import palpate
from palpate.bench import DeviceError, measure, wanted_precision
from palpate.bench.live_session import LiveSession
from palpate.bench.wanted import Wanted, wanted_lengths
from palpate.errors import InputError
from palpate.pipeline import first_place
from palpate.records import Status, read_session


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two pushes, then one more by a bench that is started anew on the same folder."""
    folder = tmp_path_factory.mktemp("session")
    script = Script()
    estimate = measure(drawn_bench(), script, folder, pushes=2)
    return folder, script, estimate


@pytest.mark.slow
def test_constants_are_those_of_the_body(run):
    _, script, estimate = run
    material = small_config().material

    # The gain of the gauge alone has 1 % (1 sigma); elements of 12 mm make the body stiffer.
    assert estimate.young_modulus.value == pytest.approx(material.young_modulus, rel=0.1)
    assert estimate.poisson_ratio.value == pytest.approx(material.poisson_ratio, abs=0.04)
    assert [text for text in script.told if text.startswith("After push")] == [
        text for text in script.told if text.startswith(("After push 1: ", "After push 2: "))
    ]
    # Nobody had to decide anything.
    assert script.asked == []


@pytest.mark.slow
def test_the_fit_of_the_folder_has_the_same_numbers(run):
    folder, script, estimate = run
    assert sum(text.startswith("All 2 pushes: ") for text in script.told) == 1
    again = palpate.fit(folder)
    for name in ("young_modulus", "shear_modulus", "poisson_ratio"):
        assert getattr(again.estimate, name) == getattr(estimate, name)


@pytest.mark.slow
def test_a_session_is_gone_on_with(run, tmp_path):
    folder, _, _ = run
    before = (folder / "session.toml").read_text()
    # What a person adds stays.
    (folder / "session.toml").write_text(f"{before}\n[errors]\nforce_gain = 0.03\n")
    script = Script()
    estimate = measure(drawn_bench(), script, folder, pushes=3)
    session = read_session(folder)
    assert session.errors.force_gain == 0.03
    assert [probing.name for probing in session.probings] == ["n01", "n02", "n03"]
    assert len(estimate.probes) == 3
    points = np.array([probing.contact.point for probing in session.probings])
    # Never twice at one place: 5 mm is less than any two of the planned places are apart.
    gaps = np.linalg.norm(points[:, None] - points, axis=2)[np.triu_indices(3, 1)]
    assert gaps.min() > 5e-3
    (folder / "session.toml").write_text(before)


@pytest.mark.slow
def test_a_kill_or_a_full_disk_loses_the_push_in_hand_only(run, tmp_path):
    """Before each step that changes the folder, the third push in hand."""
    folder, _, _ = run
    work, copies = tmp_path / "work", tmp_path / "copies"
    shutil.copytree(folder, work)
    assert all_states(lambda: not measure(drawn_bench(), Script(), work, pushes=3), work, copies)
    states = sorted(path for path in copies.iterdir() if path.is_dir())
    counts = [len(read_session(state).probings) for state in states]
    # Three cameras' pictures, at rest and under load, come before the session that names them.
    assert len(counts) > 6
    assert counts == sorted(counts)
    assert set(counts) == {2, 3}
    # What was left just before it was done is gone on with.
    half = states[counts.index(3) - 1]
    assert len(measure(drawn_bench(), Script(), half, pushes=3).probes) == 3
    assert not list(half.rglob(".*"))
    # A disk that is full while it looks, and when the session takes its place.
    for step in (3, counts.index(3)):
        shutil.rmtree(work)
        shutil.copytree(folder, work)
        outcome = in_child(
            lambda: not measure(drawn_bench(), Script(), work, pushes=3), work, step=step,
            fault="ENOSPC",
        )  # fmt: skip
        assert outcome == "refused"
        assert len(read_session(work).probings) == 2
        assert not list(work.rglob(".*"))


@pytest.mark.slow
def test_a_camera_that_goes_is_said_and_started_again(tmp_path):
    bench, script = drawn_bench(), Script()
    camera, fails = bench.cameras[1], [1]
    grab, starts = camera.grab, []

    def failing():
        if fails and bench.arm.pose()[2] < 0.08:
            fails.pop()
            raise DeviceError("camera 'c1': it has stopped sending")
        return grab()

    camera.grab, camera.start = failing, lambda: starts.append(1)
    estimate = measure(bench, script, tmp_path, pushes=1)
    assert "camera 'c1': it has stopped sending" in script.told
    assert script.asked == ["Go on?"]
    assert len(starts) == 2
    assert len(estimate.probes) == 1


@pytest.mark.slow
def test_an_object_that_was_moved_is_noticed(tmp_path):
    """By 1 mm between the first push and the second, for good; a given rig is of the old place."""
    bench = drawn_bench()
    world = bench.cameras[0]._world
    rest = world.body.vertices

    def shift(text):
        if text.startswith("After push 1"):
            object.__setattr__(world.body, "vertices", rest + np.array([1e-3, 0.0, 0.0]))
            world._drawn = None

    script = Script(("Is it back", "yes"), ("Is it back", "no"), on_tell=shift)
    measure(bench, script, tmp_path, pushes=2)
    said, _ = [text for text in script.told if "does not count" in text]
    assert "the object has moved by 1" in said
    assert script.told[-2].startswith("Its rig is of the old place")
    assert len(read_session(tmp_path).probings) == 1


@pytest.mark.slow
def test_an_object_that_stands_loose_may_tilt_under_a_push(tmp_path):
    """By 0.1 degrees, and back: said to be loose, E is that of the body, and said to be glued it
    is not."""
    bench = drawn_bench()
    world = bench.cameras[0]._world
    draw, tilt = world.body.draw, Rotation.from_rotvec([0.0, 0.002, 0.0]).as_matrix()

    def tilted(vertices, rod):
        return draw(vertices if rod is None else vertices @ tilt.T, rod)

    object.__setattr__(world.body, "draw", tilted)
    support = bench.head["support"]
    loose = replace(bench, head={**bench.head, "support": {**support, "motion": "free"}})
    estimate = measure(loose, Script(), tmp_path, pushes=1)
    material = small_config().material
    # As where nothing tilts: elements of 12 mm make the body stiffer.
    assert estimate.young_modulus.value == pytest.approx(material.young_modulus, rel=0.1)
    text = (tmp_path / "session.toml").read_text()
    (tmp_path / "session.toml").write_text(text.replace('motion = "free"', 'motion = "fixed"'))
    glued = palpate.fit(tmp_path).estimate
    assert abs(glued.young_modulus.value / material.young_modulus - 1.0) > 0.2


@pytest.mark.slow
def test_a_push_counts_though_no_place_is_left(tmp_path):
    """A half ball on rollers can be pressed at its top alone: elsewhere it would slide away."""
    bench = drawn_bench()
    support = {**bench.head["support"], "directions": [[0.0, 0.0, 1.0]]}
    bench, script = replace(bench, head={**bench.head, "support": support}), Script()
    estimate = measure(bench, script, tmp_path, pushes=3)
    assert len(estimate.probes) == len(read_session(tmp_path).probings) == 1
    (said,) = [text for text in script.told if text.startswith("That was the last push: ")]
    assert "on rollers one where it presses straight against them" in said
    assert script.asked == []


@pytest.mark.slow
def test_a_push_that_is_too_light_does_not_count(tmp_path):
    bench = drawn_bench()
    object.__setattr__(bench, "push_force", 0.015)
    script = Script(("Push again?", "stop"))
    assert measure(bench, script, tmp_path, pushes=1) is None
    assert any("too light" in text for text in script.told), script.told
    assert not (tmp_path / "session.toml").exists()


@pytest.mark.slow
def test_a_push_that_cannot_be_fitted_is_taken_out_again(tmp_path, monkeypatch):
    """And of the notes on the next one, those that are about it are said; and what is uneven."""
    deep, other = "In n01 the tool went in by 20 % of the radius", "Support s turned"
    uneven, status = "The modulus differs from place to place", Status.HETEROGENEOUS
    fits, fit = [], LiveSession.fit

    def failing(self, *arguments, **options):
        fits.append(1)
        if len(fits) == 1:
            raise InputError("probing 'n01': the tool is buried")
        result = fit(self, *arguments, **options)
        estimate = replace(result.estimate, notes=(uneven, other, deep), status=status)
        return replace(result, estimate=estimate)

    monkeypatch.setattr(LiveSession, "fit", failing)
    script = Script()
    estimate = measure(drawn_bench(), script, tmp_path, pushes=1)
    assert "This push does not count: probing 'n01': the tool is buried" in script.told
    assert len(estimate.probes) == len(read_session(tmp_path).probings) == 1
    assert len(fits) == 2
    assert deep in script.told
    assert uneven in script.told
    assert other not in script.told


def test_a_rehearsal_moves_nothing(tmp_path):
    bench, script = drawn_bench(), Script()
    before = bench.arm.pose()
    assert measure(bench, script, tmp_path, dry_run=True) is None
    np.testing.assert_array_equal(bench.arm.pose(), before)
    assert "never beyond 0.585 N" in script.told[-1]
    # The way is drawn, in blue; from above the half ball it leads to its top.
    drawn = cv2.imread(str(tmp_path / "first_push.png")).astype(int)
    assert (np.abs(drawn - (178, 114, 0)).max(axis=2) < 20).sum() > 50


def test_an_arm_that_asks_goes_only_when_told(tmp_path):
    bench, script = drawn_bench(), Script(("Is that way free", "no"))
    bench.arm.asks, before = True, bench.arm.pose()
    assert measure(bench, script, tmp_path) is None
    np.testing.assert_array_equal(bench.arm.pose(), before)
    assert script.asked[-1] == "Is that way free, and shall the arm go?"


def test_what_is_not_in_the_bench_is_asked_for(tmp_path):
    """And a device that does not start is said, and started again."""
    bench, session = hand_bench(tmp_path), tmp_path / "session"
    script = Script(("What presses", "flat round end"), ("Radius", "big"))
    session.mkdir()
    fails, camera = [1], bench.cameras[1]

    def start():
        if fails:
            fails.pop()
            raise DeviceError("camera 'c1': it does not open")

    camera.start = start
    assert measure(bench, script, session, dry_run=True) is None
    assert script.told[0] == "camera 'c1': it does not open"
    radius = "Radius of the flat round end, in mm"
    unit, side = "ball.stl is 80 x 79.8 x 40; in which unit?", "Which side does it stand on"
    way = "How does it stand there?"
    assert script.asked == ["Go on?", unit, f"{side}, or is it held at?", way, "What presses?",
                            radius, radius]  # fmt: skip
    assert any('"big" is no radius' in text for text in script.told)
    # The flat side of the half ball is a circle of 40 mm, of triangles with all corners at z = 0.
    mesh = small_config().specimen.mesh
    low = (mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1)
    assert len((session / "support_triangles.txt").read_text().split()) == low.sum()


@pytest.mark.parametrize(
    ("way", "keys", "errors"),
    [
        ("loose", {"motion": "free"}, None),
        ("glued or taped", {}, None),
        ("on a slippery plate", {"directions": [[0.0, 0.0, -1.0]]}, None),
        ("on a soft pad", {}, {"support_compliance": "400 um/kPa"}),
    ],
)
def test_how_the_object_stands_is_in_the_session(tmp_path, monkeypatch, way, keys, errors):
    """And on a plate that is slippery it is pressed straight down."""
    bench, folder, sessions = hand_bench(tmp_path), tmp_path / "session", []
    folder.mkdir()
    begun = LiveSession.__init__

    def kept(self, *arguments, **options):
        begun(self, *arguments, **options)
        sessions.append(self)

    monkeypatch.setattr(LiveSession, "__init__", kept)
    script = Script(("How does it stand", way))
    # A mark beside the flat side: a plate that is slippery holds one.
    face = script.face
    marked = iter([way == "on a slippery plate"])

    def careless(mesh, faces, ways):
        held, chosen = face(mesh, faces, ways)
        if next(marked, False):
            script.answers.append(("How does it stand", way))
            return np.arange(len(mesh.triangles)), chosen
        return held, chosen

    script.face = careless
    measure(bench, script, folder, dry_run=True)
    (session,) = sessions
    support = {"triangles": "support_triangles.txt", **keys}
    assert session.content["support"] == support
    assert session.content.get("errors") == errors
    assert script.asked.count("How does it stand there?") == (1 if "directions" not in keys else 2)
    _, inward = first_place(session.bare, radius=session.contact_radius)
    # At most 5 % of the force may be along what nothing holds; the cameras face another place more.
    assert (np.linalg.norm(inward[:2]) < 0.06) == ("directions" in keys)


@pytest.mark.parametrize("file", ["rig.toml", "mesh.ply"])
def test_what_is_there_is_left_as_it_is(tmp_path, file):
    """A rig or a mesh of another session; and the bench's own file in the session's folder."""
    (tmp_path / file).write_text("mine")
    with pytest.raises(InputError, match=f"{file}: is there already, and is not this bench's"):
        measure(drawn_bench(), Script(), tmp_path, dry_run=True)
    assert (tmp_path / file).read_text() == "mine"
    (tmp_path / file).unlink()
    (tmp_path / "bench.toml").write_text("mine")
    measure(drawn_bench(), Script(), tmp_path, dry_run=True)
    assert (tmp_path / "bench.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"contact": {"tool": "ball", "tool_radius": 0.012}}, "contact tool: is 'ball'"),
        ({"contact": {"tool": "sphere"}}, "the key 'tool_radius' is missing"),
        ({"contact": {"tool": "sphere", "tool_radius": -1.0}}, "must be a positive length"),
        ({"contact": {"radius": 0.004, "point": [0.0, 0.0, 0.04]}}, "point: leave it out"),
        ({"head": {"gravity": 3}}, "gravity: is 3; must be a table"),
        ({"head": {"object": {"colour": "red"}}}, "unknown key 'colour'"),
    ],
)
def test_tables_are_refused_before_the_first_push(tmp_path, table, words):
    bench = drawn_bench()
    head = bench.head | {"object": bench.head["object"] | table.get("head", {}).get("object", {})}
    head |= {key: value for key, value in table.get("head", {}).items() if key != "object"}
    bench = replace(bench, head=head, contact=table.get("contact", bench.contact))
    with pytest.raises(InputError, match=words):
        measure(bench, Script(), tmp_path, dry_run=True)
    assert not (tmp_path / "bench.toml").exists()


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("E 3 %", Wanted("young_modulus", 0.03, True)),
        ("nu 0.02", Wanted("poisson_ratio", 0.02, False)),
        ("G 2 kPa", Wanted("shear_modulus", 2000.0, False)),
    ],
)
def test_wanted_precision(text, wanted):
    assert wanted_precision(text) == wanted


@pytest.mark.parametrize(
    ("text", "percent"), [("E 3 %", 0.154), ("nu 0.04", 0.205), ("E 1 %", 0.1), ("G 2 kPa", 0.1)]
)
def test_lengths_are_as_precise_as_the_constants_need(text, percent):
    """Twice their error makes the wanted interval 2 % wider; what the gauge needs is enough."""
    assert 100.0 * wanted_lengths(wanted_precision(text)) == pytest.approx(percent, rel=5e-3)


@pytest.mark.parametrize("text", ["E", "E 3 mm", "E 0 %", "F 3 %", "nu 2 kPa"])
def test_wanted_precision_that_is_none(text):
    with pytest.raises(InputError, match="must be a constant and half the width"):
        wanted_precision(text)


@pytest.mark.slow
def test_share_of_the_wanted_interval(run):
    _, _, estimate = run
    low, high = estimate.young_modulus.ci95
    half = 0.5 * (high - low)
    assert Wanted("young_modulus", half, False).share(estimate) == pytest.approx(1.0)
    relative = half / estimate.young_modulus.value
    assert Wanted("young_modulus", 2.0 * relative, True).share(estimate) == pytest.approx(0.5)
