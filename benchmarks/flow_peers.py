"""Other programs beside the figures of `flow_speckle` and of the real tension test."""

from dataclasses import dataclass

import numpy as np

from benchmarks.figure import FLOW, Figure
from benchmarks.flow_real import TENSION, TENSION_REGION, beside_dice
from benchmarks.machine import SHARED
from benchmarks.options import Options
from benchmarks.peers import speckle_rows, stereo_field

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
        *(() if options.quick else (_tension(make=options.peers),)),
    ]


def _tension(*, make: bool) -> Figure:
    """The real tension test by another stereo program, at DICe's points."""
    name = "beside it: al-dic-3d, real tension test, frames 1-5: median lateral difference from"
    field = stereo_field(
        TENSION / "cal_pyaldic.xml", f"{TENSION}/L/*.tif", f"{TENSION}/R/*.tif", TENSION_REGION,
        window=32, make=make,
    )  # fmt: skip
    if isinstance(field, str):
        return Figure(FLOW, f"{name} DICe, worst", None, "um", note=field)
    pixel, point, moved = field
    lateral = []
    for frame, displacement in enumerate(moved, start=1):
        ok = np.isfinite(displacement).all(axis=1) & np.isfinite(point).all(axis=1)
        apart = beside_dice(pixel[ok], point[ok], displacement[ok], frame=frame)
        lateral.append(float(np.median(np.hypot(apart[:, 0], apart[:, 1]))))
    listed = ", ".join(f"{value:.2f}" for value in lateral)
    return Figure(
        FLOW,
        f"{name} DICe, worst",
        max(lateral),
        "um",
        note=f"{listed} um at {len(apart)} common points; window 32 px, as shipped",
    )


def _compared(
    engines: tuple[_Engine, ...], subset: int, *, speed: bool, make: bool
) -> list[Figure]:
    report = speckle_rows(TOOL, [peer.key for peer in engines], subset=subset, make=make)
    figures = []
    for engine in engines:
        figures += _figures(engine, subset, report, speed=speed)
    return figures


def _figures(engine: _Engine, subset: int, report: dict | str, *, speed: bool) -> list[Figure]:
    title = f"beside it: {engine.program} ({engine.method}), speckle, window {subset} px"
    error_name = f"{title}: rms per component, worst case"
    if isinstance(report, str):
        return [Figure(FLOW, error_name, None, "px", note=report)]
    rows = [row for row in report["rows"] if row["engine"] == engine.key]
    if stopped := [row["error"] for row in rows if "error" in row]:
        return [Figure(FLOW, error_name, None, "px", note=stopped[0])]
    rms = [row["rmse_px_inlier_per_component"] for row in rows]
    listed = ", ".join(f"{row['case']} {value:.4f}" for row, value in zip(rows, rms, strict=True))
    beyond = max(row["outlier_pct"] for row in rows)
    note = (
        f"version {report['versions'][engine.program]}; {listed}; over the points that err by less"
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
