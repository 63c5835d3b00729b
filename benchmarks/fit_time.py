"""The whole fit of 17 probings: its time, and that over one assembly and one LU."""

import tempfile
from pathlib import Path

from benchmarks.assembly_time import lu_time
from benchmarks.ball_session import write_ball_session
from benchmarks.clock import shortest
from benchmarks.figure import ESTIMATION, Figure
from benchmarks.floors import counted_operations
from benchmarks.options import Options
from palpate.bem import CENTRE, BoundarySurface, boundary_system, make_surface
from palpate.bem.system.matrix import matrix_and_slope
from palpate.pipeline import fit_session
from palpate.records import Session, read_session


def measure(options: Options) -> list[Figure]:
    """Time and ratio at 642 and 2562 vertices, warm."""
    # How often the ball's faces are halved.
    levels = (3,) if options.quick else (3, 4)
    return [figure for level in levels for figure in _figures(level)]


def _figures(level: int) -> list[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        session = read_session(write_ball_session(Path(folder), level))
    surface = make_surface(session.mesh, session.held_triangles)
    size = boundary_system(surface).size
    fit_session(session)
    # In turns: whatever else the machine does then disturbs both sides of the ratio alike.
    rounds = [_round(session, surface, size) for _ in range(3)]
    stages = min(
        (stage_seconds for stage_seconds, _, _ in rounds), key=lambda seconds: seconds["total"]
    )
    assembly = min(seconds for _, seconds, _ in rounds)
    factorisation = min(seconds for _, _, seconds in rounds)
    with counted_operations() as operations:
        fit_session(session)
    parts = ", ".join(f"{name} {value:.2f} s" for name, value in stages.items())
    of = f"whole fit of 17 probings, {len(session.mesh.vertices)} vertices"
    return [
        Figure(
            ESTIMATION, of, stages["total"], "s",
            note=f"{parts}; shortest of {len(rounds)}; floor of what its matrices take, without the"
            f" integrals: {operations.seconds():.1f} s ({operations.described()}) at the rate of"
            " products of large matrices",
        ),
        Figure(
            ESTIMATION, f"{of}, over one assembly plus one LU",
            stages["total"] / (assembly + factorisation), "x",
            note=f"assembly of the session's own system {assembly:.2f} s, lu_factor of its {size}"
            f" unknowns {factorisation:.2f} s",
        ),
    ]  # fmt: skip


def _round(
    session: Session, surface: BoundarySurface, size: int
) -> tuple[dict[str, float], float, float]:
    """Stages of one fit, one assembly, one factorisation [s]."""
    stages = fit_session(session).estimate.seconds
    assembly = shortest(
        lambda: matrix_and_slope(boundary_system(surface), CENTRE), repeats=1, warm=False
    )
    return stages, assembly, lu_time(size, repeats=1)
