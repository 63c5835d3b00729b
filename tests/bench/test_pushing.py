"""One push by a person: with a gauge that says when it is held, and with a scale that is read."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from bench.drawn_world import DOWN, TOP, Hand, Script, drawn_bench

from palpate.bench import DeviceError
from palpate.bench.gauges import TypedForce
from palpate.bench.pushing import PushError, take_push, way_round
from palpate.bench.questions import Stopped
from palpate.errors import InputError


@pytest.fixture
def bench(monkeypatch):
    # A person's patience, however busy the machine is that draws the pictures.
    monkeypatch.setattr("palpate.bench.pushing._PATIENCE", 600.0)
    return replace(drawn_bench(), arm=None)


def taken(bench, script):
    mesh = bench.cameras[0]._world.config.specimen.mesh
    return take_push(bench, script, mesh, TOP, DOWN)


@pytest.mark.slow
def test_a_gauge_says_when_a_push_is_held(bench):
    person = Hand(bench)
    script = Script(on_tell=person)
    push = taken(bench, script)
    press = person.world._press
    force = float(press.force_at(np.array([0.8]))[0] @ press.tip.direction)
    # Each reading has 0.5 % and 1 mN; some hundred of them, and the zero, are averaged.
    assert push.force == pytest.approx(force, rel=2e-3)
    assert 0.0 < push.force_std < 5e-3 * force
    assert script.told[-1] == "Got it: lift off"
    # The first 0.3 s of the hold are left out: there is no trace of the way down.
    still = person.world.body.draw(person.world.body.vertices + person.world._surface(0.8), None)
    assert np.abs(np.median(push.loaded[0][still[0] > 30] - still[0][still[0] > 30])) < 1.0


@pytest.mark.slow
def test_a_slip_is_refused(bench):
    """The object slides by 2 mm a second under the tool, whose force stays as it is."""
    person = Hand(bench, slides=True)
    world = person.world
    draw = world.body.draw

    def sliding(vertices, rod):
        aside = 2e-3 * max(world.time - person.begun - 0.5, 0.0)
        return draw(vertices + np.array([aside, 0.0, 0.0]), rod)

    object.__setattr__(world.body, "draw", sliding)
    with pytest.raises(PushError, match=r"it moved while it was held, by .* did the tool slip"):
        taken(bench, Script(on_tell=person))


def test_a_blurred_push_is_refused(bench):
    person = Hand(bench)
    world = person.world
    draw = world.body.draw

    def shaken(vertices, rod):
        pictures = draw(vertices, rod)
        if rod is None:
            return pictures
        return tuple(
            (p + np.roll(p, 3, 1) + np.roll(p, 6, 1) + np.roll(p, 9, 1)) / 4 for p in pictures
        )

    object.__setattr__(world.body, "draw", shaken)
    with pytest.raises(PushError, match=r"blurred, .* as sharp as those at rest"):
        taken(bench, Script(on_tell=person))


@pytest.mark.slow
def test_a_force_that_falls_while_it_is_held_is_said(bench):
    """By 1.5 % a second; at 3 % it would not be held."""
    bench = replace(bench, hold=3.0)
    person = Hand(bench)

    def relaxed(time, newtons):
        since = np.clip(time - person.begun - 0.5, 0.0, None)
        return time, 0.2 + (newtons - 0.2) * (1.0 - 0.015 * since)

    _readings(relaxed)(bench)
    script = Script(on_tell=person)
    taken(bench, script)
    # 4.5 % over that of the middle, 98 %, to the nearest per cent.
    said = script.told[-1]
    assert re.match(r"The force fell by [45] % in the (2\.9|3\.[0-2]) s it was held", said)


@pytest.mark.parametrize(
    ("factor", "taken_so"), [(0.6, False), pytest.param(0.75, True, marks=pytest.mark.slow)]
)
def test_exposure_that_jumps(bench, factor, taken_so):
    """A camera that is darker under load is named; by a quarter less is made good."""
    person = Hand(bench)
    world, quiet = person.world, bench.cameras[1].grab

    def darker():
        picture, when = quiet()
        late = world.time > person.begun + 1.2
        return (factor * picture if late else picture).astype(np.uint8), when

    bench.cameras[1].grab = darker
    if not taken_so:
        with pytest.raises(PushError, match=r"'c1' is 0\.[56]. times as bright under load"):
            taken(bench, Script(on_tell=person))
        return
    push = taken(bench, Script(on_tell=person))
    lit = push.rest[1] > 60
    # Most of the object is where it was: as bright to two per cent, a grey level of the darkest.
    ratio = np.median(push.loaded[1][lit] / push.rest[1][lit].astype(float))
    assert ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [0.6, 0.9])
def test_a_shadow_is_said(bench, depth):
    """On a third of what a camera sees under load; the tool's own dark rod is none."""
    person = Hand(bench)
    world, quiet = person.world, bench.cameras[1].grab

    def shaded():
        picture, when = quiet()
        shade = np.where(np.arange(picture.shape[1]) < 0.45 * picture.shape[1], depth, 1.0)
        late = world.time > person.begun + 0.6
        return (shade * picture if late else picture).astype(np.uint8), when

    bench.cameras[1].grab = shaded
    script = Script(on_tell=person)
    taken(bench, script)
    said = [text for text in script.told if "shadow" in text]
    assert len(said) == (depth < 0.75)
    assert all(re.match(r"Camera 'c1' sees a shadow on [234]\d % of the object", x) for x in said)


