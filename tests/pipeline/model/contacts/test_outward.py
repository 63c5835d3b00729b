"""The outward part of a sphere's pressure, against the traction itself on a fine patch."""

from dataclasses import replace

import numpy as np
import pytest
from surfaces import box

from palpate.bem import (
    BoundarySystem,
    boundary_system,
    indentation_corrections,
    load_right_hand,
    make_surface,
    traction_column,
)
from palpate.pipeline.model.contacts.outward import (
    has_outward_traction,
    outward_load,
    outward_pushes,
)
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import Contact
from palpate.solids import make_solid

BALL, RADIUS, SIDE = 0.3, 12e-3, 0.04
# Under a sphere that slides.
OUTWARD = 0.4 * RADIUS / BALL
PLACE, UP = np.array([0.02, 0.02, SIDE]), np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def system() -> BoundarySystem:
    """A cube whose triangles are less than a third of the touched radius."""
    mesh = box((SIDE, SIDE, SIDE), 12)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    return boundary_system(make_surface(mesh, held))


def _patch(system: BoundarySystem, profile: str = "hertz") -> ContactPatch:
    contact = Contact(PLACE, RADIUS, profile, outward=OUTWARD)
    held = np.flatnonzero(system.surface.held)
    return find_contact_patch(system.surface.mesh, contact, held, name="n")


def test_it_is_the_traction_itself(system: BoundarySystem) -> None:
    patch = _patch(system)
    nodes = system.surface.element_nodes[patch.triangles]
    offset = nodes - PLACE
    share = np.linalg.norm(offset, axis=2, keepdims=True) / RADIUS
    # Hertz's pressure of one newton, times the lean.
    pressure = 1.5 / (np.pi * RADIUS**2) * np.sqrt(np.clip(1.0 - share**2, 0.0, None))
    direct = traction_column(system, patch.triangles, pressure * offset / BALL)
    # Pushed down, along minus z.
    loads, forces = zip(*outward_pushes(patch, UP, -UP), strict=True)
    dips = indentation_corrections(system.surface, loads)
    found = sum(
        load_right_hand(system, [load], [dip]).terms @ force
        for load, dip, force in zip(loads, dips, forces, strict=True)
    )
    # Six-node triangles at the rim miss some of its square root, and
    # know nothing of the dip between the vertices: 7 %.
    down = found[:, :-3]
    miss = np.linalg.norm(down - direct.terms[:, :-3, 0]) / np.linalg.norm(down)
    assert miss < 0.1
    # It has no resultant.
    assert np.abs(found[:, -3:]).max() < 1e-12 * np.abs(found).max()


def test_what_has_an_outward_part(system: BoundarySystem) -> None:
    contact = _patch(system).contact
    assert has_outward_traction(contact)
    assert not has_outward_traction(replace(contact, outward=0.0))


@pytest.mark.parametrize("profile", ["hertz", "cone", "flat"])
def test_in_finite_elements_it_stretches_as_much(profile: str) -> None:
    """Its virial, sum of force times place, is `Contact.outward` times radius and force."""
    solid = make_solid(box((SIDE, SIDE, SIDE), 4), edge=9e-3, fine=[(PLACE, RADIUS, 4e-3)])
    contact = Contact(PLACE, RADIUS, profile, outward=OUTWARD)
    load = outward_load(solid, contact, np.array([0.0, 0.0, -2.0]))
    assert np.abs(load.sum(axis=0)).max() < 1e-12
    assert not load[:, 2].any()
    virial = float((load * (solid.nodes - PLACE)).sum())
    # Faces of a third of the radius, sampled at 196 points.
    assert virial == pytest.approx(2.0 * OUTWARD * RADIUS, rel=0.01)
