"""Where windows are refined: on the CPU, or on an accelerator."""

from importlib import import_module
from typing import Literal

from palpate.optional_imports import late_import
from palpate.vision.refinement.refinement import refine_joint
from palpate.vision.refinement.window_match import Refine

Device = Literal["cpu", "cuda"]


def refinement_on(device: Device) -> Refine:
    """The refinement for a device.

    Parameters
    ----------
    device : "cpu" or "cuda"

    Returns
    -------
    Refine

    Raises
    ------
    InputError                      "cuda": the extra `cuda` is not installed, or no device is found
    """
    if device == "cpu":
        return refine_joint
    late_import("numba_cuda", extra="cuda", purpose="measuring the motion on a CUDA device")
    refinement: Refine = import_module("palpate.vision.refinement.cuda_refinement").CudaRefinement()
    return refinement
