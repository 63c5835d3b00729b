"""The guided measurement: devices looked at, object named, then push after push until the constants
are known as well as wanted.

Whatever goes wrong is said, with a way on; nothing here knows whether a person, a script or a page
in the browser answers.
"""

import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from palpate.bench.arms import check_push
from palpate.bench.bench_file import Bench, put
from palpate.bench.calibrating import CALIBRATED, calibrate_live, place_object
from palpate.bench.devices import DeviceError
from palpate.bench.live_session import LiveSession
from palpate.bench.page_parts import montage
from palpate.bench.pushing import PushError, grabbed, take_push, way_round, write_picture
from palpate.bench.questions import (
    CALIBRATION,
    DEVICES,
    OBJECT,
    PUSHES,
    REST,
    Questions,
    Stopped,
)
from palpate.bench.turning import SCANNED, scan_object
from palpate.bench.wanted import Wanted, wanted_lengths
from palpate.errors import InputError, PalpateError
from palpate.geometry import TriangleMesh, checked_mesh, unit_normals
from palpate.pipeline import FittedBody, NextProbings, first_place
from palpate.recording import (
    default_radius,
    flat_sides,
    likely_unit,
    read_surface,
    survey_folder,
)
from palpate.records import (
    BIASED,
    FILE_LENGTH_UNITS,
    FREE,
    Estimate,
    Session,
    Status,
    TomlTable,
    read_object_mesh,
    read_toml,
    verdict_text,
)
from palpate.shapes import Indices, Vector3

# A scale under the object reads a push whose direction has at least this component along its own.
_FROM_ABOVE = 0.7
# Triangles that a person says are held, in the session's folder.
_HELD_FILE = "support_triangles.txt"
_RIG = "rig.toml"
# The way of an arm to its first push; what a person can say to a push that failed.
_DRAWING = "first_push.png"
AGAIN, ELSEWHERE, STOP = "again", "elsewhere", "stop"
# How an object stands: keys of its support (a slippery plate: with the normal of the side), and of
# the errors. What stands loose may tilt and shift a little under a push, which is estimated, and is
# zero where it is glued after all. The softest pads, a centimetre of foam of 25 kPa, give as much.
LOOSE, GLUED, SLIPPERY, SOFT = _WAYS = (
    "loose", "glued or taped", "on a slippery plate", "on a soft pad"
)  # fmt: skip
_SOFTEST_PAD = "400 um/kPa"
# Tools that need no more than a radius, in a person's words.
_TOOLS = {"ball": "sphere", "flat round end": "flat"}
# What a session of the object at another place does not take over, and what is asked before one.
_OF_ONE_SESSION = ("format", "rig", "probe")
# Cosine between normals of triangles of one flat side.
_ONE_SIDE = 0.999
_IS_BACK = "Is it back where it was? If not, another session begins, with the object where it is"
_Places = list[tuple[Vector3, Vector3]]


