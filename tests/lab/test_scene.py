"""Rendered pictures: places by OpenCV's projection, brightness by closed forms.

In the choice of Mitsuba's variant no library, broken or too old, ever ends the process.
"""

import importlib
import sys
from dataclasses import replace
from types import ModuleType

import cv2
import numpy as np
import pytest
from surfaces import sphere
from vision_cameras import BARREL, RATIONAL, make_camera

from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh
from palpate.lab import scene
from palpate.lab.scene import (
    LLVM_SETTING,
    DrawnBody,
    Lamp,
    Light,
    Variant,
    choose_variant,
    llvm_candidates,
    load_mitsuba,
    render,
)
from palpate.vision.projection import rays

# The scalar variant runs everywhere.
SCALAR = choose_variant(folders=(), environment={})
AMBIENT = Light(1.0)
# An eighth of the picture bends away at the corners of this one.
STRONG = (-0.45, 0.2, 2e-3, -3e-3, 0.0)
# Stands for a compiler that works, that ends the process, or that hangs.
_FIT = 'import sys; print("LLVM 99.0.0")'
_CRASH = "import os; os.abort()"
_UNKNOWN = "raise RuntimeError"


def _camera(lens=(), **options):
    """A small camera without skew; OpenCV's functions know none."""
    size = (160, 120)
    camera = make_camera(lens=lens, skew=0.0, focal=options.pop("focal", 300.0), size=size)
    matrix = camera.matrix.copy()
    matrix[:2, 2] = 81.3, 57.6
    if options.pop("square", False):
        matrix[1, 1] = matrix[0, 0]
    return replace(camera, matrix=matrix)


def _sheet(corners, grey=1.0, gloss=0.0):
    """A flat quadrangle, corners in order around its normal."""
    corners = np.array(corners, dtype=float)
    mesh = TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    return DrawnBody(mesh, np.full(4, grey), gloss)


def _square(side, z=0.0, *, grey=1.0, gloss=0.0):
    h = 0.5 * side
    return _sheet([[-h, -h, z], [h, -h, z], [h, h, z], [-h, h, z]], grey, gloss)


def _above(focal=200.0, size=(41, 31)):
    """A camera 1 m above the origin that looks straight down; its axis meets a pixel's centre."""
    camera = make_camera(lens=(), skew=0.0, focal=focal, size=size)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 1.0
    middle = [(size[0] - 1) / 2, (size[1] - 1) / 2]
    matrix = np.array([[focal, 0.0, middle[0]], [0.0, focal, middle[1]], [0.0, 0.0, 1.0]])
    return replace(camera, matrix=matrix, T_camera_object=pose)


def _shot(body, light):
    """A body from above."""
    return render([body], [_above()], light, variant=SCALAR, samples=16, seed=0)


def _discs(camera, rng):
    """White discs of 3 px radius that face a camera, a grid of them at any sub-pixel phase.

    Returns the body and the rims (discs, corners, 3).
    """
    columns, rows = camera.size
    grid = np.meshgrid(np.linspace(12, columns - 13, 9), np.linspace(12, rows - 13, 7))
    pixels = np.stack(grid, -1).reshape(-1, 2)
    pixels += rng.uniform(-0.5, 0.5, pixels.shape)
    origin, direction = rays(camera, pixels)
    distance = rng.uniform(0.4, 0.8, len(pixels))
    centre = origin + distance[:, None] * direction
    a = np.cross(direction, [0.3, 1.0, 0.2])
    a /= np.linalg.norm(a, axis=1)[:, None]
    b = np.cross(direction, a)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radius = 3.0 * distance / camera.matrix[0, 0]
    circle = np.cos(angle)[:, None] * a[:, None] + np.sin(angle)[:, None] * b[:, None]
    rims = centre[:, None] + radius[:, None, None] * circle
    vertices = np.concatenate([centre[:, None], rims], axis=1).reshape(-1, 3)
    fan = np.array([[0, 1 + (k + 1) % 24, 1 + k] for k in range(24)])
    triangles = (fan + 25 * np.arange(len(centre))[:, None, None]).reshape(-1, 3)
    return DrawnBody(TriangleMesh(vertices, triangles), np.ones(len(vertices))), rims


