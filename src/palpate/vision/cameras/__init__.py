"""Projection of points into calibrated cameras, and from pixels back into space.

Purpose    : projection with its Jacobian and inverse, triangulation, rectification, and the surface
             point seen by each pixel.
Takes      : `Camera` and `Rig`, points, pixels, a triangle surface.
Gives      : pixels, rays, `Triangulation`, `SurfaceMap`, `Rectified`, apparent strains due to
             calibration errors.
Depends on : `vision.images`, `vision.small_systems`, `records`.
Read first : `lens.py`, then `projection.py`.
"""

from palpate.vision.cameras.lens import (
    distort_kernel as distort_kernel,
    jacobian_kernel as jacobian_kernel,
    project_kernel as project_kernel,
)
from palpate.vision.cameras.projection import (
    camera_sigma as camera_sigma,
    normalised as normalised,
    packed_rig as packed_rig,
    pixel_grid as pixel_grid,
    pixel_sizes as pixel_sizes,
    project as project,
    project_jacobian as project_jacobian,
    rays as rays,
)
from palpate.vision.cameras.rectification import (
    Rectified as Rectified,
    rectify as rectify,
    remapped as remapped,
)
from palpate.vision.cameras.space_strain import (
    calibration_numbers as calibration_numbers,
    moved_rig as moved_rig,
    space_strains as space_strains,
)
from palpate.vision.cameras.surface_map import (
    SurfaceMap as SurfaceMap,
    surface_map as surface_map,
    visible as visible,
)
from palpate.vision.cameras.triangulation import (
    Triangulation as Triangulation,
    triangulate as triangulate,
)
