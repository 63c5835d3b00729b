"""Commands that put a model to use: `palpate poke` presses it, `view` shows it, `export` writes it
for a simulator."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from rich.table import Table

from palpate.app.process import check_cache
from palpate.app.tables import terminal_table
from palpate.app.terminal import (
    Force,
    Length,
    Modulus,
    Place,
    Places,
    print_notes,
    print_tables,
    print_text,
    progress_bar,
)
from palpate.bem import InteriorState, check_memory
from palpate.errors import InputError
from palpate.geometry import bounding_diagonal
from palpate.pipeline import (
    PokedState,
    poke_session,
    read_modulus,
    tool_contact,
    von_mises_stress,
)
from palpate.records import (
    MODULUS_RANGE,
    ModulusMap,
    Status,
    check_free,
    default_folder,
    modulus_unit,
    read_estimate,
    read_session,
    record_inputs,
    result_folder,
)
from palpate.shapes import Points
from palpate.simulation import FORMATS, export_fit, read_fit
from palpate.viewer import Viewer, read_subject, write_screenshot, write_turntable

# Newtons that no tool has; and of the object's size, what is no small deformation.
_LARGEST_FORCE, _SMALL_DEFORMATION = 1e9, 0.1
# Rows and columns of the stress that are shown, by their names.
_COMPONENTS = {
    "sxx": (0, 0), "syy": (1, 1), "szz": (2, 2), "sxy": (0, 1), "syz": (1, 2), "szx": (2, 0),
}  # fmt: skip
Simulator = Literal[
    "mujoco", "calculix", "febio", "sofa", "vtu", "openusd", "obj", "genesis", "isaaclab", "npz"
]


def poke(
    session: Path,
    /,
    *,
    force: Force,
    at: Place,
    interior: Places | None = None,
    radius: Length | None = None,
    result: Path | None = None,
    young_modulus: Modulus | None = None,
    shear_modulus: Modulus | None = None,
    poisson_ratio: float | None = None,
    surface: Literal["smooth", "flat"] = "smooth",
    cache: Path | None = None,
) -> int:
    """Press a tool on a session's object: how deep it goes, and where it strains.

    Lengths are in metres and forces in newtons, or with their unit ("12 mm", "1.2 N", "50 kPa"), in
    the frame of the session's mesh. The material
    is that of a result folder of `palpate fit` (--result), or a modulus and Poisson's ratio.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it; or a result folder of `palpate fit`, whose
        session and constants are taken.
    force
        Force of the tool on the object, N, or with its unit: --force 0.3N 0N -0.8N.
    at
        Centre of the contact on the surface, m, or with its unit: --at 0mm 0mm 30mm.
    interior
        A point inside the object, m or with its unit, where displacement and stress are shown; may
        be given several times.
    radius
        Radius of the contact, m, or with its unit: 3mm. Default: that of the session's first
        probing, or the contact its tool makes under the force.
    result
        Result folder of `palpate fit`, or its estimate.json.
    young_modulus
        Young's modulus, Pa, or with its unit: 60kPa; with --poisson-ratio.
    shear_modulus
        Shear modulus, Pa, or with its unit: 23kPa; with --poisson-ratio.
    poisson_ratio
        Poisson's ratio.
    surface
        How to read the mesh: as points on a smooth object (with edges where triangles meet at more
        than 40 degrees), or as flat facets.
    cache
        Folder in which to keep intermediate results for this object, for faster later runs.

    Returns
    -------
    int
        0.
    """
    fit = read_fit(session) if (session / "estimate.json").is_file() else None
    if fit is not None and (young_modulus, shear_modulus, poisson_ratio) == (None, None, None):
        result = result or session
    shear, ratio = _material(result, young_modulus, shear_modulus, poisson_ratio)
    modulus = None if result is None else _modulus(result)
    if not any(force):
        raise InputError("--force is zero; give the force of the tool in newtons: --force 0 0 -1")
    check_cache(cache)
    if np.abs(force).max() > _LARGEST_FORCE:
        raise InputError(
            f"--force is {_numbers(force)}; must be newtons, at most {_LARGEST_FORCE:g}"
        )
    if fit is not None:
        given = fit.session
        print_notes(fit.notes)
    else:
        given = read_session(session, allow=lambda count, _: check_memory(count))
    print_notes(given.notes)
    contact = tool_contact(given, np.array(at), radius)
    points = None if interior is None else np.array(interior)
    given = replace(given, smooth=surface == "smooth")
    with progress_bar("a coarser mesh, or --cache for another time") as progress:
        state = poke_session(
            given, np.array(force), contact, shear_modulus=shear, poisson_ratio=ratio,
            modulus=modulus, interior=points, cache=cache, progress=progress,
        )  # fmt: skip
    moved = float(np.linalg.norm(state.largest)) / bounding_diagonal(given.mesh)
    if moved > _SMALL_DEFORMATION:
        note = (
            f"The object would move by {moved:.2g} times its size: outside small deformation, for"
            " which alone this holds; check force and constants, or press less."
        )
        print_notes([note])
    factor, unit = modulus_unit(shear)
    print_text(
        f"{given.name}: G = {shear / factor:.4g} {unit}, nu = {ratio:.4g}; a force of"
        f" ({_numbers(force)}) N over a radius of {1e3 * (state.contact.radius or 0.0):.3g} mm;"
        f" the support answers with ({_numbers(state.reaction)}) N"
    )
    print_tables(_displacement_table(state, points))
    if state.interior is not None:
        print_tables(_stress_table(state.interior))
    return 0


def view(
    subject: Path,
    /,
    *,
    session: Path | None = None,
    port: int | None = None,
    screenshot: Path | None = None,
    turntable: Path | None = None,
    probe: str | None = None,
    cache: Path | None = None,
    force: bool = False,
) -> int:
    """View an object in the browser: its probings, what the model predicts, how it feels.

    Colours show measured and predicted motion; sliders change the constants; a click presses a ball
    into the object, or sets support and contacts. The page is served by this computer, to this
    computer only, and only to who has the address that is printed. Ctrl-C ends it.

    Parameters
    ----------
    subject
        Session folder, or result folder of `palpate fit`.
    session
        Present location of a result's session, if it was moved.
    port
        Port of the page. Default: 8080, or the next free one.
    screenshot
        Write a picture (.png, .jpg) instead; needs neither browser nor display.
    turntable
        Write a turntable film (.mp4, .gif) instead.
    probe
        Probing to show in a picture or film. Default: the first.
    cache
        Folder in which to keep intermediate results for this object, for faster later runs.
    force
        Replace a picture or film of that name.

    Returns
    -------
    int
        0.
    """
    if screenshot is None and turntable is None and probe is not None:
        raise InputError("--probe is for --screenshot and --turntable; choose it in the page")
    for target in (screenshot, turntable):
        if target is not None:
            check_free(target, force=force)
    check_cache(cache)
    subject_read = read_subject(subject, session)
    if screenshot is not None:
        write_screenshot(subject_read, screenshot, probe=probe)
        print_text(f"Picture in {screenshot}", wrapped=False)
    if turntable is not None:
        with progress_bar("a coarser mesh") as progress:
            write_turntable(subject_read, turntable, probe=probe, progress=progress)
        print_text(f"Film in {turntable}", wrapped=False)
    if screenshot is None and turntable is None:
        _serve(Viewer(subject_read, port=port, cache=cache))
    return 0


def export(
    result: Path,
    /,
    *,
    to: Simulator,
    out: Path | None = None,
    probe: str | None = None,
    edge: Length | None = None,
    nodes: int | None = None,
    session: Path | None = None,
    cache: Path | None = None,
    force: bool = False,
) -> int:
    """Write an estimated object for a simulator: its shape, support and constants, and one push.

    Writes a folder with the simulator's files, and a README.txt and palpate.json that give the
    constants with their intervals and what was changed for the simulator.

    Parameters
    ----------
    result
        Result folder of `palpate fit`.
    to
        The simulator.
    out
        Folder; it appears whole or not at all. Default: the result folder's name followed by the
        simulator's, in the current folder.
    probe
        Probing to include, for replay in the simulator. Default: the first one left out of the
        estimate, else the first.
    edge
        Edge of the tetrahedra away from the contact, m, or with its unit: 3mm. Default: a ninth of
        the cube root of the volume.
    nodes
        At most about so many nodes, for real time (500), in simulators with linear tetrahedra
        (mujoco, sofa, openusd); their modulus is written so that the push moves as it should.
    session
        Present location of the result's session, if it was moved.
    cache
        Folder in which to keep intermediate results for this object, for faster later runs.
    force
        Overwrite even if the target is not an unchanged export to this simulator; the old content
        is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    check_cache(cache)
    target = out or default_folder(result, to)
    with result_folder(target, kind=f"export --to {to}", force=force) as folder:
        source = read_fit(result, session)
        record_inputs(folder, source.files)
        with progress_bar("a larger --edge") as progress:
            body = export_fit(
                folder,
                source,
                to,
                probe=probe,
                edge=edge,
                nodes=nodes,
                cache=cache,
                progress=progress,
            )
    print_notes(body.notes)
    if body.push is not None:
        how = "left out of the estimate" if body.push.held_out else "used in the estimate"
        print_text(f"Push written along: probing {body.push.name}, {how}")
    print_text(f"{FORMATS[to].title} files in {target}; README.txt there says how to run them")
    return 0


