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
    inside as inside,
    ray_intersection as ray_intersection,
    triangle_distances as triangle_distances,
)
from palpate.geometry.mesh_files import (
    MESH_SUFFIXES as MESH_SUFFIXES,
    STEP_SUFFIXES as STEP_SUFFIXES,
    WRITTEN_SUFFIXES as WRITTEN_SUFFIXES,
    read_mesh as read_mesh,
    welded as welded,
    write_mesh as write_mesh,
)
from palpate.geometry.mesh_quality import (
    MeshQuality as MeshQuality,
    checked_mesh as checked_mesh,
    mesh_quality as mesh_quality,
    wall_thickness as wall_thickness,
)
from palpate.geometry.midside_nodes import (
    ELEMENT_NODES as ELEMENT_NODES,
    QuadraticNodes as QuadraticNodes,
    displacement_nodes as displacement_nodes,
    element_points as element_points,
    element_spheres as element_spheres,
    free_nodes as free_nodes,
    interpolation_matrix as interpolation_matrix,
    linear_nodes as linear_nodes,
    piece_middles as piece_middles,
    quadratic_shapes as quadratic_shapes,
    quartered as quartered,
    refined_surface as refined_surface,
    side_nodes as side_nodes,
)
from palpate.geometry.registration import (
    Registration as Registration,
    check_registration as check_registration,
    free_motions_text as free_motions_text,
    register as register,
)
from palpate.geometry.surface_fit import (
    compact_groups as compact_groups,
    initial_pose as initial_pose,
)
from palpate.geometry.surface_strain import surface_strain as surface_strain
from palpate.geometry.triangle_mesh import (
    BESIDE as BESIDE,
    CREASE_ANGLE as CREASE_ANGLE,
    Sides as Sides,
    TriangleMesh as TriangleMesh,
    area_vectors as area_vectors,
    bounding_diagonal as bounding_diagonal,
    connected_components as connected_components,
    convex_planes as convex_planes,
    cut_distance as cut_distance,
    enclosed_volume as enclosed_volume,
    half_edges as half_edges,
    is_outer as is_outer,
    morton_order as morton_order,
    place_text as place_text,
    random_points as random_points,
    split_sides as split_sides,
    triangle_areas as triangle_areas,
    unit_normals as unit_normals,
    vertex_normals as vertex_normals,
)
