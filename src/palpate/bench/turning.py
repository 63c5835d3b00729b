"""A surface for an object that has none: it is turned before the calibrated cameras, view by view.

Pictures stay in `scan` with their scan.toml: begun again, it goes on, and `palpate scan` reads it.
"""

import itertools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import tomlkit

from palpate.bench.bench_file import Bench
from palpate.bench.pushing import grabbed, write_picture
from palpate.bench.questions import Questions
from palpate.disk import write_bytes
from palpate.errors import InputError, PalpateError
from palpate.geometry import triangle_areas, write_mesh
from palpate.scanning import (
    SCAN_FILE,
    SCAN_FORMAT,
    View,
    plane_from_text,
    plane_text,
    posed,
    read_scan,
    scan_surface,
)

SCANNED, TURNS = "scanned.ply", "scan"
# The table, where the board lay; what is lower than this above it is its own texture [m].
_TABLE, _ABOVE = plane_from_text("z=0"), 1e-3
_VERTICES = 1000
# Turns between two views, and how far the table may seem to tilt [degrees].
_LEAST, _MOST, _TILT = 10.0, 50.0, 3.0
_NEXT, _ALL = "it is turned", "all sides were seen"


def scan_object(bench: Bench, questions: Questions, folder: Path, rig: Path) -> None:
    """Make `scanned.ply` of an object that a person turns, in the frame of the rig, as the object
    stands in the last view.

    Parameters
    ----------
    bench : Bench                   started
    questions : Questions
    folder : Path                   of the session
    rig : Path                      the cameras, in the frame of the table, z up

    Raises
    ------
    DeviceError                     a camera that fails; the views so far stay
    """
    turns, first = folder / TURNS, bench.cameras[0].name
    turns.mkdir(exist_ok=True)
    names = sorted(path.name.removesuffix(f"_{first}.png") for path in turns.glob(f"*_{first}.png"))
    views = _views(questions, turns, rig, names)
    angles = [_turned(*pair) for pair in itertools.pairwise(views)]
    while True:
        so_far = f"{len(views)} views, turned by {abs(sum(angles)):.0f} degrees in all"
        turn = f"{so_far}. Turn it by some 30 degrees where it stands, always the same way"
        if not views:
            questions.wait("Put the object where the board lay, and hands out of the pictures")
        elif questions.choose(turn, [_NEXT, _ALL]) == _ALL:
            try:
                _list(turns, rig, names)
                return _join(questions, folder, views)
            except PalpateError as error:
                questions.tell(str(error))
                continue
        name, pictures = f"{len(names):03d}", grabbed(bench)[1]
        # The first camera's last: with it the view is there.
        for camera, picture in reversed(list(zip(bench.cameras, pictures, strict=True))):
            write_picture(turns / f"{name}_{camera.name}.png", picture)
        try:
            (view,) = _views(questions, turns, rig, [name])
            turned = [_turned(before, view) for before in views[-1:]]
        except PalpateError as error:
            questions.tell(f"This view does not count: {error}")
            (turns / f"{name}_{first}.png").unlink()
        else:
            names, views, angles = [*names, name], [*views, view], [*angles, *turned]


def _turned(before: View, view: View) -> float:
    """By what angle the object was turned on the table between two views [degrees]."""
    there = posed([view, before])[1]
    turn = np.linalg.lstsq(before.normals, there.normals)[0].T
    angle = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    tilt = float(np.degrees(np.arccos(np.clip(turn[2, 2], -1.0, 1.0))))
    if tilt > _TILT or not _LEAST < abs(angle) < _MOST:
        raise InputError(
            f"it looks as if it had been turned by {angle:.0f} degrees, and tilted by {tilt:.0f}:"
            f" must be {_LEAST:g} to {_MOST:g} degrees where it stands; turn it back by half, or"
            " give a mesh if its shape does not tell how it is turned"
        )
    return angle


def _views(questions: Questions, turns: Path, rig: Path, names: list[str]) -> list[View]:
    """What pictures show above the table, in the order they were taken."""
    if not names:
        return []
    _list(turns, rig, names)
    with questions.working() as progress:
        views = read_scan(turns, progress=progress).views[::-1]
    above = [_TABLE.heights(view.points) > _ABOVE for view in views]
    return [
        replace(view, points=view.points[k], normals=view.normals[k], sigma=view.sigma[k])
        for view, k in zip(views, above, strict=True)
    ]


def _list(turns: Path, rig: Path, names: list[str]) -> None:
    """Write scan.toml, the latest view first: the frame of all is that of the first one listed."""
    content = {
        "format": SCAN_FORMAT, "length_unit": "m", "support": plane_text(_TABLE),
        "rig": {"cameras": os.path.relpath(rig, turns)},
        "view": [{"images": f"{name}_{{camera}}.png"} for name in reversed(names)],
    }  # fmt: skip
    write_bytes(turns / SCAN_FILE, tomlkit.dumps(content).encode())


def _join(questions: Questions, folder: Path, views: list[View]) -> None:
    """Write the surface of all views."""
    with questions.working() as progress:
        made = scan_surface(
            views[::-1], vertices=_VERTICES, support=_TABLE, progress=progress
        )  # fmt: skip
    write_mesh(folder / SCANNED, made.mesh)
    area = triangle_areas(made.mesh)
    size = " x ".join(f"{1e3 * x:.3g}" for x in np.ptp(made.mesh.vertices, axis=0))
    questions.tell(
        f"The object is {size} mm; no view shows {100 * area[made.guessed].sum() / area.sum():.0f}"
        " % of its surface, the side it stands on among it: that is guessed"
    )
