"""The outward part of a sphere's pressure, against the traction itself on a fine patch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from surfaces import box

from palpate.bem import BoundarySystem, assemble_system, make_surface, traction_column
from palpate.lab import make_solid
from palpate.pipeline.model.contacts import has_outward_traction, outward_columns, outward_load
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import CONE, FLAT, SLIDES, SPHERE, STICKS, Contact, Tool

BALL, RADIUS, SIDE = 0.3, 12e-3, 0.04
PLACE = np.array([0.02, 0.02, SIDE])


@pytest.fixture(scope="module")
def system() -> BoundarySystem:
    """A cube whose triangles are less than a third of the touched radius."""
    mesh = box((SIDE, SIDE, SIDE), 12)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    return assemble_system(make_surface(mesh, held))


def _patch(system: BoundarySystem, tool: Tool) -> ContactPatch:
    contact = Contact(PLACE, RADIUS, "hertz", tool=tool)
    held = np.flatnonzero(system.surface.held)
    return find_contact_patch(system.surface.mesh, contact, held, name="n")


def test_it_is_the_traction_itself(system: BoundarySystem) -> None:
    patch = _patch(system, Tool(SPHERE, BALL))
    nodes = system.surface.element_nodes[patch.triangles]
    offset = nodes - PLACE
    share = np.linalg.norm(offset, axis=2, keepdims=True) / RADIUS
    # Hertz's pressure of one newton, times the lean.
    pressure = 1.5 / (np.pi * RADIUS**2) * np.sqrt(np.clip(1.0 - share**2, 0.0, None))
    direct = traction_column(system, patch.triangles, pressure * offset / BALL)
    found = outward_columns(system, patch)
    # Pushed down, along minus z. Six-node triangles at the rim miss some of its square root, and
    # know nothing of the dip between the vertices: 7 %.
    down = -found.terms[:, :-3, 2]
    miss = np.linalg.norm(down - direct.terms[:, :-3, 0]) / np.linalg.norm(down)
    assert miss < 0.1
    # Forces along the surface have no part in it, and it has no resultant.
    assert not found.terms[:, :, :2].any()
    assert np.abs(found.terms[:, -3:]).max() < 1e-12 * np.abs(found.terms).max()


def test_what_has_an_outward_part(system: BoundarySystem) -> None:
    assert has_outward_traction(_patch(system, Tool(SPHERE, BALL)).contact)
    assert not has_outward_traction(_patch(system, Tool(SPHERE, BALL, STICKS)).contact)
    assert not has_outward_traction(_patch(system, Tool(FLAT, RADIUS)).contact)
    patch = _patch(system, Tool(SPHERE, BALL))
    assert not has_outward_traction(replace(patch.contact, tool=None))


def _lever(ratio: float) -> float:
    """Mean of r tan(lean) under a sphere of radius 1 on a circle of radius `ratio`, from Sneddon's
    pressure."""

    def total(value: Callable[[float], float]) -> float:
        def ring(t: float) -> float:
            inner = quad(lambda a: value(t * np.sin(a)) * t * np.sin(a), 0.0, 0.5 * np.pi)[0]
            return float((np.arctanh(t) + t / (1.0 - t**2)) * inner)

        return float(quad(ring, 0.0, ratio)[0])

    return total(lambda r: r**2 / np.sqrt(1.0 - r**2)) / total(lambda r: 1.0)


@pytest.mark.parametrize(
    ("tool", "profile", "expected"),
    [
        (Tool(SPHERE, BALL), "hertz", 0.4 * RADIUS**2 / BALL),
        (Tool(SPHERE, RADIUS / 0.6), "hertz", _lever(0.6) * RADIUS / 0.6),
        (Tool(CONE, BALL, SLIDES, np.arctan(2.0)), "cone", np.pi / 6.0 * RADIUS / 2.0),
    ],
)
def test_in_finite_elements_it_stretches_as_much(tool: Tool, profile: str, expected: float) -> None:
    """Its virial, sum of force times place, over the force: the mean of r times the lean, which is
    2 a^2 / (5 R) under a large sphere and pi a cot(angle) / 6 under a cone."""
    solid = make_solid(box((SIDE, SIDE, SIDE), 4), edge=9e-3, fine=[(PLACE, RADIUS, 4e-3)])
    contact = Contact(PLACE, RADIUS, profile, tool=tool)
    load = outward_load(solid, contact, np.array([0.0, 0.0, -2.0]))
    assert np.abs(load.sum(axis=0)).max() < 1e-12
    assert not load[:, 2].any()
    virial = float((load * (solid.nodes - PLACE)).sum())
    # Faces of a third of the radius, sampled at 196 points.
    assert virial == pytest.approx(2.0 * expected, rel=0.01)