@pytest.mark.slow
@pytest.mark.parametrize("by_arm", [True, False])
def test_a_gauge_at_the_end_of_its_range(bench, by_arm):
    """At 0.5 N, of which the tool's weight is 0.2."""
    given = drawn_bench() if by_arm else bench
    given.force.limit = 0.5
    _readings(lambda t, x: (t, np.minimum(x, 0.5)))(given)
    script = Script() if by_arm else Script(on_tell=Hand(given))
    with pytest.raises(InputError, match=r"the end of its range.* a gauge of a larger range"):
        taken(given, script)


def test_an_arm_that_is_stopped_lifts_off():
    """On its way down, before the force is reached."""

    class Stopping(Script):
        def see(self, pictures, time, force, state):
            if state == "presses" and max(force) > 0.4:
                raise Stopped

    bench = drawn_bench()
    with pytest.raises(Stopped):
        taken(bench, Stopping())
    np.testing.assert_allclose(bench.arm.pose(), TOP - bench.arm.limits.depth * DOWN, atol=1e-12)


def test_a_scale_under_the_object_is_read(bench):
    """It reads the vertical part of a push along the normal: cos 60 degrees here."""
    person = Hand(bench)
    aslant = np.array([0.0, np.sqrt(0.75), -0.5])
    script = Script(("What", "much"), ("What", "46 g"), on_tell=person)
    scale = replace(bench, force=TypedForce(unit="gf"), direction=DOWN)
    mesh = person.world.config.specimen.mesh
    push = take_push(scale, script, mesh, TOP, aslant)
    assert push.force == pytest.approx(2.0 * 46 * 9.80665e-3, rel=1e-12)
    # Two per cent by eye.
    assert push.force_std == pytest.approx(0.02 * push.force, rel=1e-12)
    assert any("'much' is no force" in text for text in script.told)


def test_an_arm_goes_to_the_far_side(monkeypatch):
    """From one side of the half ball to the other: outward there is deep along the new normal."""
    bench, there = drawn_bench(), []

    def press(arm, watch, point, inward, wanted):
        there.append(arm.pose() - (point - arm.limits.depth * inward))
        raise PushError("it is there")

    monkeypatch.setattr("palpate.bench.pushing._press", press)
    mesh = bench.cameras[0]._world.config.specimen.mesh
    for side in (1.0, -1.0):
        outward = np.array([side * np.sqrt(0.75), 0.0, 0.5])
        with pytest.raises(PushError, match="it is there"):
            take_push(bench, Script(), mesh, 0.04 * outward, -outward)
    np.testing.assert_allclose(there, 0.0, atol=1e-12)


