"""Rendering of textured, illuminated bodies with Mitsuba.

Lamp and ambient light are rendered in separate passes, each by the sampling method of least noise:
the lamp by shadow rays to stratified points on it, ambient light by reflected rays. Rendered
together they would need a hundred times the samples, because of the noise of choosing between them.

Mitsuba's compiler loads an LLVM library of the system at run time, and an incompatible one crashes
the whole process: versions below 16 fail on processors with AVX-512 once a kernel is large. So
candidates are tested in a subprocess, and those that fail are never loaded here; without any, the
slower variant without a compiler is chosen.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from palpate.geometry import TriangleMesh, vertex_normals
from palpate.lab.ideal_view import IdealView, camera_picture, ideal_view
from palpate.optional_imports import late_import
from palpate.records import Camera
from palpate.shapes import Vector3, Vertices

# From OpenCV's camera (x right, y down) to Mitsuba's (x left, y up); both look along z.
_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
# Roughness of a moist membrane (Beckmann's alpha): its highlights are some 20 degrees wide.
_ROUGHNESS = 0.25
# The cameras may have different picture sizes.
Picture = Float32[np.ndarray, "_ _"]
# Environment variable that names the LLVM library for Mitsuba's compiler.
LLVM_SETTING = "DRJIT_LIBLLVM_PATH"
# Where systems keep LLVM: Debian, Fedora and Arch, own builds, Homebrew, Windows.
LLVM_FOLDERS = (
    "/usr/lib/*-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
    "C:/Program Files/LLVM/bin",
)
_LIBRARY = re.compile(r"(libLLVM([-.][\d.]+)?\.(so|dylib)[\d.]*|LLVM-C\.dll)")
# Prints what is wrong with the library of argument 1, or "LLVM <version>" if nothing is.
# With -P, or a drjit.py in the current folder would be run; -I would lose the user's own packages.
# LLVMGetVersion exists from LLVM 16 on. The kernel is the proof that Mitsuba's compiler can use it.
_TRIAL = """
import ctypes, sys
try:
    get = ctypes.CDLL(sys.argv[1]).LLVMGetVersion
except OSError:
    sys.exit("cannot be loaded")
except AttributeError:
    sys.exit("is older than LLVM 16")
version = (ctypes.c_uint * 3)()
get(*(ctypes.byref(version, 4 * k) for k in range(3)))
import drjit, drjit.llvm
# LLVM 16 adds, but aborts the process at a maximum.
if list(drjit.maximum(drjit.llvm.Float([1.0, 2.0]) + 1.0, 2.5)) != [2.5, 3.0]:
    sys.exit("computes wrongly")
print("LLVM", ".".join(map(str, version)))
"""
# A trial takes 0.2 s; one that takes a hundred times as long counts as hung.
_TIMEOUT_S = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class DrawnBody:
    """A surface with its reflectance.

    Parameters
    ----------
    mesh : TriangleMesh             object frame; shaded with smooth vertex normals
    grey : (v,) float [-]           reflectance at the vertices, 0 to 1, linear in between
    gloss : float [-]               0 to 1; fraction of the reflected light that is specular, as on
                                    a moist membrane; 0: matt
    """

    mesh: TriangleMesh
    grey: Float[np.ndarray, " v"]
    gloss: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """Square area light that faces a point; itself invisible to the cameras.

    Parameters
    ----------
    position : (3,) float [m]       centre of the lamp, object frame
    target : (3,) float [m]         point that it faces
    side : float [m]                > 0; larger is softer shadows
    radiance : float                >= 0; of its surface, in the unit of the pictures
    """

    position: Vector3
    target: Vector3
    side: float
    radiance: float


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """Illumination of the scene.

    Parameters
    ----------
    ambient : float                 >= 0; radiance from all directions. An unshaded matt body of
                                    reflectance 1 has this radiance; the lamp casts no shadow in it
    lamp : Lamp or None             takes as much rendering time as the ambient light
    """

    ambient: float
    lamp: Lamp | None = None


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant of Mitsuba that runs on this machine.

    Attributes
    ----------
    name : str                      as Mitsuba calls it
    why : str                       one line for the user
    llvm : Path or None             library that it compiles with; None for the scalar variant
    """

    name: str
    why: str
    llvm: Path | None