def _polygon_centroid(corners):
    """Centroid of a polygon (k, 2)."""
    x, y = (corners - corners[0]).T
    step = x * np.roll(y, -1) - np.roll(x, -1) * y
    sums = [((v + np.roll(v, -1)) * step).sum() for v in (x, y)]
    return corners[0] + np.array(sums) / (3.0 * step.sum())


@pytest.mark.parametrize(
    ("lens", "focal", "square"),
    [((), 300.0, True), ((), 300.0, False), (BARREL, 150.0, True), (RATIONAL, 150.0, False),
     (STRONG, 140.0, True)],
)  # fmt: skip
def test_discs_appear_where_opencv_projects_them(lens, focal, square):
    camera = _camera(lens, focal=focal, square=square)
    body, rims = _discs(camera, np.random.default_rng(3))
    (picture,) = render([body], [camera], AMBIENT, variant=SCALAR, samples=144, seed=1)
    turn = cv2.Rodrigues(camera.T_camera_object[:3, :3])[0]
    shift = camera.T_camera_object[:3, 3]
    error = []
    for rim in rims:
        outline = cv2.projectPoints(rim, turn, shift, camera.matrix, camera.distortion)[0][:, 0]
        centre = _polygon_centroid(outline)
        column, row = np.rint(centre).astype(int)
        window = (slice(row - 6, row + 7), slice(column - 6, column + 7))
        grid = np.mgrid[window]
        weight = picture[window].astype(float)
        error.append([(weight * grid[1]).sum(), (weight * grid[0]).sum()] / weight.sum() - centre)
    error = np.array(error)
    # Required: 0.02 px. The samples on a disc's rim leave 0.004 px; the mean over the discs, at
    # all sub-pixel phases, is good to 0.0005.
    assert np.abs(error).max() < 0.02
    assert np.abs(error.mean(axis=0)).max() < 0.002


