"""One push: pictures at rest and under load, and the force of that moment.

Cameras and gauge are on one clock but for the time that each takes to deliver, some hundredths to
three tenths of a second. So a push is held, and read where force and pictures were still for longer
than that; pictures that move there are refused.
"""

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from palpate.arrays import tangents_of
from palpate.bench.arms import GuardedArm, check_push
from palpate.bench.bench_file import Bench
from palpate.bench.devices import DeviceError
from palpate.bench.gauges import TypedForce
from palpate.bench.questions import AT_REST, Pictures, Questions
from palpate.disk import write_bytes
from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh
from palpate.pipeline import DARK_LEVEL
from palpate.recording import (
    ForceLog,
    Reading,
    Touch,
    Zero,
    find_plateau,
    find_touches,
    find_zero,
    make_force_log,
    read_force,
    resample_force,
    still_force,
    unreadable_reason,
)
from palpate.shapes import Vector3

# Time at rest before and after a push, and what a delivery may take [s].
_REST, _DELIVERY = 0.8, 0.3
# Pictures kept, and most pictures that are averaged; they need so many to show that nothing moves.
_KEPT, _AVERAGED, _FEWEST = 60, 8, 4
# A person who does not press, or does not lift off, is asked after so long [s].
_PATIENCE = 60.0
# Change of the pictures while a push is held, over their change since rest, that is a slip; and
# sharpness over that at rest that is a blur.
_SLIP, _BLUR = 0.15, 0.5
# Brightness over that at rest that is no longer taken: four standard deviations of that of cameras
# which were tried and left the constants as they are (`python -m benchmarks.cheap_cameras`).
_BRIGHTER = 1.5
# Percentile of the contrasts of neighbouring pixels that is the texture's, not the background's.
_TEXTURED = 95.0
# A shadow: windows of so many pixels with this contrast [grey levels] and correlation with those at
# rest, darker than most by this factor; and the share of all such windows that is said. The shadow
# of the tool itself is on 0.2 % at most of the virtual laboratory's pictures.
_WINDOW, _CONTRAST, _ALIKE, _DARKER, _SHADED = 25, 5.0, 0.9, 0.75, 0.05
# Steps of an arm's way down to the largest depth; angle of a step around the object [rad].
_STEPS, _TURN = 100, 0.2
# Share of the wanted force by which a gauge that feels the object rises in a quarter of the largest
# depth. What bears the wanted force at the largest depth bears 6 % at a quarter of it (under a
# cone, whose force rises latest; 12 % under a ball), and 3 % where the surface is a tenth lower.
_FELT = 0.02
# Share of a gauge's range from which on it is at its end.
_FULL = 0.999
# Pause while a reading is waited for [s]; directions that differ by less are the same.
_PAUSE, _SAME = 2e-3, 1e-6
# Standard deviation of a force that was read by eye, over the force.
_BY_EYE = 0.02
# Change of the force while it is held that is said. A gauge with noise of 0.5 % and 100 readings a
# second shows 0.2 % in a second and a half; above 3 % a second it is not held at all.
_CREEPS = 0.02
_Grey = tuple[np.ndarray, ...]
# Pictures at rest, under load and afterwards; force and its standard deviation [N].
_Push = tuple[Pictures, Pictures, Pictures | None, tuple[float, float]]


class PushError(InputError):
    """A push that cannot be measured; the text says why, and what to do otherwise."""


@dataclass(frozen=True, slots=True, eq=False)
class TakenPush:
    """What one push gave.

    Attributes
    ----------
    rest, loaded : Pictures         before it, and while it was held; of each camera
    after : Pictures or None        once the tool is off; None: the next push's rest shows that
    force : float [N]               of the tool, along the inward normal
    force_std : float [N]
    """

    rest: Pictures
    loaded: Pictures
    after: Pictures | None
    force: float
    force_std: float