def render(
    bodies: Sequence[DrawnBody],
    cameras: Sequence[Camera],
    light: Light,
    *,
    variant: Variant,
    samples: int,
    seed: int,
) -> tuple[Picture, ...]:
    """Render bodies for several cameras, as linear radiance without sensor effects.

    Rendered points agree with `vision.project` within 0.02 px. On one machine, with one variant,
    the same seed gives the same bytes.

    Parameters
    ----------
    bodies : sequence of DrawnBody  at least one; all in front of every camera
    cameras : sequence of Camera    each with a picture size; with any distortion
    light : Light
    variant : Variant               of `choose_variant`
    samples : int                   rays per pixel for each light, best a square number. With 16 the
                                    noise is 0.7 grey levels on a black and white speckle and 0.2 on
                                    a smooth texture, at a peak of 220 grey levels
    seed : int                      0 to 2^32 - 1

    Returns
    -------
    tuple of (rows, columns) float32    radiance for each camera, averaged over each pixel's area

    Raises
    ------
    InputError                      a camera without a picture size, or one that sees nothing;
                                    Mitsuba is not installed
    CalibrationError                a body that is not in front of a camera
    """
    points = np.concatenate([body.mesh.vertices for body in bodies])
    views = [ideal_view(camera, points) for camera in cameras]
    mitsuba = load_mitsuba(variant)
    total = [np.zeros(view.shape, dtype=np.float32) for view in views]
    passes = _passes(mitsuba, bodies, light)
    seeds = np.random.SeedSequence(seed).generate_state(len(passes) * len(views))
    for number, (scene, integrator) in enumerate(passes):
        for k, (camera, view) in enumerate(zip(cameras, views, strict=True)):
            film = mitsuba.render(
                scene,
                sensor=_sensor(mitsuba, camera, view, points, samples),
                integrator=integrator,
                seed=int(seeds[number * len(views) + k]),
            )
            total[k] += np.asarray(film, dtype=np.float32)[..., 0]
    return tuple(
        camera_picture(camera, view, picture)
        for camera, view, picture in zip(cameras, views, total, strict=True)
    )


def _passes(
    mitsuba: ModuleType, bodies: Sequence[DrawnBody], light: Light
) -> list[tuple[Any, Any]]:
    """Scene and integrator for the lamp, if there is one, and for the ambient light.

    Direct illumination only: bodies do not illuminate each other.
    """
    matt = [_mesh(mitsuba, body, glossy=False) for body in bodies]
    kinds = [({"type": "constant", "radiance": light.ambient}, matt, (0, 1))]
    if light.lamp is not None:
        glossy = [
            _mesh(mitsuba, body, glossy=True) if body.gloss else mesh
            for body, mesh in zip(bodies, matt, strict=True)
        ]
        kinds.insert(0, (_lamp(mitsuba, light.lamp), glossy, (1, 0)))
    passes = []
    for emitter, meshes, (shadow_rays, reflected_rays) in kinds:
        named = {f"body{k}": mesh for k, mesh in enumerate(meshes)}
        scene = mitsuba.load_dict({"type": "scene", "emitter": emitter, **named})
        integrator = mitsuba.load_dict({
            "type": "direct",
            "emitter_samples": shadow_rays,
            "bsdf_samples": reflected_rays,
            "hide_emitters": True,
        })  # fmt: skip
        passes.append((scene, integrator))
    return passes


def _mesh(mitsuba: ModuleType, body: DrawnBody, *, glossy: bool) -> Any:
    """A body as a Mitsuba mesh; with `glossy` False its specular reflection is left black."""
    matt: dict[str, Any] = {
        "type": "diffuse",
        "reflectance": {"type": "mesh_attribute", "name": "vertex_grey"},
    }
    shine = {"type": "roughconductor", "material": "none", "alpha": _ROUGHNESS}
    dark = {"type": "diffuse", "reflectance": 0.0}
    look: dict[str, Any] = matt
    if body.gloss:
        look = {"type": "blendbsdf", "weight": body.gloss, "first": matt}
        look["second"] = shine if glossy else dark
    properties = mitsuba.Properties()
    properties["look"] = mitsuba.load_dict(look)
    vertices, triangles = body.mesh.vertices, body.mesh.triangles
    mesh = mitsuba.Mesh(
        "body", len(vertices), len(triangles), has_vertex_normals=True, props=properties
    )
    mesh.add_attribute("vertex_grey", 1, body.grey.astype(np.float32))
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = vertex_normals(vertices, triangles).astype(np.float32).ravel()
    parameters["faces"] = triangles.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def _lamp(mitsuba: ModuleType, lamp: Lamp) -> dict[str, Any]:
    """A lamp as Mitsuba's rectangle."""
    toward = lamp.target - lamp.position
    up = np.eye(3)[np.argmin(np.abs(toward))]
    pose = mitsuba.ScalarTransform4f().look_at(
        origin=list(lamp.position), target=list(lamp.target), up=list(up)
    )
    return {
        "type": "rectangle",
        "to_world": pose @ mitsuba.ScalarTransform4f().scale(0.5 * lamp.side),
        "shine": {"type": "area", "radiance": lamp.radiance},
    }


