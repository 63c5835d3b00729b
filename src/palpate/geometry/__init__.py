"""Geometry of the object's surface.

Purpose    : triangle surfaces, their quality, points on them, the smooth surface between vertices.
Takes      : arrays and mesh files.
Gives      : `TriangleMesh`, `MeshQuality`, `SurfacePoints`, `QuadraticNodes`, `Registration`.
Depends on : arrays, errors, optional_imports, shapes.
Read first : `triangle_mesh.py`, `mesh_quality.py`.
"""

from palpate.geometry.closest_point import (
    SurfacePoints as SurfacePoints,
    closest_points as closest_points,
    distinct_points as distinct_points,
    triangle_distances as triangle_distances,
)
from palpate.geometry.convex_planes import convex_planes as convex_planes
from palpate.geometry.files.mesh_files import (
    MESH_SUFFIXES as MESH_SUFFIXES,
    read_mesh as read_mesh,
    welded as welded,
    write_mesh as write_mesh,
)
from palpate.geometry.files.step_file import STEP_SUFFIXES as STEP_SUFFIXES
from palpate.geometry.files.vtp_file import check_packed_arrays as check_packed_arrays
from palpate.geometry.mesh_quality import (
    MeshQuality as MeshQuality,
    checked_mesh as checked_mesh,
    mesh_quality as mesh_quality,
)
from palpate.geometry.midside_nodes import (
    QuadraticNodes as QuadraticNodes,
    displacement_nodes as displacement_nodes,
    free_nodes as free_nodes,
    interpolation_matrix as interpolation_matrix,
    linear_nodes as linear_nodes,
    side_nodes as side_nodes,
)
from palpate.geometry.point_order import morton_order as morton_order
from palpate.geometry.quadratic_triangle import (
    ELEMENT_NODES as ELEMENT_NODES,
    element_points as element_points,
    element_spheres as element_spheres,
    quadratic_shapes as quadratic_shapes,
    quartered as quartered,
)
from palpate.geometry.refinement import (
    piece_middles as piece_middles,
    refined_surface as refined_surface,
)
from palpate.geometry.registration.coarse_pose import (
    compact_groups as compact_groups,
    initial_pose as initial_pose,
)
from palpate.geometry.registration.registration import (
    Registration as Registration,
    RegistrationSettings as RegistrationSettings,
    check_registration as check_registration,
    free_motions_text as free_motions_text,
    register as register,
)
from palpate.geometry.self_intersection import intersecting_pairs as intersecting_pairs
from palpate.geometry.sides import (
    CREASE_ANGLE as CREASE_ANGLE,
    Sides as Sides,
    cut_distance as cut_distance,
    split_sides as split_sides,
)
from palpate.geometry.thickness import wall_thickness as wall_thickness
from palpate.geometry.triangle_mesh import (
    TriangleMesh as TriangleMesh,
    area_vectors as area_vectors,
    bounding_diagonal as bounding_diagonal,
    connected_components as connected_components,
    enclosed_volume as enclosed_volume,
    half_edges as half_edges,
    triangle_areas as triangle_areas,
    unit_normals as unit_normals,
    vertex_normals as vertex_normals,
)