def measure(
    bench: Bench,
    questions: Questions,
    folder: Path,
    *,
    until: Wanted | None = None,
    pushes: int | None = None,
    cache: Path | None = None,
    dry_run: bool = False,
) -> Estimate | None:
    """Measure an object push by push; the folder is a session after each.

    Parameters
    ----------
    bench : Bench
    questions : Questions
    folder : Path                   of the session; one that is there is gone on with
    until : Wanted or None          stop when this is reached
    pushes : int or None            stop after so many in the session; None: ask after each where
                                    nothing else ends it
    cache : Path or None            folder in which what is computed of the body is kept; None: in
                                    memory
    dry_run : bool                  say where the arm would press first, and stop

    Returns
    -------
    Estimate or None                of all pushes; None where there is none. Where the object was
                                    moved for good: of those since, whose folder has "-2" added

    Raises
    ------
    DeviceError                     a device that fails, where the person stops
    PalpateError                    as in `read_session`, `fit_session`
    """
    estimate: Estimate | None = None
    further: tuple[Bench, Path] | None = None
    with bench.closed_afterwards(), suppress(Stopped):
        questions.step(DEVICES)
        _start(bench, questions)
        questions.watch([camera.name for camera in bench.cameras], lambda: grabbed(bench)[1])
        _calibrate(bench, questions, folder, wanted_lengths(until))
        questions.step(OBJECT)
        session = _begun(bench, questions, folder, cache)
        bench = replace(bench, rig=session.rig)
        questions.known(session.rig)
        questions.body(session.mesh, session.bare.held_triangles)
        first = places = [first_place(session.bare, radius=session.contact_radius)]
        if dry_run:
            _rehearse(bench, questions, session, *places[0])
            return None
        questions.step(REST)
        _look(bench, questions, session)
        questions.step(PUSHES)
        judge = partial(_judged, bench, session, questions, until=until)
        if session.count:
            estimate, places = judge(session.measured())
        go = True
        if bench.arm is not None and bench.arm.asks and places:
            _rehearse(bench, questions, session, *places[0])
            go = questions.choose("Is that way free, and shall the arm go?", ["yes", "no"]) == "yes"
        while go and not _enough(session, estimate, until, pushes, questions):
            try:
                measured = _push(bench, session, questions, places)
            except _MovedAway:
                further = _beside(bench, session, questions)
                break
            except _Withdrawn:
                estimate, places = judge(session.measured()) if session.count else (None, first)
                continue
            if measured is None:
                break
            try:
                estimate, places = judge(measured)
            except InputError as error:
                session.withdraw()
                questions.tell(f"This push does not count: {error}")
                if questions.choose("Push again?", [AGAIN, STOP]) == STOP:
                    break
    if further is not None:
        again, folder = further
        return measure(again, questions, folder, until=until, pushes=pushes, cache=cache)
    return None if estimate is None else _of_all(session, estimate, questions)


def _of_all(session: LiveSession, last: Estimate, questions: Questions) -> Estimate:
    """The constants of all pushes at once, where there are several and the person waits; where the
    session is, is said."""
    with suppress(Stopped):
        if session.count > 1:
            with questions.working() as progress:
                fitted = session.fit(session.measured(), at_once=True, progress=progress)
            last = fitted.estimate
            questions.tell(f"All {session.count} pushes: {verdict_text(last)}")
        questions.tell(f"Session in {session.folder}; a report: palpate fit {session.folder}")
    return last


def _calibrate(bench: Bench, questions: Questions, folder: Path, wanted: float) -> None:
    """Calibrate cameras that are not, until lengths are known as well as wanted."""
    questions.step(CALIBRATION)
    if bench.rig is None and not any((folder / x).exists() for x in (_RIG, CALIBRATED)):
        _insisting(
            bench, questions, lambda: calibrate_live(bench, questions, folder, wanted=wanted)
        )


class _MovedAway(Exception):
    """The object is no longer where the session has it."""


class _Withdrawn(Exception):
    """The last push does not count after all."""


def _beside(bench: Bench, session: LiveSession, questions: Questions) -> tuple[Bench, Path]:
    """The bench of a further session, beside this one, of the object where it is now; only cameras
    that were calibrated here can find it there."""
    folder, number = session.folder, 2
    if not (folder / CALIBRATED).exists():
        questions.tell("Its rig is of the old place: give one of the new place, and another --out")
        raise Stopped
    while (further := folder.with_name(f"{folder.name}-{number}")).exists():
        number += 1
    shutil.copytree(folder / CALIBRATED, further / CALIBRATED)
    head = {key: session.content[key] for key in session.content if key not in _OF_ONE_SESSION}
    named = head["object"]["mesh"], head["support"].get("triangles")
    files = [name for name in named if isinstance(name, str)]

    def supply(into: Path) -> None:
        for name in files:
            put((folder / name).read_bytes(), into / name)

    questions.tell(
        f"Pushes up to {session.count} stay in {folder}; {further} begins, and what follows is of"
        " its pushes alone"
    )
    again = replace(bench, rig=None, head=head, contact=session.contact, supply=supply)
    return again, further


def _start(bench: Bench, questions: Questions, error: DeviceError | None = None) -> None:
    """Start the devices, again where one has failed, until all are there; the error where the
    person stops."""
    remaining = list(bench.devices)
    while True:
        if error is not None:
            questions.tell(str(error))
            if questions.choose("Go on?", [AGAIN, STOP]) == STOP:
                raise error
        try:
            with questions.working() as progress:
                progress("cameras and gauge", 0.0)
                while remaining:
                    remaining[0].close()
                    remaining[0].start()
                    del remaining[0]
            return
        except DeviceError as another:
            error = another