def test_the_way_round_keeps_clear(bench):
    mesh = bench.cameras[0]._world.config.specimen.mesh
    way = way_round(np.array([0.09, 0.0, 0.02]), np.array([-0.06, 0.0, 0.02]), mesh, clearance=0.01)
    path = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(way)])
    gaps = np.linalg.norm(path[:, None] - mesh.vertices, axis=2).min(axis=1)
    # Chords of 0.2 rad come nearer than the ball by half a per cent of its radius.
    assert gaps[: -len(path) // len(way)].min() > 0.009
    np.testing.assert_array_equal(way[-1], [-0.06, 0.0, 0.02])


def _smaller(bench):
    """The second camera sends another size, from its thirtieth picture on."""
    camera, grab, count = bench.cameras[1], bench.cameras[1].grab, itertools.count()

    def grabbed():
        picture, when = grab()
        return (picture[:200, :300] if next(count) > 30 else picture), when

    camera.grab = grabbed


def _readings(change):
    def changed(bench):
        read = bench.force.read
        bench.force.read = lambda: change(*read())

    return changed


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (_smaller, DeviceError, "camera 'c1' sends pictures of 200 x 300 .uint8.; must be 320 x"),
        (_readings(lambda t, x: (t, np.nan * x)), DeviceError, "readings that are no numbers"),
        (_readings(lambda t, x: (t[::-1], x)), DeviceError, "or times that go back"),
    ],
)
def test_devices_that_go_wrong_in_a_push(change, error, words):
    bench = drawn_bench()
    change(bench)
    point = np.array([0.0, 0.0, 0.04])
    with pytest.raises(error, match=words):
        take_push(bench, Script(), bench.cameras[0]._world.config.specimen.mesh, point, DOWN)


@pytest.mark.slow
def test_an_interrupt_lifts_the_tool():
    bench = drawn_bench()
    read = bench.force.read

    def interrupted():
        if (bench.arm.pose() - TOP) @ DOWN > 0.0:
            raise KeyboardInterrupt
        return read()

    bench.force.read = interrupted
    with pytest.raises(KeyboardInterrupt):
        take_push(bench, Script(), bench.cameras[0]._world.config.specimen.mesh, TOP, DOWN)
    assert (bench.arm.pose() - TOP) @ DOWN == pytest.approx(-bench.arm.limits.depth, rel=1e-9)


@pytest.mark.parametrize(
    ("reading", "deepest", "words"),
    [
        # Of 24 mm: a quarter, where a gauge that is not connected reads what it read in the air.
        (lambda x, depth: 0.0 * x + 0.2, 6e-3, "6 mm below the surface the gauge reads 0 N, and"),
        # The cable comes off where the tool presses with 0.1 N of 0.45 N.
        (lambda x, depth: np.minimum(x, 0.3), 9e-3, "reads 0.1 N, and read 0.1 N a quarter"),
        # Felt, but softer than anybody thought: down to the limit, and no farther.
        pytest.param(
            lambda x, depth: 0.0 * x + max(10 * depth, 0.0), 24e-3,
            "at the largest depth of 24 mm", marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_a_gauge_that_does_not_feel_the_object_stops_the_arm(reading, deepest, words):
    bench = drawn_bench()
    _readings(lambda t, x: (t, reading(x, (bench.arm.pose() - TOP) @ DOWN)))(bench)
    go, depths = bench.arm._arm.move, []
    bench.arm._arm.move = lambda there, *how: (depths.append((there - TOP) @ DOWN), go(there, *how))
    with pytest.raises(InputError, match=words):
        take_push(bench, Script(), bench.cameras[0]._world.config.specimen.mesh, TOP, DOWN)
    assert max(depths) <= deepest * (1.0 + 1e-9)
    # And up again.
    assert depths[-1] == -bench.arm.limits.depth