def _material(
    result: Path | None, young: float | None, shear: float | None, ratio: float | None
) -> tuple[float, float]:
    """Shear modulus [Pa] and Poisson's ratio from a result folder or from the command line."""
    moduli = [modulus for modulus in (young, shear) if modulus is not None]
    if result is not None and not moduli and ratio is None:
        return _estimated_constants(result)
    if result is not None or len(moduli) != 1 or ratio is None:
        raise InputError(
            "give the material in one way: a result of `palpate fit` in place of the session,"
            " --result FOLDER, or --poisson-ratio with either --young-modulus or --shear-modulus"
        )
    softest, stiffest = MODULUS_RANGE
    if not softest <= moduli[0] <= stiffest:
        option = "--young-modulus" if shear is None else "--shear-modulus"
        raise InputError(
            f"{option} is {moduli[0]:g}; must be {softest:g} to {stiffest:g} Pa, from the"
            " softest gel to diamond"
        )
    if not -1.0 < ratio <= 0.5:
        raise InputError(f"--poisson-ratio is {ratio:g}; must be above -1, and 0.5 at most")
    return (shear, ratio) if shear is not None else (moduli[0] / (2.0 * (1.0 + ratio)), ratio)


def _estimated_constants(result: Path) -> tuple[float, float]:
    """The constants of an estimate; a note where the data did not determine all of them."""
    estimate = read_estimate(result / "estimate.json" if result.is_dir() else result)
    if estimate.status is not Status.OK:
        print_notes([f"{result}: {estimate.status.advice}"])
    shear, ratio = estimate.shear_modulus.value, estimate.poisson_ratio.value
    if not np.isfinite([shear, ratio]).all():
        raise InputError(
            f"{result}: its estimate has no value of the shear modulus or of Poisson's ratio; give"
            " --shear-modulus and --poisson-ratio"
        )
    return shear, ratio


