"""Other programs on the analytic speckle pairs, beside the figures of `flow_speckle`."""

from dataclasses import dataclass

from benchmarks.figure import FLOW, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from benchmarks.peers import speckle_rows

__all__ = ["measure"]

TOOL = SHARED.parent / "tools" / "flow_bench.py"


@dataclass(frozen=True, slots=True)
class _Engine:
    """One method of a program: its name in the bench, the program, the method in words."""

    key: str
    program: str
    method: str


ENGINES = (
    _Engine("pyvale_2d_affine", "pyvale", "2-D correlation, affine"),
    _Engine("aldic_icgn_local", "al-dic", "local subsets"),
    _Engine("cv_dis_fine", "opencv-python-headless", "DIS, finest scale"),
    _Engine("cv_farneback_w21x10", "opencv-python-headless", "Farneback, 21 px"),
)
# The others know no window of 7 px: pyvale refuses windows narrower than the step of the bench.
SMALL = ENGINES[1:2]


def measure(options: Options) -> list[Figure]:
    """Errors with a window of 21 and of 7 px, and points per second of processor time."""
    return [
        *_compared(ENGINES, 21, speed=True, make=options.peers),
        *(() if options.quick else _compared(SMALL, 7, speed=False, make=options.peers)),
    ]


def _compared(
    engines: tuple[_Engine, ...], subset: int, *, speed: bool, make: bool
) -> list[Figure]:
    found = speckle_rows(TOOL, [one.key for one in engines], subset=subset, make=make)
    figures = []
    for engine in engines:
        figures += _figures(engine, subset, found, speed=speed)
    return figures


def _figures(engine: _Engine, subset: int, found: dict | str, *, speed: bool) -> list[Figure]:
    title = f"beside it: {engine.program} ({engine.method}), speckle, window {subset} px"
    error_name = f"{title}: rms per component, worst case"
    if isinstance(found, str):
        return [Figure(FLOW, error_name, None, "px", note=found)]
    rows = [row for row in found["rows"] if row["engine"] == engine.key]
    if stopped := [row["error"] for row in rows if "error" in row]:
        return [Figure(FLOW, error_name, None, "px", note=stopped[0])]
    rms = [row["rmse_px_inlier_per_component"] for row in rows]
    each = ", ".join(f"{row['case']} {value:.4f}" for row, value in zip(rows, rms, strict=True))
    beyond = max(row["outlier_pct"] for row in rows)
    note = (
        f"version {found['versions'][engine.program]}; {each}; over the points that err by less"
        f" than 0.5 px, {beyond:.2g} % err by more in the worst case;"
        f" {min(row['coverage_pct'] for row in rows):.3g} % of the grid covered"
    )
    figures = [Figure(FLOW, error_name, max(rms), "px", note=note)]
    if speed:
        rate = min(row["pts_per_s"] for row in rows)
        figures.append(
            Figure(FLOW, f"{title}: points per CPU second, slowest case", rate / 1e3, "k",
                   note="one thread, start included; OpenCV's are pixels of a dense field")
        )  # fmt: skip
    return figures