def grabbed(bench: Bench) -> tuple[float, Pictures]:
    """A picture of every camera, and when the last of them arrived [s].

    Parameters
    ----------
    bench : Bench                   started

    Raises
    ------
    DeviceError                     a camera sends none, or none of the rig's size
    """
    times, pictures = [], []
    sizes = (
        [camera.size for camera in bench.rig.cameras] if bench.rig else [None] * len(bench.cameras)
    )
    for camera, known in zip(bench.cameras, sizes, strict=True):
        picture, when = camera.grab()
        columns, rows = known or picture.shape[::-1]
        if picture.shape != (rows, columns) or picture.dtype != np.uint8:
            raise DeviceError(
                f"camera '{camera.name}' sends pictures of {' x '.join(map(str, picture.shape))}"
                f" ({picture.dtype}); must be {rows} x {columns} (uint8), rows x columns as in the"
                " rig: set its size in bench.toml, or calibrate with this one"
            )
        times.append(when)
        pictures.append(picture)
    return max(times), tuple(pictures)


def write_picture(file: Path, picture: np.ndarray) -> None:
    """Write a picture as PNG; the file is whole, or not there.

    Parameters
    ----------
    file : Path
    picture : (rows, columns) or (rows, columns, 3) uint8     grey, or red, green, blue
    """
    code = cv2.imencode(".png", picture if picture.ndim == 2 else picture[..., ::-1])[1]
    write_bytes(file, code.tobytes())


class _Watch:
    """The latest pictures, and all readings since it began; shown to the person as they come."""

    def __init__(self, bench: Bench, questions: Questions) -> None:
        self.bench, self.questions = bench, questions
        self.frames: deque[tuple[float, Pictures]] = deque(maxlen=_KEPT)
        self.time: list[float] = []
        self.reading: list[float] = []
        self.state = AT_REST
        # What came before is of no push.
        bench.force.read()

    def poll(self) -> None:
        """Take a picture with every camera, and what the gauge has sent."""
        self.frames.append(grabbed(self.bench))
        self.read()

    def read(self) -> int:
        """Take what the gauge has sent; how many readings."""
        when, newtons = self.bench.force.read()
        if not (
            np.isfinite(newtons).all() and (np.diff(when, prepend=self.time[-1:]) >= 0.0).all()
        ):
            raise DeviceError(
                "the gauge sends readings that are no numbers, or times that go back; see that it"
                " is well connected, and that no other program reads it"
            )
        self.time += when.tolist()
        self.reading += newtons.tolist()
        self.questions.see(self.frames[-1][1], self.time, self.reading, self.state)
        return len(when)

    def seen_for(self, seconds: float, rest: Pictures | None = None) -> Pictures:
        """Mean picture of the next seconds; of a push, since rest."""
        self.poll()
        begun = self.frames[-1][0]
        while self.frames[-1][0] < begun + seconds or self.since(begun) < _FEWEST:
            self.poll()
        return self.mean(begun, self.frames[-1][0], rest)

    def since(self, begun: float) -> int:
        """Number of pictures since a time."""
        return sum(when >= begun for when, _ in self.frames)

    def mean(self, begin: float, end: float, rest: Pictures | None = None) -> Pictures:
        """Mean picture of a span of time; a push that slips in it since rest is refused."""
        chosen: list[_Grey] = [p for when, p in self.frames if begin <= when <= end][-_AVERAGED:]
        if len(chosen) < _FEWEST:
            raise PushError(
                f"only {len(chosen)} pictures came while it was still; hold longer, or have the"
                " cameras send more pictures a second"
            )
        if rest is not None:
            chosen = [self.lit_as(rest, pictures) for pictures in chosen]
        if rest is not None and (share := _moved(chosen, rest)) > _SLIP:
            raise PushError(
                f"it moved while it was held, by {100 * share:.0f} % of the push: did the tool"
                " slip, or does a camera deliver late? Press straight in, and hold still"
            )
        stacks = [np.stack(views) for views in zip(*chosen, strict=True)]
        means = (np.rint(stack.mean(axis=0)) for stack in stacks)
        return tuple(np.minimum(mean, 255.0).astype(np.uint8) for mean in means)

    def lit_as(self, rest: Pictures, pictures: Pictures) -> _Grey:
        """Pictures as bright as those at rest; a push under another light is refused."""
        gains = [_brightness(a, b) for a, b in zip(pictures, rest, strict=True)]
        for camera, gain in zip(self.bench.cameras, gains, strict=True):
            if not 1.0 / _BRIGHTER < gain < _BRIGHTER:
                raise PushError(
                    f"camera '{camera.name}' is {gain:.2g} times as bright under load as at rest:"
                    " fix its exposure and gain, keep lamps and daylight as they are, and stay out"
                    " of the light"
                )
        return tuple(p / np.float32(gain) for p, gain in zip(pictures, gains, strict=True))

    def force(self) -> "_Force | None":
        """The push in the readings so far; None before there is one."""
        if len(self.time) < 2 or self.time[-1] - self.time[0] < _REST / 2.0:
            return None
        log = make_force_log(
            np.array(self.time), np.array(self.reading)[:, None], axes=np.array([[0.0, 0.0, 1.0]]),
            limit=self.bench.force.limit, source="gauge",
        )  # fmt: skip
        resampled = resample_force(log)
        try:
            touches, _ = find_touches(resampled)
            if not touches:
                return None
            zero = find_zero(log, touches)
        except RecordError as error:
            raise PushError(str(error)) from error
        span = find_plateau(resampled, zero, touches[-1], still_force(resampled, zero))
        return _Force(log, zero, touches[-1], span)


