"""Real pictures: a static series, a tension test beside another program, a moved cylinder."""

from dataclasses import replace

import cv2
import h5py
import numpy as np
from scipy.io import netcdf_file
from scipy.spatial import cKDTree

from benchmarks.figure import FLOW, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from benchmarks.resection import resected
from benchmarks.stereo_surface import triangulated_surface
from palpate.records import Camera, Rig, read_measured, read_rig
from palpate.records.programs.multidic import read_control_points
from palpate.vision import (
    JointFlow,
    RangeFlow,
    StereoSettings,
    is_valid,
    prepare_pictures,
    read_pictures,
    stereo_points,
)

REAL = SHARED / "real"
TENSION = REAL / "gt4_dspec"
# Columns and rows of the specimen: first, last of each [px].
TENSION_REGION = (100, 1700, 10, 800)
MICRO = 1e6


def measure(options: Options) -> list[Figure]:
    """Figures of the three real sets."""
    return [*_static(), *_tension(), *_cylinder()]


def _static() -> list[Figure]:
    """Nothing moves: the spread of displacements is the noise of the whole chain."""
    folder = REAL / "dice_stereo_static"
    rig = read_rig(folder / "cal.xml")
    grey = [
        read_pictures(rig, f"images/img_{k:04d}_{{camera}}.tif", folder=folder, what=str(k)).grey
        for k in range(6)
    ]
    mask = np.zeros(grey[0][0].shape, dtype=bool)
    mask[300:540, 160:1100] = True  # the region of the gold results, roi.dat
    stereo = StereoSettings(reprojection=30.0, subset=31)
    coarse = JointFlow(subset=45, step=10, shape="shift", smoothing=0.0)
    flows = _followed(rig, grey, mask, stereo, coarse)
    others = [
        "/".join(f"{value:.2f}" for value in _spread(_followed(rig, grey, mask, stereo, method)))
        for method in (
            replace(coarse, subset=27),
            JointFlow(subset=27, step=10),
            JointFlow(subset=45, step=10),
        )
    ]
    valid = np.mean([is_valid(f).mean() for f in flows])
    note = (
        f"frames 1 to 5 against 0, {len(flows[0].point)} points, {100 * valid:.0f} % valid; coarse"
        ' speckle: window 45 px, shape "shift", no low-pass. X/Y/Z with 27 px, as DICe:'
        f" {others[0]} um; with the default shape and low-pass, 27 px: {others[1]} um, 45 px:"
        f" {others[2]} um. DICe's gold results: 0.7/0.4/3.2 um. The pictures lie 8 px off epipolar"
        " lines of their calibration, so only motions are compared"
    )
    return [
        Figure(FLOW, f"real static stereo series: sd of displacement {axis}", float(value), "um",
               note=note)
        for axis, value in zip("XYZ", _spread(flows), strict=True)
    ]  # fmt: skip


def _spread(flows: list[RangeFlow]) -> np.ndarray:
    """Mean over the instants of the standard deviation over the points [um]."""
    return np.mean([MICRO * f.displacement[is_valid(f)].std(axis=0) for f in flows], axis=0)


def _tension() -> list[Figure]:
    """Displacements of the D-shaped specimen beside DICe's, at DICe's points."""
    rig = read_rig(TENSION / "cal_vic3d.xml")
    grey = [
        tuple(
            cv2.imread(str(TENSION / side / f"GT4-{k:04d}_{c}.tif"), cv2.IMREAD_GRAYSCALE).astype(
                np.float32
            )
            for c, side in enumerate("LR")
        )
        for k in range(6)
    ]
    mask = np.zeros(grey[0][0].shape, dtype=bool)
    left, right, top, bottom = TENSION_REGION
    mask[top:bottom, left:right] = True
    flows = _followed(rig, grey, mask, StereoSettings(step=20), JointFlow(step=20))
    apart = [
        beside_dice(f.pixel[ok], f.point[ok], f.displacement[ok], frame=k)
        for k, f, ok in ((k, flow, is_valid(flow)) for k, flow in enumerate(flows, 1))
    ]
    lateral = [
        float(np.median(np.hypot(difference[:, 0], difference[:, 1]))) for difference in apart
    ]
    return [
        Figure(FLOW, "real tension test, frames 1-5: median lateral difference from DICe, worst",
               max(lateral), "um",
               note=", ".join(f"{value:.2f}" for value in lateral) + f" um at {len(apart[0])}"
               f" common points; depth {np.median(np.abs(np.concatenate(apart)[:, 2])):.1f} um"),
    ]  # fmt: skip


def _exodus_pixels(path) -> np.ndarray:
    """Pixels of DICe's points in the first picture."""
    with netcdf_file(path, mmap=False) as file:
        names = [b"".join(row).split(b"\0")[0].decode() for row in file.variables["name_nod_var"]]
        index = [names.index(f"COORDINATE_{axis}") + 1 for axis in "XY"]
        return np.stack([np.array(file.variables[f"vals_nod_var{k}"][0]) for k in index], axis=1)


