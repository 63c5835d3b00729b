"""A good example of every kind of file that is read, and what reads it: what the fuzz spoils."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import cv2
import meshio
import numpy as np
import trimesh
from cube_session import SESSION
from estimate_samples import constants
from lab.lab_configs import HALF_BALL, STAGE
from program_files import (
    MOVE,
    PLACE,
    dice_states,
    dice_values,
    multidic_states,
    vic3d_rows,
    write_exodus,
    write_mat,
    write_table,
)
from recording.bench_footage import PEAKS, write_recording
from surfaces import box

from palpate.calibration import Charuco, Chessboard
from palpate.calibration.sightings import eight_bits
from palpate.campaign import Store, read_items
from palpate.geometry import read_mesh, write_mesh
from palpate.lab import read_lab_config
from palpate.pipeline import read_fitted_surface
from palpate.probe import read_compression
from palpate.recording import read_pokes, read_recording
from palpate.recording.footage import Footage, camera_motion, read_times
from palpate.recording.force_log import read_force_log
from palpate.recording.record import read_poses
from palpate.recording.touches import find_touches, find_zero, resample_force
from palpate.records import (
    CONSTANT_NAMES,
    Camera,
    Estimate,
    ProbeEstimate,
    Rig,
    Sphere,
    Status,
    folder_changes,
    read_estimate,
    read_import_pose,
    read_measured,
    read_poke_table,
    read_rig,
    read_rig_covariance,
    read_session,
    write_estimate,
    write_rig,
)
from palpate.scanning import read_points, read_scan
from palpate.scanning.scan_file import depth_points
from palpate.simulation import GreenFunctions, exact_material
from palpate.simulation.green_functions import read_green_functions, write_green_functions
from palpate.vision import read_grey, read_pictures

GREY = np.random.default_rng(1).integers(0, 255, (48, 64), dtype=np.uint8)
POSE = 'length_unit = "mm"\nR = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nt = [1.5, 0, 2]\n'
COMPRESSION = "Cylinder Diameter: 50mm;\nHeight: 20mm;\nCompression (mm);Load (N)\n" + "".join(
    f"{0.1 * i:.2f};{3.1 * i:.2f}\n" for i in range(30)
)
STEPS = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[rig]
cameras = "rig.toml"
[[step]]
name = "s0"
images = "png_{camera}.png"
[[step]]
name = "s1"
images = "tif_{camera}.tif"
"""
REGIONS = """\
[[region]]
name = "skin"
skin = "4 mm"
faces = { box = { min = [0, 0, 0.03], max = [0.04, 0.04, 0.04] } }
ratio = 2.5
ratio_std = 0.5
[[region]]
name = "half"
plane = { point = [0, 0, 0.01], normal = [0, 0, -1] }
thickness = "6 mm"
"""
# A session whose supports and errors say all that they may.
GIVING = SESSION.replace(
    "[support]",
    """[errors]
force_gain = { gauge = "0.3 %" }
force_direction = "1 deg"
contact_point = "0.5 mm"
contact_radius = 0.2
length_scale = 0.001
support_compliance = "20 um/kPa"
pose = { translation = "0.2 mm", rotation = "0.2 deg" }
[[support]]
directions = [[0, 0, 1], [1, 0, 0]]
stiffness = "5 kPa/mm"
motion = "fixed"
""",
).replace("[[probe]]", REGIONS + '[[probe]]\nforce_sensor = "gauge"', 1)
# And one whose probing was followed over time.
CREEPING = SESSION.replace(
    "[[probe]]", '[[probe]]\nseries = "series.csv"\nmeasured_at = "1500 ms"', 1
)
SERIES = "t [ms],fx,fy,fz,tx,ty,tz,displacement\n" + "".join(
    f"{100 * k},0,0,{-0.12 * min(k, 10):.2f},,,{-4e-5 * k:g},{'frame.csv' if k == 12 else ''}\n"
    for k in range(20)
)
POKES = "poke,x [mm],y [mm],z [mm],force [mN]\n" + "".join(
    f"{k},{5 * k},{k % 2},{-d},{20.0 * d**1.5:.3f}\n" for k in range(4) for d in range(5)
)
SCAN = """\
format = "palpate-scan/1"
length_unit = "mm"
support = "z=0"
sigma = 0.05
[turntable]
point = [0, 0, 0]
axis = [0, 0, 1]
[[view]]
file = "scan.xyz"
angle = 30
eye = [0, 0, 500]
"""
Reader = Callable[[Path], object]