def _insisting(bench: Bench, questions: Questions, do: Callable[[], object]) -> None:
    """Do something, again where a device fails in it and was mended."""
    while True:
        try:
            do()
            return
        except DeviceError as error:
            _start(bench, questions, error)


def _begun(bench: Bench, questions: Questions, folder: Path, cache: Path | None) -> LiveSession:
    """The session, once object, support and tool are known."""
    for camera in bench.cameras:
        shown = ", ".join(f"{key} {value}" for key, value in camera.settings.items())
        questions.tell(f"Camera {camera.name}: {shown}")
    bench.supply(folder)
    head: dict[str, Any] = {"name": bench.name, **bench.head, "rig": {"cameras": _RIG}}
    before = _before(folder)
    before_contact = before.pop("contact", None)
    contact = bench.contact or before_contact
    if "object" in head and "support" in head:
        head["object"] = {**head["object"], "mesh": Path(head["object"]["mesh"]).name}
    else:
        head |= before or _asked_object(bench, questions, folder)
    if contact is None:
        unit = head["object"]["length_unit"]
        usual = f"{default_radius(read_surface(survey_folder(folder), head['object']['mesh'])):g}"
        contact = _asked_tool(questions, unit, usual)
    if not (folder / _RIG).exists():
        body = TomlTable(folder / "session.toml", "", head).table("object")
        units = FILE_LENGTH_UNITS
        mesh, _ = read_object_mesh(body, units[body.choice("length_unit", tuple(units))])
        _insisting(bench, questions, lambda: place_object(bench, questions, folder, mesh))
    return LiveSession(folder, head, contact, by_hand=bench.arm is None, cache=cache)


def _before(folder: Path) -> dict[str, Any]:
    """What a person said of the object and the tool when the session was begun."""
    if not (folder / "session.toml").exists():
        return {}
    there = read_toml(folder / "session.toml")
    contact = there.tables("probe")[0].table("contact").values
    return {
        **{key: there.table(key).values for key in ("object", "support")},
        "contact": {key: contact[key] for key in ("tool", "tool_radius") if key in contact},
    }


def _asked_object(bench: Bench, questions: Questions, folder: Path) -> dict[str, Any]:
    """Tables object and support, as `palpate init` asks for them; the mesh goes into the folder."""
    there, rig = bench.folder, folder / CALIBRATED / _RIG
    if not survey_folder(there).meshes:
        if not rig.exists():
            raise InputError(
                f"{there}: holds no surface of the object (PLY, STL, OBJ, ...); put it there, or"
                " calibrate here with a board, without [rig], and it is scanned"
            )
        there = folder
        if not (folder / SCANNED).exists():
            _insisting(bench, questions, lambda: scan_object(bench, questions, folder, rig))
    survey = survey_folder(there)
    name, *others = survey.meshes
    if others:
        name = questions.choose("Which file is the object?", list(survey.meshes))
    surface = read_surface(survey, name)
    likely = "m" if name == SCANNED else likely_unit(surface)
    questions.body(_in_metres(surface, likely), np.zeros(0, dtype=np.int64))
    units = [likely, *(unit for unit in FILE_LENGTH_UNITS if unit != likely)]
    size = " x ".join(f"{x:.3g}" for x in np.ptp(surface.vertices, axis=0))
    unit = "m" if name == SCANNED else questions.choose(f"{name} is {size}; in which unit?", units)
    mesh = _in_metres(surface, unit)
    faces = {}
    for side in flat_sides(mesh):
        on_it = (mesh.vertices - side.point) @ side.normal > -side.tolerance
        faces[side.name] = np.flatnonzero(on_it[mesh.triangles].all(axis=1))
    held, stands = _asked_support(questions, mesh, faces)
    put((there / name).read_bytes(), folder / Path(name).name)
    put("".join(f"{row}\n" for row in held).encode(), folder / _HELD_FILE)
    return {"object": {"mesh": Path(name).name, "length_unit": unit}, **stands}