@dataclass(frozen=True, slots=True, eq=False)
class _Force:
    """A push as the gauge saw it; `span` is where it was held."""

    log: ForceLog
    zero: Zero
    touch: Touch
    span: tuple[float, float] | None

    @property
    def held(self) -> float:
        """How long it was held [s]."""
        return 0.0 if self.span is None else self.span[1] - self.span[0]

    def reading(self) -> Reading:
        """The force where it was held."""
        if reason := unreadable_reason(self.log, self.span):
            raise PushError(reason)
        begin, end = self.span or (0.0, 0.0)
        return read_force(self.log, self.zero, (begin, end), 0.5 * (begin + end))


def take_push(
    bench: Bench, questions: Questions, mesh: TriangleMesh, point: Vector3, inward: Vector3
) -> TakenPush:
    """Let the arm or the person press at a place, and record pictures and force.

    Parameters
    ----------
    bench : Bench                   started
    questions : Questions
    mesh : TriangleMesh             the object
    point : (3,) float [m]          on its surface
    inward : (3,) float [-]         unit normal into the object

    Returns
    -------
    TakenPush

    Raises
    ------
    PushError                       a push that cannot be measured
    DeviceError                     a device that fails
    InputError                      a push that leaves the arm's limits
    """
    questions.place(point, inward)
    watch, where = _Watch(bench, questions), f"{(np.round(1e3 * point, 1) + 0.0).tolist()} mm"
    if bench.arm is not None:
        questions.tell(f"The arm presses at {where}")
        push = _by_arm(bench, bench.arm, watch, mesh, point, inward)
    elif isinstance(bench.force, TypedForce):
        push = _typed(bench.force, questions, watch, where)
    else:
        push = _by_hand(bench, questions, watch, where)
    rest, loaded, _, (force, std) = push
    if (sharp := _sharpness(loaded, rest)) < _BLUR:
        raise PushError(
            f"the pictures under load are blurred, {100 * sharp:.0f} % as sharp as those at rest:"
            " hold still, and have the cameras' focus fixed"
        )
    for camera, views in zip(bench.cameras, zip(loaded, rest, strict=True), strict=True):
        if (share := _shaded(*views)) > _SHADED:
            questions.tell(
                f"Camera '{camera.name}' sees a shadow on {100 * share:.0f} % of the object that"
                " was not there at rest. The push counts, less precisely at its edge: keep hands"
                " and head out of the light"
            )
    if bench.direction is not None:
        # A tool that slides presses along the normal: the scale reads one component of that.
        force, std = (x / float(inward @ bench.direction) for x in (force, std))
    return TakenPush(*push[:3], force, float(np.hypot(std, bench.force_std)))


def _at_rest(questions: Questions, watch: _Watch, where: str) -> Pictures:
    """Pictures of the object before a person presses."""
    questions.wait(f"Tool off the object, hands out of the pictures. Next push: near {where}")
    return watch.seen_for(_REST)