def _texts(program: str):
    """Good texts stand in the tests of the programs that write them."""
    return import_module(f"records.programs.test_{program}")


def two_cameras() -> Rig:
    """Cameras above the cube that look down, 64 x 48 pixels."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [-0.02, 0.02, 0.4]
    beside = pose.copy()
    beside[0, 3] = -0.06
    matrix = np.array([[400.0, 0.0, 31.5], [0.0, 400.0, 23.5], [0.0, 0.0, 1.0]])
    names = zip(("c0", "c1"), (pose, beside), strict=True)
    cameras = tuple(Camera(name, (64, 48), matrix, np.zeros(8), pose) for name, pose in names)
    return Rig(cameras, 0, "rig.toml")


def write_cube(folder: Path) -> None:
    """A session of displacements: a cube of 40 mm held at z = 0, pressed from above."""
    mesh = box(size=(0.04, 0.04, 0.04), cells=3)
    write_mesh(folder / "mesh.ply", mesh)
    (folder / "session.toml").write_text(SESSION)
    top = mesh.vertices[mesh.vertices[:, 2] > 0.0]
    moved = np.array([3e-4, 0.0, -4e-4]) * top[:, 2:] / 0.04
    rows = np.hstack([top, moved, np.full((len(top), 1), 1e-4)])
    write_table(folder / "n01.csv", "x,y,z,ux,uy,uz,sigma", rows)


def write_meshes(folder: Path) -> list[Path]:
    """The cube in every format, some in two ways."""
    mesh = box(size=(0.04, 0.04, 0.04), cells=2)
    files = [folder / f"cube{suffix}" for suffix in (".ply", ".obj", ".off", ".msh", ".vtu")]
    for file in files:
        write_mesh(file, mesh)
    plain = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    for name, kind in (("text.ply", "ply"), ("binary.stl", "stl"), ("text.stl", "stl_ascii")):
        extra = {"encoding": "ascii"} if kind == "ply" else {}
        plain.export(folder / name, file_type=kind, **extra)
        files.append(folder / name)
    make = import_module("geometry.test_mesh_files")._vtp
    ends = 3 * np.arange(1, len(mesh.triangles) + 1)
    for kind, compressed in (("ascii", False), ("binary", True), ("appended", False)):
        content = make(
            mesh.vertices, mesh.triangles.ravel(), ends, kind=kind, compressed=compressed
        )
        files.append(folder / f"{kind}.vtp")
        files[-1].write_bytes(content)
    return files


def write_rigs(folder: Path) -> list[Path]:
    """A calibration of every program."""
    write_rig(folder / "rig.toml", two_cameras())
    texts = {
        "vic3d.xml": _texts("correlation").VIC,
        "dice.xml": _texts("dice").DICE,
        "matchid.caldat": _texts("correlation").CALIBRATION,
        "kalibr.yaml": _texts("opencv").KALIBR,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="latin-1")
    opencv = _texts("opencv")
    entries = {name: getattr(opencv, name) for name in ("K1", "D1", "K2", "D2", "R", "T")}
    stereo = [folder / f"stereo.{suffix}" for suffix in ("yml", "xml", "json")]
    for file in stereo:
        opencv._stored(file, **entries, length_unit="mm")
    (folder / "dlt").mkdir()
    _texts("multidic")._multidic(folder / "dlt", two_cameras())
    dlt = folder / "dlt" / "DLTstruct_cam_201.mat"
    return [folder / "rig.toml", *(folder / name for name in texts), *stereo, dlt]


def write_results(folder: Path) -> list[tuple[str, Path]]:
    """Displacements of every program: its kind and a file."""
    matchid = np.column_stack([np.zeros(4), PLACE, MOVE, np.full(4, 1e-3)])
    tables = {
        "vic3d": (_texts("correlation").VIC3D, vic3d_rows(), ","),
        "dice": (",".join(_texts("dice").DICE_NAMES), dice_values(), ","),
        "matchid": (_texts("correlation").MATCHID, matchid, ";"),
        "pyvale": (_texts("point_tables").PYVALE, _texts("point_tables")._pyvale_rows(), ","),
        "opencorr": (_texts("point_tables").OPENCORR, _texts("point_tables")._opencorr_rows(), ","),
        "planar": ("x,y,u,v", np.column_stack([PLACE[:, :2], MOVE[:, :2]]), ","),
    }
    samples = []
    for kind, (header, rows, delimiter) in tables.items():
        file = write_table(folder / f"{kind}.txt", header, rows, delimiter=delimiter)
        samples.append((kind, file))
    for form in ("large", "small", "hdf5"):
        samples.append(("dice", write_exodus(folder / f"{form}.e", dice_states(), form=form)))
    for version in ("5", "7.3"):
        file = folder / f"v{version}.mat"
        samples.append(("duodic", write_mat(file, "DIC3D", multidic_states(), version=version)))
    row = np.zeros(4, dtype=import_module("palpate.records.programs.point_tables")._PYVALE_ROW)
    row["place_mm"], row["disp_mm"], row["converged"], row["stereo_converged"] = PLACE, MOVE, 1, 1
    (folder / "rows.dic3d").write_bytes(row.tobytes())
    for suffix in (".vtu", ".vtk"):
        grid = meshio.Mesh(PLACE, [("triangle", [[0, 1, 2]])], point_data={"displacement": MOVE})
        grid.write(folder / f"grid{suffix}")
        samples.append(("vtu", folder / f"grid{suffix}"))
    return [*samples, ("pyvale", folder / "rows.dic3d")]


def write_estimate_sample(file: Path) -> None:
    """An estimate that was never made."""
    numbers = constants()
    probe = ProbeEstimate("n01", **numbers, observed=20, missing=1, rejected=0,
                          rms_residual=2e-4, prediction_error=None)  # fmt: skip
    known = dict.fromkeys(CONSTANT_NAMES, True)
    estimate = Estimate(
        status=Status.OK,
        **numbers,
        identifiable=known,
        probes=(probe,),
        seconds={"total": 1.0},
        method="reduced",
        settings={},
        notes=(),
    )
    write_estimate(file, estimate)


def _read_picture(path: Path) -> object:
    return read_pictures(two_cameras(), path.name, folder=path.parent, what="step 's1'")


def write_pictures(folder: Path) -> list[Path]:
    """The same picture for both cameras in every format; the files of the first camera."""
    files = [folder / f"{suffix}_c0.{suffix}" for suffix in ("png", "jpg", "tif", "bmp")]
    for file in files:
        for camera in ("c0", "c1"):
            cv2.imwrite(str(file).replace("c0", camera), GREY)
    return files


_TEXTS: dict[str, Reader] = {
    "pose.toml": read_import_pose,
    "press.csv": read_compression,
    "ball.toml": read_lab_config,
    "stage.toml": read_lab_config,
    "pokes.csv": lambda path: read_pokes(read_poke_table(path), Sphere(8e-3)),
}


def write_texts(folder: Path) -> list[Path]:
    """Files of `_TEXTS`."""
    for name, text in zip(_TEXTS, (POSE, COMPRESSION, HALF_BALL, STAGE, POKES), strict=True):
        (folder / name).write_text(text)
    return [folder / name for name in _TEXTS]


def write_scans(folder: Path) -> list[tuple[Path, Reader]]:
    """Points in every format, a depth map, and the table of views; each with its reader."""
    points = np.random.default_rng(5).normal(size=(60, 3))
    np.save(folder / "scan.npy", points)
    np.savetxt(folder / "scan.xyz", points, fmt="%.5f")
    (folder / "scan_points.ply").write_bytes(trimesh.PointCloud(points).export(file_type="ply"))
    write_pcd = import_module("scanning.test_scan_file").pcd
    for kind in ("ascii", "binary"):
        write_pcd(folder / f"{kind}.pcd", kind)
    import_module("scanning.test_scan_file").write(folder / "scan.e57", "e57")
    names = ("scan.npy", "scan.xyz", "scan_points.ply", "ascii.pcd", "binary.pcd", "scan.e57")
    samples: list[tuple[Path, Reader]] = [(folder / name, read_points) for name in names]
    cv2.imwrite(str(folder / "depth.png"), np.full((12, 16), 800, dtype=np.uint16))
    camera = two_cameras().cameras[0]
    depth = partial(depth_points, camera=replace(camera, size=None), metres_per_level=1e-3)
    (folder / "scan.toml").write_text(SCAN)
    return [*samples, (folder / "depth.png", depth), (folder / "scan.toml", read_scan)]


def write_samples(folder: Path) -> list[tuple[Path, Reader]]:
    """Every kind of file in one folder, each with its reader.

    The reader of a session's parts is that of the session: what is damaged is one file.
    """
    write_cube(folder)
    session = folder / "session.toml"
    samples: list[tuple[Path, Reader]] = [
        (folder / name, lambda _path: read_session(session))
        for name in ("session.toml", "n01.csv", "mesh.ply")
    ]
    (folder / "giving.toml").write_text(GIVING)
    samples.append((folder / "giving.toml", read_session))
    (folder / "creeping.toml").write_text(CREEPING)
    (folder / "series.csv").write_text(SERIES)
    shutil.copyfile(folder / "n01.csv", folder / "frame.csv")
    samples += [
        (folder / name, lambda _path: read_session(folder / "creeping.toml"))
        for name in ("series.csv", "frame.csv")
    ]
    samples += [(file, read_mesh) for file in write_meshes(folder)]
    samples += [(file, read_rig) for file in write_rigs(folder)]
    for kind, file in write_results(folder):
        samples.append((file, partial(_measured, kind)))
    samples += list(zip(write_texts(folder), _TEXTS.values(), strict=True))
    samples += write_scans(folder)
    write_estimate_sample(folder / "estimate.json")
    samples.append((folder / "estimate.json", read_estimate))
    samples += write_recorded(folder / "recorded")
    samples += write_kept(folder / "kept")
    for file in write_pictures(folder):
        pattern = folder / file.name.replace("c0", "{camera}")
        samples.append((file, lambda _path, p=pattern: _read_picture(p)))
    return samples


def write_recorded(folder: Path) -> list[tuple[Path, Reader]]:
    """A recording with its tables and a short video, each with what is done with it."""
    write_recording(folder, peaks=PEAKS[:1], rate=50.0)
    (folder / "poses.csv").write_text("time,x,y,z\n0.1,0,0,0.04\n0.2,0,0,0.03\n")
    (folder / "times.csv").write_text("time\n0.1\n0.2\n0.35\n")
    gauge = read_recording(folder).gauge
    bags = import_module("recording.test_force_log")
    logs = []
    for kind in ("bag", "mcap", "db3"):
        (folder / f"as_{kind}").mkdir()
        logs.append(bags.written(folder / f"as_{kind}", kind))

    def presses(_path: Path) -> object:
        log = read_force_log(gauge)
        touches, _ = find_touches(resample_force(log))
        return find_zero(log, touches)

    return [
        (folder / "recording.toml", read_recording),
        (folder / "force.csv", presses),
        (folder / "poses.csv", partial(read_poses, metres_per_unit=1.0)),
        (folder / "times.csv", lambda path: Footage("c0", folder / "c0.avi", (), read_times(path))),
        (folder / "c0.avi", lambda path: camera_motion(Footage("c0", path))),
        *((file, lambda path: read_force_log(bags.gauge_of(path))) for file in logs),
    ]


def write_kept(folder: Path) -> list[tuple[Path, Reader]]:
    """What commands leave for others: a rig's covariance, surfaces, sums, lists and campaigns."""
    write_bench = import_module("faults.bench").write_bench
    folder.mkdir()
    write_bench(folder)
    result, many = folder / "result", folder / "many"
    targets = [Charuco(7, 5, 0.016, 0.012), Chessboard(7, 5, 0.016)]
    shot = folder / "boards" / "c0" / "01.png"
    return [
        (folder / "rig_covariance.npz", read_rig_covariance),
        (result / "surface.npz", lambda _path: read_fitted_surface(result)),
        (result / "inputs.txt", lambda _path: folder_changes(result)),
        (result / "contents.txt", lambda _path: folder_changes(result)),
        (folder / "list.txt", read_items),
        (many / "campaign.sqlite", lambda _path: Store(many).rows()),
        (shot, lambda _path: [target.find(eight_bits(read_grey(shot))) for target in targets]),
        (write_greens(folder), read_green_functions),
    ]


def write_greens(folder: Path) -> Path:
    """Green's functions that nobody solved for."""
    mesh = box(size=(0.04, 0.04, 0.04), cells=1)
    unit = 1e-4 * np.eye(6).reshape(2, 3, 2, 3)
    surface = np.zeros((2, 3, len(mesh.vertices), 3))
    material = exact_material(2e4, 0.3)
    held, nodes = np.array([0, 1]), np.array([4, 5])
    made = GreenFunctions("cube", mesh, held, nodes, unit, surface, unit, unit[None], material, 0.0)
    write_green_functions(folder / "green.npz", made)
    return folder / "green.npz"


def _measured(kind: str, path: Path) -> object:
    return read_measured(kind, path, length_unit="mm")
