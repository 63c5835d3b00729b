"""`palpate poke`: a push that was never measured, and where it strains."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter
from jaxtyping import Float
from rich.table import Table

from palpate.app.environment import check_cache
from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import terminal_table
from palpate.app.units import Force, Length, Modulus, Place
from palpate.bem import InteriorState, check_memory
from palpate.errors import InputError
from palpate.geometry import bounding_diagonal
from palpate.pipeline import PokedState, poke_session, tool_contact, von_mises_stress
from palpate.records import MODULUS_RANGE, Status, modulus_unit, read_estimate, read_session
from palpate.shapes import Points
from palpate.simulation import read_fit

_Triple = tuple[float, float, float]
# Newtons that no tool has; and of the object's size, what is no small deformation.
_LARGEST_FORCE, _SMALL_DEFORMATION = 1e9, 0.1
# Rows and columns of the stress that are shown, by their names.
_COMPONENTS = {
    "sxx": (0, 0), "syy": (1, 1), "szz": (2, 2), "sxy": (0, 1), "syz": (1, 2), "szx": (2, 0),
}  # fmt: skip


def poke(
    session: Path,
    /,
    *,
    force: Force,
    at: Place,
    interior: Annotated[list[_Triple] | None, Parameter(consume_multiple=True)] = None,
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
        Points inside the object, m, three numbers each: displacement and stress are shown there.
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
    with progress_bar() as progress:
        found = poke_session(
            given, np.array(force), contact, shear_modulus=shear, poisson_ratio=ratio,
            interior=points, cache=cache, progress=progress,
        )  # fmt: skip
    moved = float(np.linalg.norm(found.largest)) / bounding_diagonal(given.mesh)
    if moved > _SMALL_DEFORMATION:
        note = (
            f"The object would move by {moved:.2g} times its size: outside small deformation, for"
            " which alone this holds; check force and constants, or press less."
        )
        print_notes([note])
    factor, unit = modulus_unit(shear)
    print_text(
        f"{given.name}: G = {shear / factor:.4g} {unit}, nu = {ratio:.4g}; a force of"
        f" ({_numbers(force)}) N over a radius of {1e3 * (found.contact.radius or 0.0):.3g} mm;"
        f" the support answers with ({_numbers(found.reaction)}) N"
    )
    print_tables(_displacement_table(found, points))
    if found.interior is not None:
        print_tables(_stress_table(found.interior))
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


def _displacement_table(found: PokedState, points: Points | None) -> Table:
    """Displacement of the contact point, of the vertex that moves most, and inside."""
    places = [
        ("contact", found.contact.point, found.displacement),
        ("largest", found.largest_point, found.largest),
    ]
    if points is not None and found.interior is not None:
        inside = zip(points, found.interior.displacement, strict=True)
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
        components = np.array([stress[place] for place in _COMPONENTS.values()]) / factor
        rows.append((f"inside {k}", *_numbers(components).split(", "), f"{mises / factor:.3g}"))
    title = f"Stress inside ({unit}, tension positive)"
    return terminal_table(title, ("where", *_COMPONENTS, "von Mises"), rows)


def _numbers(vector: Sequence[float] | Float[np.ndarray, " n"]) -> str:
    """Components with as many decimals as show three digits of the largest."""
    largest = float(np.abs(vector).max())
    decimals = 0 if largest == 0.0 else max(2 - math.floor(math.log10(largest)), 0)
    # What is rounded to zero has no sign.
    return ", ".join(f"{round(float(x), decimals) + 0.0:.{decimals}f}" for x in vector)
