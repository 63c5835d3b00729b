"""The refinement on a CUDA device against that on the CPU: every outcome, every figure.

Where there is no device, numba's simulator runs the same code for a few points, in a process of its
own: it must be chosen before numba is loaded.
"""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import config, cuda
from vision.scenes import MOTIONS, PITCH, example, example_views, noisy_views

from palpate.errors import InputError
from palpate.vision.images.spline import make_spline_picture
from palpate.vision.range_flow import Outcome
from palpate.vision.refinement import Limits, make_scene, refine_joint, refinement_on

SIMULATED = bool(config.ENABLE_CUDASIM)
# Half a window, and points: the simulator is slow.
HALF, COUNT = (4, 60) if SIMULATED else (10, 2000)
NOISE = 1.5
on_device = pytest.mark.skipif(
    not (SIMULATED or cuda.is_available()), reason="neither a CUDA device nor its simulator"
)


class _OnPlainArrays:
    """A kernel in the simulator: what it calls is compiled, and takes numpy's arrays only."""

    def __init__(self, kernel):
        self.kernel = kernel

    def __getitem__(self, launch):
        return lambda *arguments: self.kernel[launch](*map(self._plain, arguments))

    def _plain(self, value):
        if isinstance(value, tuple):
            values = [self._plain(each) for each in value]
            return type(value)(*values) if hasattr(value, "_fields") else tuple(values)
        return getattr(value, "_ary", value)


@pytest.fixture(scope="module")
def refine():
    # Late, as for a user: kernels for a device are not to be loaded without one.
    from palpate.vision.refinement import cuda_refinement  # noqa: PLC0415

    if SIMULATED:
        # Its threads wait for each other in turn.
        sys.setswitchinterval(1e-5)
        cuda_refinement._THREADS, cuda_refinement._MOST_BLOCKS = 3, 4
        cuda_refinement.refine_kernel = _OnPlainArrays(cuda_refinement.refine_kernel)
    return cuda_refinement.CudaRefinement()


@pytest.fixture(scope="module")
def scene():
    views = noisy_views(example_views("still"), NOISE, 1)
    # A stripe that one camera sees without texture, and pictures of different sizes.
    views[2][:, 100:130] = 90.0
    views[1] = views[1][:-30]
    stage = example()
    rig = replace(stage.rig, cameras=tuple(replace(c, size=None) for c in stage.rig.cameras))
    return make_scene(rig, views, *stage.mesh(), subset=2 * HALF + 1, step=3, smoothing=0.0)


def _task(scene, name, seed):
    """Points, the pictures after a motion, and starts that miss it by a third of a pixel."""
    rng = np.random.default_rng(seed)
    rows = rng.permutation(len(scene.point))[:COUNT]
    start = np.zeros((len(rows), 6, 3))
    start[:, 0] = MOTIONS[name](scene.point[rows])
    start[:, 0] += rng.normal(0.0, PITCH / 3.0, (len(rows), 3))
    # Some start far off, some from nowhere.
    start[::7, 0] += 15.0 * PITCH
    start[3::11] = np.nan
    moved = [make_spline_picture(v) for v in noisy_views(example_views(name), NOISE, seed)]
    return rows, moved, start


def _compared(found, expected):
    """Every outcome the same, and every figure within what ends the iteration."""
    np.testing.assert_array_equal(found.outcome, expected.outcome)
    good = expected.outcome == Outcome.VALID
    assert good.sum() > 0.3 * len(good)
    # What a camera alone would do is rounding where it sees no texture.
    sure = good[:, None] & ~(expected.own_variance > 1.0)
    for name, value in expected._asdict().items():
        here, chosen = getattr(found, name), sure if name.startswith("own") else good
        np.testing.assert_array_equal(np.isnan(here), np.isnan(value))
        # A step of 1e-3 px ends the iteration; rounding may add one or leave one out. Derivatives,
        # which do not end it, follow within some times that.
        size = {"motion": 1e-2 * PITCH, "own_step": 1e-3}.get(name, 1e-12)
        np.testing.assert_allclose(here[chosen], value[chosen], rtol=3e-3, atol=size, err_msg=name)
    np.testing.assert_allclose(
        found.motion[good, 0], expected.motion[good, 0], rtol=0.0, atol=1e-3 * PITCH
    )


@on_device
@pytest.mark.parametrize(
    ("bases", "shading", "name"),
    [(1, False, "shift"), (3, True, "turn"), (3, False, "strain"), (6, True, "bump")],
)
def test_same_as_on_the_cpu(refine, scene, bases, shading, name):
    rows, moved, start = _task(scene, name, bases)
    noise = np.array([1.0, 1.3, 0.8]) * NOISE
    limits = Limits(HALF, bases=bases, shading=shading)
    cameras = scene.seen[rows]
    cameras[::5, 1] = False
    expected = refine_joint(scene, rows, moved, start, cameras, noise, limits)
    found = refine(scene, rows, moved, start, cameras, noise, limits)
    _compared(found, expected)


@on_device
def test_noise_without_bound_leaves_no_texture(refine, scene):
    rows, moved, start = _task(scene, "shift", 0)
    found = refine(
        scene, rows[:3], moved, start[:3], scene.seen[rows[:3]], np.full(3, np.inf), Limits(HALF)
    )
    assert set(found.outcome) <= {Outcome.TEXTURE, Outcome.HIDDEN, Outcome.LOST}
    assert Outcome.TEXTURE in found.outcome


@on_device
def test_nothing_asked(refine, scene):
    rows, moved, start = _task(scene, "shift", 0)
    found = refine(scene, rows[:0], moved, start[:0], scene.seen[:0], np.ones(3), Limits(HALF))
    assert len(found.outcome) == 0


@pytest.mark.skipif(SIMULATED, reason="this is the simulator")
def test_same_as_on_the_cpu_in_the_simulator():
    # Not one of several processes that share the tests.
    here = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    run = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"),
            *("-o", "addopts=--import-mode=importlib", __file__),
        ],
        env=here | {"NUMBA_ENABLE_CUDASIM": "1"},
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "8 passed" in run.stdout, run.stdout[-3000:]


@pytest.mark.skipif(SIMULATED or cuda.is_available(), reason="there is a device")
def test_no_device():
    from palpate.vision.refinement.cuda_refinement import CudaRefinement  # noqa: PLC0415

    with pytest.raises(InputError, match=r"no CUDA device was found .*--device cpu.* driver"):
        CudaRefinement()


def test_package_that_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba_cuda", None)
    with pytest.raises(InputError, match=r"pip install 'palpate\[cuda\]'"):
        refinement_on("cuda")


def test_cpu():
    assert refinement_on("cpu") is refine_joint