def _asked_support(
    questions: Questions, mesh: TriangleMesh, faces: Mapping[str, Indices]
) -> tuple[Indices, dict[str, Any]]:
    """Triangles that are held; tables support and, where that may give, errors."""
    while True:
        held, way = questions.face(mesh, faces, _WAYS)
        support: dict[str, Any] = {"triangles": _HELD_FILE}
        if way == SOFT:
            return held, {"support": support, "errors": {"support_compliance": _SOFTEST_PAD}}
        if way == LOOSE:
            support["motion"] = FREE
        if way == SLIPPERY:
            normals = unit_normals(mesh)[held]
            if (normals @ normals[0]).min() < _ONE_SIDE:
                questions.tell("A slippery plate holds one flat side: mark that alone")
                continue
            support["directions"] = [normals[0].tolist()]
        return held, {"support": support}


def _in_metres(surface: TriangleMesh, unit: str) -> TriangleMesh:
    """The surface as a session has it."""
    scaled = TriangleMesh(FILE_LENGTH_UNITS[unit] * surface.vertices, surface.triangles)
    return checked_mesh(scaled)[0]


def _asked_tool(questions: Questions, unit: str, usual: str) -> dict[str, Any]:
    """Keys of every probing's contact."""
    name = questions.choose("What presses?", list(_TOOLS))
    while True:
        text = questions.ask(f"Radius of the {name}, in {unit}", usual)
        with suppress(ValueError):
            if (radius := float(text)) > 0.0:
                return {"tool": _TOOLS[name], "tool_radius": radius}
        questions.tell(f'"{text}" is no radius; it is a number above zero, such as {usual}')


def _look(bench: Bench, questions: Questions, session: LiveSession) -> None:
    """Check the pictures at rest until they are good, or the person goes on regardless."""
    while True:
        try:
            views = [grabbed(bench)[1] for _ in range(2)]
            with questions.working() as progress:
                progress("the pictures at rest", 0.0)
                notes, good = session.look(*views)
        except DeviceError as error:
            _start(bench, questions, error)
            continue
        except InputError as error:
            notes, good = (str(error),), False
        for note in notes:
            questions.tell(note)
        if good or questions.choose("Look again, once that is better?", ["yes", "no"]) == "no":
            return


def _push(
    bench: Bench, session: LiveSession, questions: Questions, places: _Places
) -> Session | None:
    """One push that can be used, whatever comes between; None: the person stops. An arm that fails
    at a place would fail there again: it goes to the next best one, while there are any."""
    while places:
        point, inward = places[0]
        try:
            taken = take_push(bench, questions, session.mesh, point, inward)
            with questions.working() as progress:
                progress("displacements from the pictures", 0.0)
                slid, moved = session.slid_since(taken.rest), session.moved(taken.rest)
                measured = None if moved or slid else session.add(taken, point, inward)
            if slid:
                questions.tell(
                    f"Push {session.count} does not count after all, nor does this one: the object"
                    f" slid by {1e3 * slid:.2g} mm under it, or was moved since; glue or tape it"
                    " down, or press less hard"
                )
                session.withdraw()
                raise _Withdrawn
            if measured is not None:
                questions.tell(f"Push {session.count} is taken: {taken.force:.3g} N")
                return measured
            questions.tell(
                f"This push does not count: the object has moved by {1e3 * moved:.2g} mm since the"
                " first push"
            )
            if questions.choose(_IS_BACK, ["yes", "no"]) == "no":
                raise _MovedAway
            continue
        except PushError as error:
            questions.tell(f"This push does not count: {error}")
        except DeviceError as error:
            _start(bench, questions, error)
            continue
        again = AGAIN if bench.arm is None else ELSEWHERE
        if questions.choose("Push again?", [again, STOP]) == STOP:
            return None
        places = places if bench.arm is None else places[1:]
    return None


def _judged(
    bench: Bench,
    session: LiveSession,
    questions: Questions,
    measured: Session,
    *,
    until: Wanted | None,
) -> tuple[Estimate, _Places]:
    """Fit all pushes and report the constants; gives the places for the next push, best first."""
    with questions.working() as progress:
        result = session.fit(measured, progress=progress)
    estimate = result.estimate
    questions.tell(f"After push {session.count}: {verdict_text(estimate)}")
    # What differs from place to place or contradicts the model, and what is about this push, such
    # as that it went too deep.
    uneven = estimate.status in (Status.HETEROGENEOUS, Status.MODEL_CONTRADICTED)
    for k, note in enumerate(estimate.notes):
        if BIASED not in note and (measured.probings[-1].name in note or (uneven and k == 0)):
            questions.tell(note)
    questions.judged(estimate)
    try:
        return estimate, _further(bench, session, questions, measured, result, until)
    except InputError as error:
        # This push counts all the same.
        questions.tell(f"That was the last push: {error}")
        return estimate, []