def _sensor(
    mitsuba: ModuleType, camera: Camera, view: IdealView, points: Vertices, samples: int
) -> Any:
    """Mitsuba's pinhole for an ideal view."""
    rows, columns = view.shape
    pose = camera.T_camera_object
    depth = points @ pose[2, :3] + pose[2, 3]
    return mitsuba.load_dict({
        "type": "perspective",
        "to_world": mitsuba.ScalarTransform4f(np.linalg.inv(pose) @ _OPENCV),
        "fov_axis": "x",
        "fov": float(np.degrees(2.0 * np.arctan(0.5 * columns / view.focal))),
        # Offset of the picture's middle from the principal point, as a fraction of its size.
        "principal_point_offset_x": 0.5 - (view.centre[0] + 0.5) / columns,
        "principal_point_offset_y": 0.5 - (view.centre[1] + 0.5) / rows,
        "near_clip": 0.5 * float(depth.min()),
        "far_clip": 2.0 * float(depth.max()),
        "film": {
            "type": "hdrfilm",
            "width": columns,
            "height": rows,
            "pixel_format": "luminance",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {
            "type": "multijitter",
            "sample_count": -(-samples // view.fine**2),
        },
    })  # fmt: skip


def choose_variant(
    *,
    folders: Iterable[str] = LLVM_FOLDERS,
    environment: Mapping[str, str] | None = None,
) -> Variant:
    """Choose the fastest variant of Mitsuba that is known to work here; never fails.

    Parameters
    ----------
    folders : patterns of folders   searched for LLVM libraries, newest version first
    environment : mapping or None   the library in its DRJIT_LIBLLVM_PATH is tried first; None: the
                                    environment of the process

    Returns
    -------
    Variant                         llvm_ad_rgb with a compatible LLVM, else scalar_rgb
    """
    setting = (os.environ if environment is None else environment).get(LLVM_SETTING, "")
    candidates = ([Path(setting)] if setting else []) + llvm_candidates(folders)
    unfit = []
    for library in candidates:
        fit, finding = _try(library)
        if fit:
            return Variant("llvm_ad_rgb", f"Mitsuba renders with {finding} ({library})", library)
        unfit.append(f"{library} {finding}")
    reason = "; ".join(unfit) if unfit else "no LLVM library found"
    return Variant(
        "scalar_rgb",
        f"Mitsuba renders with its scalar variant, slower than with LLVM: {reason}."
        f" To speed up: install LLVM 16 or newer, or set {LLVM_SETTING} to its library",
        None,
    )


def llvm_candidates(folders: Iterable[str] = LLVM_FOLDERS) -> list[Path]:
    """LLVM libraries in some folders, the newest version first, each file once.

    Parameters
    ----------
    folders : patterns of folders   absolute, with wild cards

    Returns
    -------
    list of Path                    by the version in the file's own name
    """
    libraries = {
        Path(file).resolve()
        for folder in folders
        for file in glob(f"{folder}/*LLVM*")
        if _LIBRARY.fullmatch(Path(file).name)
    }
    return sorted(libraries, key=lambda file: (_version(file), str(file)), reverse=True)


def load_mitsuba(variant: Variant) -> ModuleType:
    """Import Mitsuba and activate a variant, which applies to the whole process.

    Parameters
    ----------
    variant : Variant               of `choose_variant`

    Returns
    -------
    module

    Raises
    ------
    InputError                      Mitsuba is not installed
    """
    if variant.llvm is not None:
        os.environ[LLVM_SETTING] = str(variant.llvm)
    mitsuba = late_import("mitsuba", extra="lab", purpose="rendering pictures")
    if mitsuba.variant() != variant.name:
        mitsuba.set_variant(variant.name)
    return mitsuba


def _version(library: Path) -> tuple[int, ...]:
    """Version in the file name of a library; empty if there is none."""
    return tuple(int(number) for number in re.findall(r"\d+", library.name))


def _try(library: Path) -> tuple[bool, str]:
    """Whether Mitsuba's compiler works with a library, and its version or what is wrong."""
    try:
        trial = subprocess.run(
            [sys.executable, "-P", "-c", _TRIAL, str(library)],
            capture_output=True,
            text=True,
            errors="replace",
            env={**os.environ, LLVM_SETTING: str(library)},
            timeout=_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False, "could not be tried"
    if trial.returncode == 0:
        return True, trial.stdout.strip()
    if trial.returncode == 1 and "Traceback" not in trial.stderr:
        return False, trial.stderr.strip()
    return False, "fails in Mitsuba's compiler"
