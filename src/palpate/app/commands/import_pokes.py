"""`palpate import pokes`: a robot's pokes, without pictures, as a session."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from palpate.app.terminal import print_notes, print_text
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, checked_mesh, read_mesh
from palpate.recording import Pokes, height_field, read_pokes, write_pokes
from palpate.records import (
    FRICTIONS,
    LENGTH_UNITS,
    MODULUS_RANGE,
    TOOLS,
    modulus_unit,
    quantity,
    read_poke_table,
    record_inputs,
    result_folder,
)

# Young's modulus [Pa] from which a body is stiffer than what is poked by hand or for a surgeon, and
# what grams taken for newtons make of one: a hundred times as much.
_STIFF = 1e6
_GRAM = 9.80665e-3
# Of a tool and of a body that is poked [m]: larger ones are millimetres without their unit.
_LARGEST = 0.5
_Length = Literal["um", "mm", "cm", "m", "in"]
_Columns = Annotated[list[str] | None, Parameter(consume_multiple=True)]


def import_pokes(
    table: Path,
    /,
    *,
    tool: Literal["sphere", "flat"] = "sphere",
    tool_radius: str,
    friction: Literal["slides", "sticks"] = "slides",
    thickness: str | None = None,
    margin: str | None = None,
    surface: Path | None = None,
    surface_unit: _Length = "mm",
    position_columns: _Columns = None,
    force_columns: _Columns = None,
    normal_columns: _Columns = None,
    poke_column: str | None = None,
    length_unit: _Length = "mm",
    force_unit: Literal["N", "mN", "kN", "gf", "kgf", "lbf"] = "N",
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Build a session from a table of pokes: position and force of a tool, one row a sample.

    The depth at which contact begins need not be known: it is taken out of every poke.

    Parameters
    ----------
    table
        CSV with a header, .npz or .mat: the place of the tool's end, the force, the surface's
        outward normal (+z where there is none), and the number of the poke (else a new poke begins
        where the tool moves sideways).
    tool
        A ball or a flat round face.
    tool_radius
        Its radius with its unit, like 3mm.
    friction
        Whether the surface slides under the tool or sticks to it.
    thickness
        Of the body below the mean of its surface, like 20mm; its base is flat and held. The surface
        is made from the pokes.
    margin
        How far the body goes on around the outermost pokes. Default: as far as it is thick.
    surface
        Mesh of the body, in place of --thickness; its part farthest against the normals is held.
    surface_unit
        Unit of that mesh.
    position_columns
        Three columns, or one array. Default: x y z, or position.
    force_columns
        One column along the push, or three. Default: force, f, fz, or fx fy fz.
    normal_columns
        Default: nx ny nz, or normal.
    poke_column
        Default: poke or id, if there is one.
    length_unit
        Of the positions, where their headings name none.
    force_unit
        Of the force, where its heading names none.
    out
        The session's folder. Default: the table's name followed by -session.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.
    """
    tip = TOOLS[tool](_length(tool_radius, "--tool-radius"), friction=FRICTIONS[friction])
    if (thickness is None) == (surface is None):
        raise InputError("give the body as --thickness, below the poked surface, or as --surface")
    samples = read_poke_table(
        table,
        position=position_columns or (),
        force=force_columns or (),
        normal=normal_columns or (),
        poke=poke_column,
        length_unit=length_unit,
        force_unit=force_unit,
    )
    try:
        pokes = read_pokes(samples, tip)
    except InputError as error:
        raise InputError(f"{table}: {error}") from error
    modulus = pokes.young_modulus(tip)
    if not MODULUS_RANGE[0] <= modulus <= MODULUS_RANGE[1]:
        raise InputError(
            f"{table}: the pokes mean a Young's modulus of {modulus:.2g} Pa, which no material has;"
            " check --force-unit, --length-unit, --tool-radius, and which column is the force"
        )
    mesh = _surface(pokes, thickness, margin, surface, surface_unit)
    target = out or Path(f"{table.stem}-session")
    with result_folder(target, kind="import-pokes", force=force) as folder:
        write_pokes(folder, pokes, mesh, tip, table.stem)
        record_inputs(folder, [table, *([] if surface is None else [surface])])
    print_notes(_notes(pokes, samples.without_number, modulus))
    print_text(
        f"{len(pokes.number)} pokes, {pokes.samples} samples, in {target}; next: palpate fit"
        f" {target} --material field"
    )
    return 0


def _length(text: str, option: str) -> float:
    value = quantity(text, LENGTH_UNITS, option)
    if value > _LARGEST:
        raise InputError(
            f"{option} is {value:g} m; must be {_LARGEST:g} m at most: name its unit, like 3mm"
        )
    return value


def _surface(
    pokes: Pokes, thickness: str | None, margin: str | None, surface: Path | None, unit: str
) -> TriangleMesh:
    if surface is not None:
        return checked_mesh(read_mesh(surface, metres_per_unit=LENGTH_UNITS[unit]))[0]
    thick = _length(thickness or "", "--thickness")
    wide = thick if margin is None else _length(margin, "--margin")
    if wide < 0.0:
        raise InputError("--margin must not be negative")
    if (deepest := float(pokes.depth.max())) >= thick:
        raise InputError(
            f"the tool goes {1e3 * deepest:.3g} mm into a body {1e3 * thick:.3g} mm thick: check"
            " --thickness and --length-unit"
        )
    return height_field(pokes, thickness=thick, margin=wide)


def _notes(pokes: Pokes, without_number: int, modulus: float) -> list[str]:
    """What was left out, and what stiffness the pokes mean."""
    notes = []
    if without_number:
        notes.append(f"{without_number} rows in which a number is missing were left out")
    if pokes.after_deepest:
        notes.append(f"{pokes.after_deepest} samples of the way back were left out")
    if pokes.without_contact:
        names = ", ".join(map(str, pokes.without_contact[:8]))
        more = ", ..." if len(pokes.without_contact) > 8 else ""
        notes.append(
            f"{len(pokes.without_contact)} pokes have no contact (the force stays within its noise)"
            f" and were left out: {names}{more}"
        )
    factor, unit = modulus_unit(modulus)
    text = (
        f"the noise of a force is {1e3 * pokes.force_noise:.2g} mN; a half space would have a"
        f" Young's modulus of {modulus / factor:.2g} {unit}"
    )
    if modulus > _STIFF:
        less, small = modulus_unit(_GRAM * modulus)
        text += (
            ", stiff for what is poked: is the force in newtons? In grams (--force-unit gf) it"
            f" would be {_GRAM * modulus / less:.2g} {small}"
        )
    return [*notes, text]
