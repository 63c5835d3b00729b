"""The whole fit of 17 probings over the least that it could take: one assembly and one LU."""

import tempfile
from pathlib import Path

from benchmarks.assembly_time import lu_time
from benchmarks.ball_session import write_ball_session
from benchmarks.clock import shortest
from benchmarks.figure import ESTIMATION, Figure
from benchmarks.options import Options
from palpate.bem import BoundarySurface, assemble_system, make_surface
from palpate.pipeline import fit_session
from palpate.records import Session, read_session


def measure(options: Options) -> list[Figure]:
    """Ratio at 642 and 2562 vertices, warm."""
    return [_figure(level) for level in ((3,) if options.quick else (3, 4))]


def _figure(level: int) -> Figure:
    with tempfile.TemporaryDirectory() as folder:
        session = read_session(write_ball_session(Path(folder), level))
    surface = make_surface(session.mesh, session.held_triangles)
    size = assemble_system(surface).size
    fit_session(session)
    # In turns: whatever else the machine does then disturbs both sides of the ratio alike.
    rounds = [_round(session, surface, size) for _ in range(3)]
    stages = min((found for found, _, _ in rounds), key=lambda seconds: seconds["total"])
    assembly = min(seconds for _, seconds, _ in rounds)
    factorisation = min(seconds for _, _, seconds in rounds)
    parts = ", ".join(f"{name} {value:.2f} s" for name, value in stages.items())
    return Figure(
        ESTIMATION,
        f"whole fit of 17 probings over one assembly plus one LU, {len(session.mesh.vertices)}"
        " vertices",
        stages["total"] / (assembly + factorisation),
        "x",
        must=2.0,
        reach=1.3,
        note=f"fit: {parts}; over assembly of the session's own system {assembly:.2f} s and"
        f" lu_factor of its {size} unknowns {factorisation:.2f} s; shortest of {len(rounds)}",
    )


def _round(
    session: Session, surface: BoundarySurface, size: int
) -> tuple[dict[str, float], float, float]:
    """Stages of one fit, one assembly, one factorisation [s]."""
    stages = fit_session(session).estimate.seconds
    assembly = shortest(lambda: assemble_system(surface), repeats=1, warm=False)
    return stages, assembly, lu_time(size, repeats=1)
