"""The whole fit of 17 probings over the least that it could take: one assembly and one LU."""

import tempfile
from pathlib import Path

from benchmarks.assembly_time import lu_time
from benchmarks.ball_session import write_ball_session
from benchmarks.clock import shortest
from benchmarks.figure import ESTIMATION, Figure
from benchmarks.options import Options
from palpate.bem import assemble_system, make_surface
from palpate.pipeline import fit_session
from palpate.records import read_session

__all__ = ["measure"]


def measure(options: Options) -> list[Figure]:
    """Ratio at 642 and 2562 vertices, warm."""
    return [_figure(level) for level in ((3,) if options.quick else (3, 4))]


def _figure(level: int) -> Figure:
    with tempfile.TemporaryDirectory() as folder:
        session = read_session(write_ball_session(Path(folder), level))
    surface = make_surface(session.mesh, session.held_triangles)
    size = assemble_system(surface).size
    repeats = 3 if level < 4 else 2
    assembly = shortest(lambda: assemble_system(surface), repeats=repeats, warm=False)
    factorisation = lu_time(size)
    stages: list[dict[str, float]] = []
    whole = shortest(
        lambda: stages.append(fit_session(session).estimate.seconds),
        repeats=repeats,
        warm=level < 4,
    )
    best = min(stages, key=lambda seconds: seconds["total"])
    parts = ", ".join(f"{name} {value:.2f} s" for name, value in best.items())
    return Figure(
        ESTIMATION,
        f"whole fit of 17 probings over one assembly plus one LU, {len(session.mesh.vertices)}"
        " vertices",
        whole / (assembly + factorisation),
        "x",
        must=2.0,
        reach=1.3,
        note=f"fit {whole:.2f} s ({parts}) over assembly of the session's own system"
        f" {assembly:.2f} s and lu_factor of its {size} unknowns {factorisation:.2f} s",
    )