def beside_dice(
    pixel: np.ndarray, point: np.ndarray, displacement: np.ndarray, *, frame: int
) -> np.ndarray:
    """Displacements of the tension test less DICe's at its points [um], in its frame.

    Parameters
    ----------
    pixel : (n, 2) [px]         in the left camera, first picture
    point : (n, 3) [m]          DICe's frame is fitted to these
    displacement : (n, 3) [m]   all of them finite
    frame : int                 1 to 5

    Returns
    -------
    (k, 3) [um]                 at DICe's points within 15 px of one of these
    """
    gold = TENSION / "dice_gold" / "DICe_solution.e"
    measured = read_measured("dice", gold, frame=frame)
    near, which = cKDTree(pixel).query(_exodus_pixels(gold))
    both = (near < 15.0) & np.isfinite(measured.displacement).all(axis=1)
    ours, theirs = point[which[both]], measured.points[both]
    turn = _rotation(ours, theirs)
    return MICRO * (displacement[which[both]] @ turn - measured.displacement[both])


def _rotation(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Rotation of row vectors from one frame to another, Kabsch."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _cylinder() -> list[Figure]:
    """Five rigid poses: what a rigid motion leaves is error."""
    folder = REAL / "multidic_pair"
    plain = read_rig(folder / "calibrationObjectImages")
    control = read_control_points(folder / "calibrationObjectImages")
    lenses = [
        resected(camera, *known).camera
        for camera, known in zip(plain.cameras, control, strict=True)
    ]
    rig = Rig(tuple(lenses), 0, str(folder))
    grey = [
        read_pictures(rig, f"speckledObjectImages/{{camera}}/{{camera}}_{k}.jpg", folder=folder,
                      what=str(k)).grey
        for k in range(1, 6)
    ]  # fmt: skip
    with h5py.File(folder / "speckledObjectImages" / "DIC2DpairResults_C_201_C_202.mat") as file:
        mask = np.array(file["DIC2DpairResults/ROImask"]).T.astype(bool)
        points = [np.array(file[key]).T - 1.0 for key in file["DIC2DpairResults/Points"][0]]
    boxes = [_box(np.concatenate(points[5 * c : 5 * c + 5])) for c in range(2)]
    cropped = replace(
        rig,
        cameras=tuple(_crop(camera, box) for camera, box in zip(rig.cameras, boxes, strict=True)),
    )
    parts = [
        tuple(np.ascontiguousarray(g[box]) for g, box in zip(instant, boxes, strict=True))
        for instant in grey
    ]
    flows = _followed(
        cropped, parts, mask[boxes[0]], StereoSettings(step=12, subset=43),
        JointFlow(step=24, subset=43),
    )  # fmt: skip
    left, valid = [], []
    for flow in flows:
        ok = is_valid(flow)
        before, after = flow.point[ok], flow.point[ok] + flow.displacement[ok]
        rest = (after - after.mean(axis=0)) - (before - before.mean(axis=0)) @ _rotation(
            before, after
        )
        left.append(MICRO * rest.std(axis=0))
        valid.append(ok.mean())
    note = (
        f"worst of four poses against the first, window 43 px (the subset of the shared results is"
        f" as large), {100 * np.mean(valid):.0f} % of {len(flows[0].point)} points valid; cameras"
        " resected with lens from the calibration object"
    )
    return [
        Figure(FLOW, f"real cylinder in rigid poses: what a rigid motion leaves, {axis}",
               float(value), "um", note=note)
        for axis, value in zip("xyz", np.max(left, axis=0), strict=True)
    ]  # fmt: skip


def _box(pixel: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns that hold pixels, with a margin for windows and motions."""
    low = np.floor(np.nanmin(pixel, axis=0)).astype(int) - 60
    high = np.ceil(np.nanmax(pixel, axis=0)).astype(int) + 60
    return slice(max(low[1], 0), high[1]), slice(max(low[0], 0), high[0])


def _crop(camera: Camera, box: tuple[slice, slice]) -> Camera:
    """The camera that takes only a part of the picture."""
    matrix = camera.matrix.copy()
    matrix[:2, 2] -= [box[1].start, box[0].start]
    return replace(camera, matrix=matrix, size=None)


def _followed(
    rig: Rig,
    grey: list[tuple[np.ndarray, ...]],
    mask: np.ndarray,
    stereo: StereoSettings,
    method: JointFlow,
) -> list[RangeFlow]:
    """Range flow of a surface that is known from the first pictures only."""
    first = prepare_pictures(rig, grey[0])
    surface = triangulated_surface(stereo_points(first, mask=mask, settings=stereo))
    state, flows = method.start_on(rig, grey[0], *surface), []
    for pictures in grey[1:]:
        state, flow = method.follow(state, pictures)
        flows.append(flow)
    return flows