def _by_hand(bench: Bench, questions: Questions, watch: _Watch, where: str) -> _Push:
    """A person presses, the gauge says when it is held and when it is over."""
    rest = _at_rest(questions, watch, where)
    questions.tell(f"Press straight in near {where}, and hold still for {bench.hold:g} s")
    begun, force, watch.state = time.monotonic(), None, "press"
    while force is None or force.held < bench.hold:
        watch.poll()
        force = watch.force()
        if force is not None and force.span is not None:
            watch.state = f"hold still: {force.held:.1f} of {bench.hold:g} s"
        if time.monotonic() - begun > _PATIENCE:
            raise PushError(f"no push was held for {bench.hold:g} s within a minute; try again")
    begin, end = force.span or (0.0, 0.0)
    loaded = watch.mean(begin + _DELIVERY, end, rest)
    watch.state = "lift off"
    questions.tell("Got it: lift off")
    while not force.touch.ended:
        watch.poll()
        force = watch.force() or force
        if time.monotonic() - begun > 2.0 * _PATIENCE:
            raise PushError("the tool was not lifted off, so the gauge's zero is not known")
    after = watch.seen_for(_REST)
    return rest, loaded, after, _size(force.reading(), questions)


def _typed(force: TypedForce, questions: Questions, watch: _Watch, where: str) -> _Push:
    """A person presses and reads the force."""
    rest = _at_rest(questions, watch, where)
    questions.wait(f"Press straight in near {where}, and hold still")
    watch.state = "hold still"
    loaded = watch.seen_for(_DELIVERY, rest)
    while True:
        try:
            newtons = force.newtons(questions.ask("What does the scale show more than before?", ""))
        except InputError as error:
            questions.tell(str(error))
        else:
            return rest, loaded, None, (newtons, _BY_EYE * newtons)


def _by_arm(
    bench: Bench,
    arm: GuardedArm,
    watch: _Watch,
    mesh: TriangleMesh,
    point: Vector3,
    inward: Vector3,
) -> _Push:
    """The arm approaches along the normal, presses to a force, holds, and retracts."""
    limits, wanted = arm.limits, float(bench.push_force or 0.0)
    above = point - limits.depth * inward
    check_push(limits, point, inward, clearance=limits.depth, force=wanted)
    arm.leave()
    try:
        for position in way_round(arm.pose(), above, mesh, clearance=limits.depth):
            arm.move(position, inward, limits.speed)
        arm.press_at(point, inward)
        rest = watch.seen_for(_REST)
        try:
            watch.state = "presses"
            _press(arm, watch, point, inward, wanted)
            watch.state = "holds"
            watch.seen_for(_DELIVERY)
            loaded = watch.seen_for(bench.hold, rest)
        finally:
            arm.move(above, inward, limits.speed)
        watch.state = "lifts off"
        after = watch.seen_for(_REST)
    except DeviceError:
        arm.stop()
        raise
    if (force := watch.force()) is None:
        raise PushError("the gauge shows no push that was held; is it in line with the tool?")
    return rest, loaded, after, _size(force.reading(), watch.questions)


def _press(arm: GuardedArm, watch: _Watch, point: Vector3, inward: Vector3, wanted: float) -> None:
    """Go down step by step until the tool presses with a force; each step knows a new reading. A
    gauge that does not feel the object stops the arm long before the largest depth does."""
    limits, forces = arm.limits, [0.0]
    zero = float(np.median(watch.reading))
    for depth in limits.depth * np.linspace(-1.0, 1.0, 2 * _STEPS + 1)[1:]:
        arm.move(point + depth * inward, inward, limits.speed)
        while not watch.read():
            time.sleep(_PAUSE)
        force = abs(watch.reading[-1] - zero)
        if force >= wanted:
            return
        limit = watch.bench.force.limit
        if limit is not None and abs(watch.reading[-1]) >= _FULL * limit:
            raise DeviceError(
                f"the arm was stopped: at {force:.2g} N of {wanted:g} N the gauge is at the end of"
                f" its range, {limit:g} N; ask for less force, or take a gauge of a larger range"
            )
        arm.felt(force)
        forces.append(force)
        if depth < 0.25 * limits.depth:
            continue
        before = forces[-1 - _STEPS // 4]
        if force - before < _FELT * wanted:
            raise DeviceError(
                f"the arm was stopped: {1e3 * depth:.2g} mm below the surface the gauge reads"
                f" {force:.2g} N, and read {before:.2g} N a quarter of the largest depth higher: is"
                " it connected and in line with the tool, and is the object there? If so, ask for"
                " less force, or raise [arm.limits] depth"
            )
    raise PushError(
        f"at the largest depth of {1e3 * limits.depth:g} mm the tool presses with {force:.2g} N of"
        f" {wanted:g} N: ask for less force, or raise [arm.limits] depth if that is safe"
    )


def way_round(
    here: Vector3, there: Vector3, mesh: TriangleMesh, *, clearance: float
) -> list[Vector3]:
    """Positions on a way that keeps clear of the object: out to a ball around it, along the ball,
    and in.

    Parameters
    ----------
    here, there : (3,) float [m]
    mesh : TriangleMesh             the object
    clearance : float [m]           of the ball from the object

    Returns
    -------
    list of (3,) float [m]          the last one is `there`
    """
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)) + clearance
    first, last = (x / np.linalg.norm(x) for x in (here - middle, there - middle))
    angle = float(np.arccos(np.clip(first @ last, -1.0, 1.0)))
    across = last - (first @ last) * first
    if np.linalg.norm(across) < _SAME:
        across = tangents_of(first)[0]
    across = across / np.linalg.norm(across)
    turns = np.linspace(0.0, angle, int(np.ceil(angle / _TURN)) + 1)
    around = [middle + radius * (np.cos(a) * first + np.sin(a) * across) for a in turns]
    return [*around, there]