def _further(
    bench: Bench,
    session: LiveSession,
    questions: Questions,
    measured: Session,
    fitted: FittedBody,
    until: Wanted | None,
) -> _Places:
    """The places for the next push, best first, and how many it takes."""
    try:
        with questions.working() as progress:
            plan = session.plan(measured, fitted, progress=progress)
    except PalpateError as error:
        questions.tell(f"Where to push next is not clear yet: {error}")
        bare = replace(session.bare, probings=measured.probings, steps=())
        return [first_place(bare, radius=session.contact_radius)]
    if until is not None:
        questions.tell(_still_needed(fitted.estimate, plan, until))
    return _allowed(bench, plan)


def _still_needed(estimate: Estimate, plan: NextProbings, until: Wanted) -> str:
    """How many more pushes the wanted precision takes, in words."""
    share = until.share(estimate)
    if share <= 1.0:
        return "That is as precise as wanted."
    now = plan.now[until.constant]
    for count, after in enumerate(plan.after, start=1):
        if share * after[until.constant] / now <= 1.0:
            return f"About {count} more for the wanted precision."
    return f"More than {len(plan.after)} more for the wanted precision."


def _allowed(bench: Bench, plan: NextProbings) -> _Places:
    """The places that scale and arm allow, the best first."""
    places = []
    order = [*plan.chosen, *(k for k in range(len(plan.point)) if k not in plan.chosen)]
    for k in order:
        point, inward = plan.point[k], plan.inward[k]
        if bench.direction is not None and inward @ bench.direction < _FROM_ABOVE:
            continue
        try:
            _check(bench, point, inward)
        except InputError:
            continue
        places.append((point, inward))
    if places:
        return places
    raise InputError("no further place is within what the scale reads and the arm's limits allow")


def _check(bench: Bench, point: Vector3, inward: Vector3) -> None:
    if bench.arm is not None:
        limits = bench.arm.limits
        force = float(bench.push_force or 0.0)
        check_push(limits, point, inward, clearance=limits.depth, force=force)


def _rehearse(
    bench: Bench, questions: Questions, session: LiveSession, point: Vector3, inward: Vector3
) -> None:
    """Say and draw what the arm would do, without moving it."""
    _check(bench, point, inward)
    if bench.arm is None:
        questions.tell("There is no arm: a person presses.")
        return
    limits = bench.arm.limits
    above, speed = point - limits.depth * inward, 1e3 * limits.speed
    here = bench.arm.pose()
    way = [here, *way_round(here, above, session.mesh, clearance=limits.depth), point]
    questions.place(point, inward, way)
    names, drawing = [camera.name for camera in bench.cameras], session.folder / _DRAWING
    sheet = montage(names, grabbed(bench)[1], session.rig, target=(point, inward), way=way)
    write_picture(drawing, sheet)
    questions.tell(
        f"From {_mm(here)} mm round the object to {_mm(above)} mm at {speed:.3g} mm/s;"
        f" down along {np.round(inward, 3).tolist()} to {_mm(point)} mm and on, up to"
        f" {bench.push_force:g} N, never beyond {limits.force:g} N or {1e3 * limits.depth:.3g} mm"
        f" deep; hold for {bench.hold:g} s, and back to {_mm(above)} mm. Drawn in {drawing}"
    )


def _mm(position: Vector3) -> str:
    return str(np.round(1e3 * position, 1).tolist())


def _enough(
    session: LiveSession,
    estimate: Estimate | None,
    until: Wanted | None,
    pushes: int | None,
    questions: Questions,
) -> bool:
    """Whether the measurement ends here."""
    if pushes is not None and session.count >= pushes:
        return True
    if estimate is None:
        return False
    if until is not None:
        return until.share(estimate) <= 1.0
    return pushes is None and questions.choose("Another push?", ["yes", "no"]) == "no"
