"""Pokes of a robot, with position and force and no pictures: from a table to a session.

Nobody knows at what depth contact began, so depths are known up to a constant. Of a poke's samples
the sums sum w d, sum w F and sum w F^(1 - q) with sum w = 0 do not depend on it, whatever of the
depth is the dent of a half space (A F^(1 - q), `probe.indentation`) and whatever gives in
proportion to the force (B F: the body as a whole, its base, the arm). There is one force F_e for
which A F_e^(1 - q) + B F_e is a multiple of sum w d for any A and B: the poke says as much as one
reading at that force, with contact at depth zero. That reading becomes the probing; no error of
the contact's depth is left in it. The weights are those of least squares for A, where the depths
are exact and the forces have the noise that pokes leave about their curves.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from jaxtyping import Float, Int
from scipy.interpolate import RBFInterpolator
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points, unit_normals, write_mesh
from palpate.records import SESSION_FORMAT, PokeTable, Tool, write_text
from palpate.shapes import Points, Vector3

# Least samples of a poke: two say nothing of the noise about their curve.
_FEWEST = 3
# Without numbers, a new poke begins where the tool is this many radii beside the last one.
_BESIDE = 0.25
# A poke has contact where its largest force is so many times the noise.
_CLEAR = 4.0
# Cells across the shorter side of a height field, and how many touched points make a height.
_CELLS, _NEIGHBOURS = 12, 30
# Width over length of a strip that still counts as a surface.
_NARROWEST = 0.02
# The surface under a tool may be this many radii from where it touched.
_OFF = 1.0
# Heights of a level surface: cosine of the steepest normal; those of the base over the body's.
_UPWARD, _LEVEL = 0.7, 1e-3
# Standard deviation of a depth over the depth, at least: what a table of three digits leaves.
_LAW = 1e-3
# The arm, the tool and the base give at most about this much [m/N] (one standard deviation).
_TOOL_COMPLIANCE = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Pokes:
    """Readings of pokes.

    Attributes
    ----------
    number : (k,) int               of each poke in the table, from 1
    point : (k, 3) float [m]        where contact began
    normal : (k, 3) float [-]       outward
    force : (k,) float [N]          F_e
    depth : (k,) float [m]          of the tool, from where contact began
    depth_std : (k,) float [m]
    samples : int                   that were used
    after_deepest : int             samples left out: of the way back
    without_contact : tuple of int  numbers of the pokes left out: the force stays within its noise
    force_noise : float [N]         of a sample, one standard deviation
    """

    number: Int[np.ndarray, " k"]
    point: Points
    normal: Points
    force: Float[np.ndarray, " k"]
    depth: Float[np.ndarray, " k"]
    depth_std: Float[np.ndarray, " k"]
    samples: int
    after_deepest: int
    without_contact: tuple[int, ...]
    force_noise: float

    def young_modulus(self, tool: Tool) -> float:
        """Median E [Pa] by the pokes one by one, of an incompressible half space."""
        modulus = 0.75 * self.force / np.sqrt(tool.radius * self.depth**3)
        if tool.is_flat:
            modulus = self.force / (2.0 * tool.radius * self.depth)
        return float(0.75 * np.median(modulus))


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """Samples of one poke up to the deepest, and the curve through them: (stiffness (d - start))^p
    with p = 1 / (1 - q)."""

    number: int
    origin: Vector3
    normal: Vector3
    depth: Float[np.ndarray, " n"]
    force: Float[np.ndarray, " n"]
    start: float
    fitted: Float[np.ndarray, " n"]


def read_pokes(table: PokeTable, tool: Tool) -> Pokes:
    """What each poke of a table says.

    Parameters
    ----------
    table : PokeTable
    tool : Tool                     a ball or a flat round face

    Returns
    -------
    Pokes

    Raises
    ------
    InputError                      a poke of fewer than three samples; normals that point inward;
                                    fewer than three pokes with contact; a ball that went in
                                    deeper than its radius
    """
    power = 1.0 / (1.0 - (tool.growth or 0.0))
    parts = list(_parts(table, tool.radius))
    for number, rows in enumerate(parts, start=1):
        if len(rows) < _FEWEST:
            raise InputError(
                f"poke {number} of {len(parts)} has {len(rows)} samples; at least {_FEWEST} are"
                " needed, since the depth at which contact begins is not known: record the way in,"
                " or number the pokes in a column of their own (--poke-column)"
            )
    sign = _sign(table, parts)
    curves = [
        _curve(number, table, rows, sign, power) for number, rows in enumerate(parts, start=1)
    ]
    noise = _noise(curves, power)
    pokes = [
        (curve, reading)
        for curve in curves
        if _has_contact(curve, noise) and (reading := _reading(curve, noise, power))
    ]
    clear = [curve for curve, _ in pokes]
    if len(clear) < _FEWEST:
        raise InputError(
            f"{len(clear)} of {len(curves)} pokes have contact; {_FEWEST} must. In any others"
            f" the force stays within {_CLEAR:g} times its noise of {noise:.2g} N, or does not rise"
            " with the depth; check which column is the force, its unit, and how deep the tool went"
        )
    deepest = float(np.median([curve.depth.max() - curve.start for curve in clear]))
    if not tool.is_flat and deepest > tool.radius:
        raise InputError(
            f"the pokes are {1e3 * deepest:.3g} mm deep, deeper than the ball's radius of"
            f" {1e3 * tool.radius:.3g} mm; half the radius at most: check --tool-radius and"
            " --length-unit, or leave the deeper samples out"
        )
    force, depth, std = np.array([reading for _, reading in pokes]).T
    clear_numbers = {curve.number for curve in clear}
    used = sum(len(curve.depth) for curve in curves)
    return Pokes(
        np.array([curve.number for curve in clear]),
        np.stack([curve.origin - curve.start * curve.normal for curve in clear]),
        np.stack([curve.normal for curve in clear]),
        force,
        depth,
        std,
        sum(len(curve.depth) for curve in clear),
        len(table.position) - used,
        tuple(curve.number for curve in curves if curve.number not in clear_numbers),
        noise,
    )


def _parts(table: PokeTable, radius: float) -> Iterator[Int[np.ndarray, " n"]]:
    """Rows of each poke."""
    if table.poke is not None:
        order = np.argsort(table.poke, kind="stable")
        yield from np.split(order, np.flatnonzero(np.diff(table.poke[order])) + 1)
        return
    first = 0
    for row in range(1, len(table.position) + 1):
        if row < len(table.position):
            offset = table.position[row] - table.position[first]
            offset = offset - (offset @ table.normal[first]) * table.normal[first]
            if np.linalg.norm(offset) < _BESIDE * radius:
                continue
        yield np.arange(first, row)
        first = row


def _sign(table: PokeTable, parts: list[Int[np.ndarray, " _"]]) -> float:
    """Sign that makes the force of a push positive; refuses normals that point inward."""
    force = _along(table)
    deepest = np.array([force[rows[np.abs(force[rows]).argmax()]] for rows in parts])
    sign = 1.0 if np.median(deepest) >= 0.0 else -1.0
    inward = []
    for number, rows in enumerate(parts, start=1):
        depth = -(table.position[rows] * table.normal[rows]).sum(axis=1)
        if np.cov(depth, sign * force[rows])[0, 1] < 0.0:
            inward.append(number)
    if 2 * len(inward) > len(parts):
        raise InputError(
            f"in {len(inward)} of {len(parts)} pokes the force falls as the tool goes against the"
            " normal: the normals point inward, or the positions are in a frame whose z points into"
            " the body; normals must point out of the body (--normal-columns), +z where none is"
            " given"
        )
    return sign


def _along(table: PokeTable) -> Float[np.ndarray, " n"]:
    """Force along the normal, either sign [N]."""
    if table.force.shape[1] == 1:
        return table.force[:, 0]
    return np.asarray((table.force * table.normal).sum(axis=1))


def _curve(
    number: int, table: PokeTable, rows: Int[np.ndarray, " n"], sign: float, power: float
) -> _Curve:
    """One poke, with the start of contact for which force and depth fit best."""
    normal = table.normal[rows].mean(axis=0)
    normal /= np.linalg.norm(normal)
    origin = table.position[rows[0]]
    depth = (origin - table.position[rows]) @ normal
    last = int(depth.argmax()) + 1
    rows, depth, force = rows[:last], depth[:last], sign * _along(table)[rows[:last]]
    span = float(np.ptp(depth))

    def fitted(start: float) -> Float[np.ndarray, " n"]:
        shape = np.clip(depth - start, 0.0, None) ** power
        return np.asarray(
            shape * max(float(shape @ force), 0.0) / max(float(shape @ shape), 1e-300)
        )

    if span == 0.0:
        return _Curve(number, origin, normal, depth, force, 0.0, np.zeros_like(force))
    best = minimize_scalar(
        lambda start: (
            float(np.square(force - fitted(start)).sum()) / max(float(force @ force), 1e-300)
        ),
        bounds=(depth.min() - span, depth.max() - 0.02 * span),
        method="bounded",
        options={"xatol": 1e-5 * span},
    )
    return _Curve(number, origin, normal, depth, force, float(best.x), fitted(float(best.x)))


def _noise(curves: list[_Curve], power: float) -> float:
    """Standard deviation of a force about its curve [N]: the median over the pokes. Besides the
    stiffness, the start of contact and what gives in proportion to the force are free."""
    square = []
    for curve in curves:
        touching = curve.fitted > 0.0
        if touching.sum() < _FEWEST:
            continue
        depth, force = curve.depth[touching] - curve.start, curve.force[touching]
        powers = (power, power - 1.0, 2.0 * power - 1.0)[: len(depth) - 1]
        terms = np.stack([depth**k for k in powers], axis=1)
        solution, _, rank, _ = np.linalg.lstsq(terms, force, rcond=1e-10)
        if (free := len(depth) - int(rank)) > 0:
            left = float(np.square(force - terms @ solution).sum())
            # The median of chi-squared; importing scipy.stats for it would take most of a second.
            square.append(left / float(chdtri(free, 0.5)))
    return float(np.sqrt(np.median(square))) if square else 0.0


def _has_contact(curve: _Curve, noise: float) -> bool:
    touching = int((curve.fitted > 0.0).sum())
    # A force that is there and does not rise says nothing of the depth.
    seen = min(float(curve.fitted.max()), float(np.ptp(curve.force)))
    return touching >= _FEWEST and seen > _CLEAR * noise


def _reading(curve: _Curve, noise: float, power: float) -> tuple[float, float, float] | None:
    """F_e, the depth there, and its standard deviation; None where the force falls with depth."""
    touching = curve.fitted > 0.0
    depth, force, fitted = (part[touching] for part in (curve.depth, curve.force, curve.fitted))
    # What a force that is off means in depth.
    slope = (depth - curve.start) / (power * fitted)
    weight = slope**-2.0
    shape = fitted ** (1.0 / power)
    combined = weight * (shape - weight @ shape / weight.sum())
    dented = float(combined @ (np.sign(force) * np.abs(force) ** (1.0 / power)))
    linear = float(combined @ force)
    if dented <= 0.0 or linear <= 0.0:
        return None
    effective = float(fitted.max())
    if power > 1.0:
        effective = float((linear / dented) ** (power / (power - 1.0)))
    factor = effective ** (1.0 / power) / dented
    std = factor * noise * float(np.sqrt(np.square(combined * slope).sum()))
    taken = factor * float(combined @ depth)
    return effective, taken, max(std, _LAW * taken)


def height_field(pokes: Pokes, *, thickness: float, margin: float) -> TriangleMesh:
    """The body below a surface of which the touched points are known, closed downward (-z).

    Parameters
    ----------
    pokes : Pokes
    thickness : float [m]           from the mean height of the surface to its flat base, > 0
    margin : float [m]              of the body around the outermost pokes, >= 0

    Returns
    -------
    TriangleMesh                    a rectangle seen from above

    Raises
    ------
    InputError                      normals that are not about +z; a surface that reaches the base;
                                    pokes along a line, without a margin
    """
    if not (pokes.normal[:, 2] > _UPWARD).all():
        raise InputError(
            "a height field has normals along z, within 45 degrees: give the surface as a mesh"
            " (--surface), or turn the frame so that z points out of the surface"
        )
    low, high = pokes.point[:, :2].min(axis=0) - margin, pokes.point[:, :2].max(axis=0) + margin
    if not (high - low).min() > _NARROWEST * (high - low).max():
        raise InputError("all pokes are on a line: give the width beside it (--margin)")
    count = np.ceil(_CELLS * (high - low) / (high - low).min()).astype(int) + 1
    x, y = (np.linspace(*ends) for ends in zip(low, high, count, strict=True))
    node = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    nearest = min(_NEIGHBOURS, len(pokes.point))
    # About as rough as its points are uncertain; far from all of them it is level.
    surface = RBFInterpolator(
        pokes.point[:, :2], pokes.point[:, 2], neighbors=nearest, kernel="linear", smoothing=1e-3,
        degree=0,
    )  # fmt: skip
    top = surface(node)
    base = float(pokes.point[:, 2].mean()) - thickness
    if not (top > base + 0.1 * thickness).all():
        raise InputError(
            f"the surface is {1e3 * np.ptp(top):.3g} mm high and reaches the base,"
            f" {1e3 * thickness:.3g} mm below its mean: check --thickness and the normals, or give"
            " a mesh (--surface)"
        )
    return _closed(node, top, base, (int(count[0]), int(count[1])))


def _closed(
    node: Float[np.ndarray, "n 2"],
    top: Float[np.ndarray, " n"],
    base: float,
    shape: tuple[int, int],
) -> TriangleMesh:
    """A grid of heights, its base and the walls between."""
    number = np.arange(len(node)).reshape(shape)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])
    )
    upper = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    after, count = np.roll(rim, -1), len(node)
    walls = np.concatenate(
        [np.stack([rim, rim + count, after], 1), np.stack([after, rim + count, after + count], 1)]
    )
    vertices = np.concatenate(
        [np.column_stack([node, top]), np.column_stack([node, np.full(count, base)])]
    )
    return TriangleMesh(vertices, np.concatenate([upper, upper[:, ::-1] + count, walls]))


def write_pokes(folder: Path, pokes: Pokes, mesh: TriangleMesh, tool: Tool, name: str) -> None:
    """Write pokes as a session: a probing each, with the tool's displacement as the only
    observation, on the body's lowest part as its support.

    Parameters
    ----------
    folder : Path                   into which session.toml and mesh.ply are written
    pokes : Pokes
    mesh : TriangleMesh             of the body, closed
    tool : Tool
    name : str                      of the session

    Raises
    ------
    InputError                      pokes off the surface; one whose normal points into the body
    """
    near = closest_points(mesh, pokes.point)
    off = np.flatnonzero(near.distance > _OFF * tool.radius)
    if off.size:
        worst = off[near.distance[off].argmax()]
        raise InputError(
            f"{off.size} of {len(pokes.number)} pokes are off the surface, poke"
            f" {pokes.number[worst]} by {1e3 * near.distance[worst]:.3g} mm: mesh and positions"
            " must be in one frame, and each in its own unit (--surface-unit, --length-unit)"
        )
    outward = (unit_normals(mesh)[near.triangle] * pokes.normal).sum(axis=1)
    if (outward < 0.0).any():
        raise InputError(
            f"the normal of poke {pokes.number[outward.argmin()]} points into the body: normals"
            " must point out of it, as the faces of the mesh do"
        )
    up = pokes.normal.mean(axis=0) / np.linalg.norm(pokes.normal.mean(axis=0))
    lowest = mesh.vertices[(mesh.vertices @ up).argmin()]
    write_mesh(folder / "mesh.ply", mesh)
    content: dict[str, Any] = {
        "format": SESSION_FORMAT,
        "name": name,
        "object": {"mesh": "mesh.ply", "length_unit": "m"},
        "support": {
            "plane": {
                "point": lowest.tolist(), "normal": up.tolist(),
                "tolerance": _LEVEL * float(np.ptp(mesh.vertices @ up)),
            }
        },
        "errors": {"tool_compliance": _TOOL_COMPLIANCE},
    }  # fmt: skip
    shape = {"tool": tool.shape, "tool_radius": tool.radius, "friction": tool.friction_name}
    content["probe"] = [
        {
            "name": f"p{number:03d}",
            "contact": {"point": point.tolist(), **shape},
            "force": (-force * normal).tolist(),
            "force_std": 0.0,
            "tip_displacement": (-depth * normal).tolist(),
            "tip_displacement_std": std,
        }
        for number, point, normal, force, depth, std in zip(
            pokes.number.tolist(), near.position, pokes.normal, pokes.force.tolist(),
            pokes.depth.tolist(), pokes.depth_std.tolist(), strict=True,
        )
    ]  # fmt: skip
    write_text(folder / "session.toml", tomlkit.dumps(content))