def _size(reading: Reading, questions: Questions) -> tuple[float, float]:
    """Size of the force, whatever its sign, and its standard deviation [N]; creep is said."""
    size, std = float(np.linalg.norm(reading.force)), float(np.linalg.norm(reading.std))
    held = reading.end - reading.begin
    if abs(reading.creep) > _CREEPS:
        way = "fell" if reading.creep < 0.0 else "rose"
        questions.tell(
            f"The force {way} by {100 * abs(reading.creep):.0f} % in the {held:.1f} s it was held:"
            " the object creeps, or the tool did not stand still. E is that of about"
            f" {held / 2:.1g} s under load: hold every push as long, or record one that is held ten"
            " times as long as it rises"
        )
    return size, std


def _moved(chosen: list[_Grey], rest: Pictures) -> float:
    """Change over some pictures, over that since rest; noise taken off both."""
    half, shares = len(chosen) // 2, []
    for k, still in enumerate(rest):
        views = np.stack([pictures[k] for pictures in chosen]).astype(np.float32)
        noise = float(np.mean(np.diff(views, axis=0) ** 2)) / 2.0
        early, late = views[:half].mean(axis=0), views[half:].mean(axis=0)
        halves = noise * (1.0 / half + 1.0 / (len(chosen) - half))
        within = float(np.mean((late - early) ** 2)) - halves
        since = float(np.mean((views.mean(axis=0) - still) ** 2)) - noise / len(chosen)
        shares.append(np.sqrt(max(within, 0.0) / max(since, noise, 1e-6)))
    return float(np.median(shares))


def _brightness(picture: np.ndarray, rest: np.ndarray) -> float:
    """Grey levels over those at rest, of what is not dark: tool, hand and shadow hide a part."""
    lit = rest[::2, ::2] > DARK_LEVEL
    if not lit.any():
        return 1.0
    return float(np.median(picture[::2, ::2][lit] / rest[::2, ::2][lit].astype(np.float32)))


def _shaded(picture: np.ndarray, rest: np.ndarray) -> float:
    """Share of what can be recognised of a picture at rest that lies in a new shadow."""
    now, then = picture.astype(np.float32), rest.astype(np.float32)

    def mean(grey: np.ndarray) -> np.ndarray:
        return cv2.blur(grey, (_WINDOW, _WINDOW))

    level, before = mean(now), mean(then)
    contrast = mean(then**2) - before**2
    alike = (mean(now * then) - level * before) / np.sqrt(
        np.maximum(contrast * (mean(now**2) - level**2), 1e-6)
    )
    same = (before > DARK_LEVEL) & (contrast > _CONTRAST**2) & (alike > _ALIKE)
    if not same.any():
        return 0.0
    ratio = level[same] / before[same]
    return float((ratio < _DARKER * np.percentile(ratio, 90.0)).mean())


def _sharpness(loaded: Pictures, rest: Pictures) -> float:
    """Contrast of neighbouring pixels under load over that at rest, of the worst camera."""

    def contrast(picture: np.ndarray) -> float:
        return float(np.percentile(np.abs(cv2.Laplacian(picture, cv2.CV_32F)), _TEXTURED))

    return min(contrast(a) / max(contrast(b), 1e-6) for a, b in zip(loaded, rest, strict=True))
