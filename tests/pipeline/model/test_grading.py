"""Graded meshes: closed, on the surface, finer at rims alone; and nearer to a much finer mesh."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import box, joined, sphere

from palpate.bem import make_surface
from palpate.geometry import TriangleMesh, checked_mesh, closest_points, welded
from palpate.pipeline import (
    graded_session,
    make_object_model,
    refined_session,
    session_observations,
)
from palpate.pipeline.model.grading import (
    ROW,
    edge_refined_session,
    graded_mesh,
    refined_mesh,
)
from palpate.records import EXACT, Contact, DisplacementField, Probing, Session

RADIUS = 0.03


def _ball() -> tuple[TriangleMesh, np.ndarray]:
    mesh = TriangleMesh(RADIUS * sphere(2).vertices, sphere(2).triangles)
    return mesh, mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.3 * RADIUS


def _graded(mesh: TriangleMesh, held: np.ndarray) -> tuple[TriangleMesh, np.ndarray]:
    return graded_mesh(make_surface(mesh, np.flatnonzero(held)))


def test_it_is_closed_and_keeps_its_vertices() -> None:
    mesh, held = _ball()
    fine, parent = _graded(mesh, held)
    _, notes = checked_mesh(fine)
    assert notes == ()
    np.testing.assert_array_equal(fine.vertices[: len(mesh.vertices)], mesh.vertices)
    # Straight edges of 9 mm miss the ball by 1.1 % of its radius in their middle; curved ones are
    # fitted from one side of the rim only.
    distance = np.linalg.norm(fine.vertices, axis=1) / RADIUS
    assert np.abs(distance - 1.0).max() < 6e-3
    # Far from the rim every triangle is whole.
    rim = np.intersect1d(mesh.triangles[held], mesh.triangles[~held])
    touched = np.isin(mesh.triangles, rim).any(axis=1)
    counts = np.bincount(parent, minlength=len(held))
    assert (counts[~touched] == 1).all()
    assert (counts[touched] == 3).all()


def test_the_row_at_the_rim_has_its_width() -> None:
    """On flat faces, where lengths are exact."""
    mesh = box(cells=4)
    held = np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1)
    fine, parent = _graded(mesh, held)
    rim = np.intersect1d(mesh.triangles[held], mesh.triangles[~held])
    new = fine.vertices[len(mesh.vertices) :]
    # On the sides the first row of squares is 1/4 high; its diagonals are cut as its edges are.
    heights = np.unique(new[:, 2].round(12))
    assert heights.tolist() == [0.0, round(ROW / 4, 12)]
    assert not np.isin(np.arange(len(mesh.vertices), len(fine.vertices)), rim).any()
    area = np.linalg.norm(
        np.cross(
            fine.vertices[fine.triangles[:, 1]] - fine.vertices[fine.triangles[:, 0]],
            fine.vertices[fine.triangles[:, 2]] - fine.vertices[fine.triangles[:, 0]],
        ),
        axis=1,
    )
    # Parts of a flat triangle have its area together.
    np.testing.assert_allclose(np.bincount(parent, 0.5 * area), 0.5 / 16, rtol=1e-9)


def test_faces_one_element_wide_are_cut_in_their_middle() -> None:
    mesh = box((0.6, 0.1, 0.4), (6, 1, 4))
    held = np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1)
    surface = make_surface(mesh, np.flatnonzero(held))
    fine, parent = refined_mesh(surface)
    _, notes = checked_mesh(fine)
    assert notes == ()
    new = fine.vertices[len(mesh.vertices) :]
    # A diagonal of each of the 20 squares of the four narrow faces, and the edges across, less the
    # four at the corners of the box; on the wide faces only diagonals that cut off a corner.
    narrow = np.isclose(new[:, 1], 0.05)
    wide = new[~narrow]
    assert narrow.sum() == 20 + 16
    assert len(wide) <= 8
    assert np.isclose(np.abs(wide[:, 1] - 0.05), 0.05).all()
    # No face is crossed by an edge any more.
    again, _ = refined_mesh(
        make_surface(fine, np.flatnonzero(np.isin(parent, np.flatnonzero(held))))
    )
    assert len(again.vertices) == len(fine.vertices)


def test_a_body_without_creases_stays_as_it_is() -> None:
    mesh, held = _ball()
    fine, parent = refined_mesh(make_surface(mesh, np.flatnonzero(held)))
    np.testing.assert_array_equal(fine.triangles, mesh.triangles)
    np.testing.assert_array_equal(parent, np.arange(len(held)))


def _session(cells: int) -> Session:
    """A glued cube of 4 cm, its whole top pushed."""
    mesh = box((0.04, 0.04, 0.04), cells)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = np.array([[0.02, 0.02, 0.04], [0.03, 0.01, 0.04], [0.04, 0.02, 0.03]])
    field = DisplacementField(
        points, np.zeros((3, 3)), None, None, closest_points(mesh, points), ""
    )
    top = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].min(axis=1) > 0.039)
    contact = Contact(np.array([0.02, 0.02, 0.04]), None, "uniform", top)
    probing = Probing("n", contact, np.array([0.3, 0.0, -1.0]), None, None, None, field, None)
    return Session("cube", Path("cube"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


def _moved(session: Session, nu: float) -> np.ndarray:
    (seen,) = session_observations(session, make_object_model(session))
    return seen.response.value(nu)[:, :3] @ seen.force


@pytest.mark.parametrize("nu", [0.1, 0.45])
def test_the_error_at_the_rim_falls(nu: float) -> None:
    """Against half as many cells again along an edge, graded twice."""
    given = _session(4)
    truth = _moved(graded_session(graded_session(_session(6))), nu)
    error = [np.linalg.norm(_moved(body, nu) - truth) for body in (given, graded_session(given))]
    # Corners and edges of the cube, not graded, are a part of what is left.
    assert error[1] < 0.6 * error[0]


def _angle(cells: int) -> Session:
    """An L of 2 by 2 cm with a leg of 1 cm, 1 cm thick, held at the foot, pushed at the other end:
    what gives way is its hollow edge."""
    mesh = _angle_mesh(cells)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 1], 0.0).all(axis=1))
    points = np.array([[0.0, 0.02, 0.005], [0.02, 0.02, 0.0], [0.02, 0.01, 0.01]])
    field = DisplacementField(
        points, np.zeros((3, 3)), None, None, closest_points(mesh, points), ""
    )
    end = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 0].min(axis=1) > 0.0199)
    contact = Contact(np.array([0.02, 0.015, 0.005]), None, "uniform", end)
    push = np.array([0.0, 1.0, 0.2])
    probing = Probing("n", contact, push, None, None, None, field, None)
    return Session("L", Path("L"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


def _angle_mesh(cells: int) -> TriangleMesh:
    origins = [(0.0, 0.0, 0.0), (0.0, 0.01, 0.0), (0.01, 0.01, 0.0)]
    mesh = welded(joined(*(box((0.01, 0.01, 0.01), cells, origin) for origin in origins)))
    same = np.sort(mesh.triangles, axis=1)
    _, where, count = np.unique(same, axis=0, return_inverse=True, return_counts=True)
    # Faces that two of the three cubes share are inside.
    outer = mesh.triangles[count[where.ravel()] == 1]
    used, triangles = np.unique(outer, return_inverse=True)
    return TriangleMesh(mesh.vertices[used], triangles.reshape(-1, 3))


def _punched(
    cells: int, *, profile: str = "flat", centre: tuple[float, float, float] = (0.021, 0.018, 0.04)
) -> Session:
    """The glued cube under a round punch of 4 mm, seen beside it."""
    mesh = box((0.04, 0.04, 0.04), cells)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = np.array([[0.03, 0.02, 0.04], [0.02, 0.01, 0.04], [0.04, 0.02, 0.03]])
    field = DisplacementField(
        points, np.zeros((3, 3)), None, None, closest_points(mesh, points), ""
    )
    contact = Contact(np.array(centre), 0.004, profile)
    push = np.array([0.0, 0.0, -1.0])
    probing = Probing("n", contact, push, None, None, None, field, None)
    return Session("cube", Path("cube"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


def test_long_edges_about_a_flat_punch_are_cut() -> None:
    given = _punched(6)
    fine = refined_session(given)
    point = given.probings[0].contact.point
    # Under a smooth pressure only diagonals that cut off a corner of the cube are.
    smooth = refined_session(_punched(6, profile="hertz")).mesh.vertices
    new = fine.mesh.vertices[~np.isin(fine.mesh.vertices, smooth).all(axis=1)]
    away = np.linalg.norm(new - point, axis=1)
    assert 15 < len(new) < 60
    # Its own length from the punch: 6.7 mm, 9.4 mm across a square.
    assert away.max() < 0.004 + 0.0095
    again = refined_session(refined_session(fine)).mesh
    edge = again.vertices[again.triangles] - np.roll(again.vertices[again.triangles], 1, axis=1)
    under = np.linalg.norm(again.vertices[again.triangles].mean(axis=1) - point, axis=1) < 0.004
    # At most half its radius.
    assert np.linalg.norm(edge[under], axis=2).max() < 0.0021


def test_the_error_about_a_flat_punch_falls() -> None:
    """Against more than twice as many cells along an edge, which need not be cut."""
    given = _punched(6)
    truth = _moved(_punched(13), 0.3)
    error = [np.linalg.norm(_moved(body, 0.3) - truth) for body in (given, refined_session(given))]
    # The rim of the support is a part of what is left.
    assert error[1] < 0.6 * error[0]


def test_a_mesh_follows_a_contact_that_an_edge_crosses() -> None:
    """Beside the edge no half space tells what the vertices miss of the dip."""
    where = {"profile": "hertz", "centre": (0.037, 0.018, 0.04)}
    given = _punched(5, **where)
    truth = _moved(refined_session(_punched(9, **where)), 0.3)
    fine = refined_session(given)
    errors = [
        np.linalg.norm(_moved(body, 0.3) - truth) / np.linalg.norm(truth) for body in (given, fine)
    ]
    # The coarse mesh elsewhere leaves 0.7 %.
    assert errors[1] < 0.01
    assert errors[0] > 0.05
    assert len(fine.mesh.vertices) < len(given.mesh.vertices) + 200
    elsewhere = refined_session(
        given, [replace(given.probings[0].contact, point=np.zeros(3) + 0.02)]
    )
    assert len(elsewhere.mesh.vertices) < len(fine.mesh.vertices) - 100


def test_many_contacts_across_edges_do_not_make_a_mesh_huge() -> None:
    given = _punched(16, profile="hertz")
    contact = given.probings[0].contact
    along = np.linspace(0.004, 0.036, 33)
    points = [[x, y, 0.04] for y in (0.0395, 0.0005) for x in along]
    every = [replace(contact, point=np.array(point), radius=1e-3) for point in points]
    count = len(refined_session(given, every).mesh.vertices)
    assert len(given.mesh.vertices) < count <= 2 * len(given.mesh.vertices)
    few = refined_session(given, every[:4])
    assert len(few.mesh.vertices) < len(given.mesh.vertices) + 4 * 250


def test_hollow_edges_are_graded_and_others_are_not() -> None:
    mesh = _angle_mesh(2)
    held = np.isclose(mesh.vertices[mesh.triangles][:, :, 1], 0.0).all(axis=1)
    fine, _ = _graded(mesh, held)
    _, notes = checked_mesh(fine)
    assert notes == ()
    new = fine.vertices[len(mesh.vertices) :]
    # An element is 5 mm long; of its diagonals the row cuts as much as of its sides.
    hollow = np.abs(new[:, :2] - 0.01).max(axis=1)
    rim = new[:, 1]
    near = np.minimum(hollow, rim)
    assert near.max() == pytest.approx(ROW * 0.005)
    assert (hollow < 0.0016).sum() > 10


def test_the_error_in_a_hollow_edge_falls() -> None:
    """Against half as many cells again along an edge, graded twice."""
    given = _angle(2)
    truth = _moved(graded_session(graded_session(_angle(3))), 0.3)
    error = [np.linalg.norm(_moved(body, 0.3) - truth) for body in (given, graded_session(given))]
    assert error[1] < 0.5 * error[0]


def test_edges_are_cut_along_creases_but_not_at_the_rim() -> None:
    given = _session(4)
    fine = edge_refined_session(given)
    _, notes = checked_mesh(fine.mesh)
    assert notes == ()
    # Every edge of the grid that has an end on one of the eight creases above the support.
    mesh, last = given.mesh, 0.04
    side = np.isclose(mesh.vertices, 0.0) | np.isclose(mesh.vertices, last)
    above = side[:, 0] & side[:, 1]
    above |= np.isclose(mesh.vertices[:, 2], last) & (side[:, 0] | side[:, 1])
    pairs = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    middle = mesh.vertices[edges[above[edges].any(axis=1)]].mean(axis=1)
    new = fine.mesh.vertices[len(mesh.vertices) :]
    assert {tuple(x) for x in new.round(9)} == {tuple(x) for x in middle.round(9)}
    assert len(new) == len(middle) < len(edges)


def test_a_smooth_body_has_no_edges_to_cut() -> None:
    mesh, held = _ball()
    pole = np.array([[0.0, 0.0, RADIUS]])
    given = _session(4)
    field = DisplacementField(pole, np.zeros((1, 3)), None, None, closest_points(mesh, pole), "")
    contact = Contact(pole[0], 0.008, "smooth")
    probing = replace(given.probings[0], contact=contact, displacement=field)
    smooth = replace(
        given, mesh=mesh, held_triangles=np.flatnonzero(held), probings=(probing,), supports=()
    )
    assert len(edge_refined_session(smooth).mesh.vertices) == len(mesh.vertices)


def test_a_session_goes_along() -> None:
    given = _session(4)
    fine = graded_session(given)
    before, after = (body.probings[0].displacement.surface.position for body in (given, fine))
    np.testing.assert_allclose(after, before, atol=1e-12)
    corners = fine.mesh.vertices[fine.mesh.triangles[fine.held_triangles]]
    assert np.isclose(corners[:, :, 2], 0.0).all()
    (support,) = fine.supports
    np.testing.assert_array_equal(support.triangles, fine.held_triangles)
    moved, top = fine.probings[0].contact.triangles, given.probings[0].contact.triangles
    # Far from the rim: whole.
    assert len(moved) == len(top)


def _plate(across: int) -> Session:
    """A plate of 40 x 30 x 5 mm, held at its lower edge, its face pushed at two thirds of its
    height."""
    mesh = box((0.04, 0.005, 0.03), (8, across, 6))
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = np.array([[0.02, 0.0, 0.03], [0.035, 0.005, 0.025], [0.01, 0.005, 0.01]])
    field = DisplacementField(
        points, np.zeros((3, 3)), None, None, closest_points(mesh, points), ""
    )
    contact = Contact(np.array([0.021, 0.0, 0.021]), 0.004, "smooth")
    push = np.array([0.0, 1.0, 0.0])
    probing = Probing("n", contact, push, None, None, None, field, None)
    return Session(
        "plate", Path("plate"), mesh, held, (probing,), None, None, None, (), errors=EXACT
    )


@pytest.mark.slow
def test_a_plate_bends_as_it_should() -> None:
    """Against four elements across its thickness, where one alone makes it a tenth too stiff."""
    nu = 0.3
    truth = _moved(graded_session(_plate(4)), nu)
    given, resolved = (
        np.linalg.norm(_moved(graded_session(plate), nu) - truth) / np.linalg.norm(truth)
        for plate in (_plate(1), refined_session(_plate(1)))
    )
    assert given > 0.1
    # As much as meshes of 5 mm differ among themselves.
    assert resolved < 0.015