def _modulus(result: Path) -> ModulusMap | None:
    """The map of the modulus beside an estimate, where there is one."""
    return read_modulus((result if result.is_dir() else result.parent) / "modulus.npz")


def _displacement_table(poked: PokedState, points: Points | None) -> Table:
    """Displacement of the contact point, of the vertex that moves most, and inside."""
    places = [
        ("contact", poked.contact.point, poked.displacement),
        ("largest", poked.largest_point, poked.largest),
    ]
    if points is not None and poked.interior is not None:
        inside = zip(points, poked.interior.displacement, strict=True)
        places += [(f"inside {k}", *pair) for k, pair in enumerate(inside, start=1)]
    rows = [
        (name, _numbers(1e3 * point), _numbers(1e3 * u), f"{1e3 * np.linalg.norm(u):.3g}")
        for name, point, u in places
    ]
    columns = ("where", "point mm", "displacement mm", "length mm")
    caption = "contact: under the tool's centre; largest: the vertex that moves most"
    return terminal_table("Displacement", columns, rows, caption=caption)


def _stress_table(inside: InteriorState) -> Table:
    equivalent = von_mises_stress(inside.stress)
    factor, unit = modulus_unit(float(equivalent.max()))
    rows = []
    for k, (stress, mises) in enumerate(zip(inside.stress, equivalent, strict=True), start=1):
        components = np.array([stress[index] for index in _COMPONENTS.values()]) / factor
        rows.append((f"inside {k}", *_numbers(components).split(", "), f"{mises / factor:.3g}"))
    title = f"Stress inside ({unit}, tension positive)"
    return terminal_table(title, ("where", *_COMPONENTS, "von Mises"), rows)


def _numbers(vector: Sequence[float] | Float[np.ndarray, " n"]) -> str:
    """Components with as many decimals as show three digits of the largest."""
    largest = float(np.abs(vector).max())
    decimals = 0 if largest == 0.0 else max(2 - math.floor(math.log10(largest)), 0)
    # What is rounded to zero has no sign.
    return ", ".join(f"{round(float(x), decimals) + 0.0:.{decimals}f}" for x in vector)


def _serve(viewer: Viewer) -> None:
    """Serve the page until somebody ends it."""
    print_text(f"Open {viewer.address} in a browser; Ctrl-C ends it", wrapped=False)
    try:
        while True:
            time.sleep(1.0)
    except KeyboardInterrupt:
        print_text("The viewer has ended")
    finally:
        viewer.stop()