def test_undoing_no_lens_changes_nothing_but_noise():
    """A lens too weak to matter sends the picture through the resampling."""
    rng = np.random.default_rng(5)
    n = 60
    line = np.linspace(-0.1, 0.1, n)
    x, y = (g.ravel() for g in np.meshgrid(line, line))
    k = np.arange(n * n).reshape(n, n)
    a, b, c, d = k[:-1, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel(), k[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    vertices = np.column_stack([x, y, np.zeros(n * n)])
    body = DrawnBody(TriangleMesh(vertices, triangles), rng.random(n * n))
    camera = _above(focal=600.0, size=(100, 80))
    weak = replace(camera, distortion=np.array([1e-12]))
    plain, resampled = (
        render([body], [lens], AMBIENT, variant=SCALAR, samples=64, seed=2)[0].astype(float)
        for lens in (camera, weak)
    )
    difference = resampled - plain
    inner = (slice(5, -5), slice(5, -5))
    # Grey changes by about 0.15 a pixel; 64 stratified samples of that leave 0.002 of noise.
    assert difference[inner].std() < 0.006
    assert abs(difference[inner].mean()) < 5e-4
    slope = np.stack([np.gradient(plain, axis=1)[inner], np.gradient(plain, axis=0)[inner]])
    shift = np.linalg.lstsq(slope.reshape(2, -1).T, difference[inner].ravel(), rcond=None)[0]
    assert np.abs(shift).max() < 0.002


def test_matt_body_under_ambient_light_is_as_bright_as_its_grey():
    (picture,) = _shot(_square(0.1, grey=0.4), Light(0.7))
    assert picture.dtype == np.float32
    assert picture.shape == (31, 41)
    # 0.1 m is 20 px, from 0.5 px before a centre to 0.5 after one: +-9.5 px about the middle pixel
    # is inside, and the pixels at +-10 are half covered.
    assert picture[15, 20] == pytest.approx(0.28, rel=1e-5)
    assert picture[0, 0] == 0.0
    assert picture[15, 10] == pytest.approx(0.14, abs=0.01)
    assert picture.sum() / 0.28 == pytest.approx(400.0, rel=2e-3)


def test_lamp_lights_by_the_inverse_square_and_the_cosines():
    """E = L A cos cos / d^2, and a matt body of grey g sends g E / pi."""
    light = Light(0.0, Lamp(np.array([0.6, 0.0, 0.8]), np.zeros(3), 0.02, 7.0))
    (picture,) = _shot(_square(0.1, grey=0.5), light)
    # The lamp is 0.02 of its distance wide: the formula for a point is good to 1e-4.
    assert picture[15, 20] == pytest.approx(0.5 * 7.0 * 0.02**2 * 0.8 / np.pi, rel=1e-3)
    # Nearer to the lamp it is brighter: 0.04 m along x.
    d2 = 0.56**2 + 0.8**2
    ratio = (0.8 * (0.56 * 0.6 + 0.8 * 0.8)) / d2**2 / 0.8
    assert picture[15, 28] / picture[15, 20] == pytest.approx(ratio, rel=2e-3)


def test_a_body_throws_a_shadow_that_a_long_lamp_softens():
    def shaded(side):
        lamp = Lamp(np.array([0.0, 0.5, 1.0]), np.zeros(3), side, 1.0 / side**2)
        bodies = [_square(0.2), _square(0.02, z=0.05)]
        light = Light(0.0, lamp)
        (picture,) = render(bodies, [_above()], light, variant=SCALAR, samples=64, seed=0)
        # The column through the blade, lower in the picture than it: y falls as the row grows.
        return picture[17:28, 20] / picture[15, 2]

    hard, soft = shaded(0.005), shaded(0.2)
    assert hard.min() < 0.02
    assert ((hard > 0.1) & (hard < 0.9)).sum() <= 3
    assert ((soft > 0.1) & (soft < 0.9)).sum() >= 3


def test_gloss_makes_a_highlight_and_takes_its_share_from_the_matt_part():
    lamp = Lamp(np.array([0.0, 0.0, 1.5]), np.zeros(3), 0.02, 100.0)
    ambient, lit = AMBIENT, Light(0.0, lamp)
    pictures = {
        (gloss, light is lit): _shot(_square(0.1, grey=0.5, gloss=gloss), light)[0][15, 20]
        for gloss in (0.0, 0.1)
        for light in (ambient, lit)
    }
    assert pictures[0.1, False] == pytest.approx(0.9 * pictures[0.0, False], rel=1e-4)
    assert pictures[0.1, True] > 1.2 * pictures[0.0, True]


def test_noise_of_16_samples_is_well_below_a_sensors():
    """A curved body under a lamp and ambient light, at 200 grey levels where it is brightest."""
    body = _ball()
    light = Light(0.3, Lamp(np.array([0.3, 0.2, 0.9]), np.zeros(3), 0.3, 5.0))
    camera = _above(focal=500.0, size=(64, 48))
    first, second = (
        render([body], [camera], light, variant=SCALAR, samples=16, seed=seed)[0].astype(float)
        for seed in (1, 2)
    )
    inside = (slice(12, -12), slice(20, -20))
    noise = (first - second)[inside].std() / np.sqrt(2.0)
    # Measured: 0.35; half of 1.5 grey levels, the noise of a good camera, is the most it may be.
    assert 200.0 / first.max() * noise < 0.75


def test_same_seed_same_bytes_and_another_seed_others():
    body = _ball()
    light = Light(0.3, Lamp(np.array([0.3, 0.2, 0.9]), np.zeros(3), 0.3, 5.0))
    cameras = [_above(focal=300.0), replace(_above(focal=300.0), distortion=np.array([-0.2]))]
    first, again, other = (
        render([body], cameras, light, variant=SCALAR, samples=4, seed=seed) for seed in (7, 7, 8)
    )
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not any(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def _ball():
    """A ball with smooth normals."""
    mesh = sphere(5, 0.05)
    return DrawnBody(mesh, np.full(len(mesh.vertices), 0.5))


def test_cameras_that_cannot_see_are_refused():
    def shot(camera):
        render([_square(0.01)], [camera], AMBIENT, variant=SCALAR, samples=4, seed=0)

    with pytest.raises(InputError, match="has no size"):
        shot(replace(_above(), size=None))
    aside = _above().T_camera_object.copy()
    aside[0, 3] = 1.0
    with pytest.raises(InputError, match=r"sees nothing of the bodies: .* 45 degrees off"):
        shot(replace(_above(), T_camera_object=aside))
    behind = aside.copy()
    behind[2, 3] = -1.0
    with pytest.raises(CalibrationError, match="4 of 4 points of the bodies lie beside or behind"):
        shot(replace(_above(), T_camera_object=behind))


@pytest.fixture
def libraries(tmp_path):
    """A folder with files named like LLVM's libraries, none of which is one."""
    for name in ("libLLVM-9.so", "libLLVM-17.so.1", "libLLVM.so.19.1", "libLLVMCore.a", "libc.so"):
        (tmp_path / name).write_text("no library")
    return tmp_path


def test_candidates_come_newest_first_and_only_once(libraries):
    (libraries / "libLLVM-19.so").symlink_to(libraries / "libLLVM.so.19.1")
    candidates = llvm_candidates(
        [str(libraries), str(libraries.parent / "*"), "relative", "Z:/none"]
    )
    assert [file.name for file in candidates] == [
        "libLLVM.so.19.1",
        "libLLVM-17.so.1",
        "libLLVM-9.so",
    ]


def test_a_file_that_is_no_library_leaves_the_scalar_variant(libraries):
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert variant.name == "scalar_rgb"
    assert variant.llvm is None
    assert "libLLVM-17.so.1 cannot be loaded" in variant.why
    assert "\n" not in variant.why


def test_nothing_found_says_how_to_speed_up():
    variant = choose_variant(folders=(), environment={})
    assert variant.name == "scalar_rgb"
    assert "no LLVM library found" in variant.why
    assert LLVM_SETTING in variant.why


def test_a_library_without_the_version_of_llvm_16_is_too_old():
    # Any library that has not LLVMGetVersion: the interpreter's own extension modules.
    library = next(
        str(module.__file__)
        for module in list(sys.modules.values())
        if str(getattr(module, "__file__", "")).endswith(".so")
    )
    variant = choose_variant(folders=(), environment={LLVM_SETTING: library})
    assert variant.name == "scalar_rgb"
    assert f"{library} is older than LLVM 16" in variant.why


@pytest.mark.parametrize("trial", [_CRASH, _UNKNOWN])
def test_a_compiler_that_fails_costs_only_its_own_process(libraries, monkeypatch, trial):
    monkeypatch.setattr(scene, "_TRIAL", trial)
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert variant.name == "scalar_rgb"
    assert "libLLVM-9.so fails in Mitsuba's compiler" in variant.why


def test_a_compiler_that_hangs_is_given_up(libraries, monkeypatch):
    monkeypatch.setattr(scene, "_TRIAL", "import time; time.sleep(60)")
    monkeypatch.setattr(scene, "_TIMEOUT_S", 0.2)
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert "could not be tried" in variant.why


def test_a_fit_library_is_taken_and_the_users_own_is_asked_first(libraries, monkeypatch):
    monkeypatch.setattr(scene, "_TRIAL", _FIT)
    newest = libraries / "libLLVM.so.19.1"
    variant = choose_variant(folders=[str(libraries)], environment={})
    assert variant == Variant("llvm_ad_rgb", f"Mitsuba renders with LLVM 99.0.0 ({newest})", newest)
    chosen = libraries / "libLLVM-9.so"
    variant = choose_variant(folders=[str(libraries)], environment={LLVM_SETTING: str(chosen)})
    assert variant.llvm == chosen


def test_loading_tells_the_compiler_its_library_and_keeps_the_variant(monkeypatch):
    chosen = []

    fake = ModuleType("mitsuba")
    fake.variant = lambda: chosen[-1] if chosen else None
    fake.set_variant = chosen.append
    monkeypatch.setattr(scene, "late_import", lambda *_, **__: fake)
    monkeypatch.setenv(LLVM_SETTING, "before")
    variant = Variant("llvm_ad_rgb", "", scene.Path("/some/libLLVM.so"))
    load_mitsuba(variant)
    load_mitsuba(variant)
    assert chosen == ["llvm_ad_rgb"]
    assert scene.os.environ[LLVM_SETTING] == str(variant.llvm)


def test_missing_mitsuba_names_the_extra(monkeypatch):
    def absent(name):
        raise ModuleNotFoundError(name=name)

    late = importlib.import_module("palpate.optional_imports")
    monkeypatch.setattr(late, "import_module", absent)
    with pytest.raises(InputError, match=r"pip install 'palpate\[lab\]'"):
        load_mitsuba(Variant("scalar_rgb", "", None))
