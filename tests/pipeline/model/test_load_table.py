"""The table of loads against each of its columns made by itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import sphere
from tool_tractions import traction_of

from palpate.bem import (
    BoundarySystem,
    boundary_system,
    correction_columns,
    indentation_corrections,
    load_right_hand,
    make_surface,
    pressure_column,
    support_columns,
)
from palpate.geometry import TriangleMesh, unit_normals
from palpate.pipeline.model import load_table
from palpate.pipeline.model.contact_loads import DIP_ERROR, surface_load
from palpate.pipeline.model.load_table import LoadTable, make_load_table
from palpate.records import Contact, Load, Probing, Session
from palpate.records.error_priors import ErrorPriors

RADIUS = 0.03
GRAVITY, DENSITY = np.array([0.0, 0.0, -9.81]), 1100.0
FORCES = {"top": np.array([0.05, 0.0, -0.2]), "side": np.array([-0.3, 0.02, 0.0])}


@pytest.fixture(scope="module")
def session() -> Session:
    """A ball on its cut-off foot, pressed at two places over circles that its mesh does not
    resolve; on top with an outward part of the traction, and squeezed over its flank meanwhile."""
    mesh = TriangleMesh(RADIUS * sphere(2).vertices, sphere(2).triangles)
    corner = mesh.vertices[mesh.triangles]
    held = np.flatnonzero(corner[:, :, 2].max(axis=1) < -0.3 * RADIUS)
    flank = np.flatnonzero((corner[:, :, 0] < -0.8 * RADIUS).all(axis=1))
    top = Contact(np.array([0.0, 0.0, RADIUS]), 5e-3, "hertz", traction=traction_of("hertz", 0.2))
    side = Contact(np.array([RADIUS, 0.0, 0.0]), 4e-3, "hertz")
    squeezed = Load(Contact(np.zeros(3), None, "uniform", flank), pressure=40.0)
    probings = (
        Probing("top", top, FORCES["top"], None, None, None, None, None, loads=(squeezed,)),
        Probing("side", side, FORCES["side"], None, None, None, None, None),
    )
    return Session(
        "ball", Path("ball"), mesh, held, probings, DENSITY, GRAVITY, None, (),
        errors=ErrorPriors(),
    )  # fmt: skip


@pytest.fixture(scope="module")
def system(session: Session) -> BoundarySystem:
    return boundary_system(make_surface(session.mesh, session.held_triangles))


def _table(session: Session, system: BoundarySystem, perturbed: bool = True) -> LoadTable:
    shapes = np.zeros((len(session.mesh.vertices), 3, 2))
    shapes[..., 0] = [1.0, 0.0, 0.0]
    shapes[..., 1] = [0.0, 0.0, 1.0]
    return make_load_table(session, system.surface, shapes, perturbed=perturbed)


def _without_outward(session: Session) -> Session:
    level = traction_of("hertz", 0.0)
    probings = (
        replace(
            probing, contact=replace(probing.contact, traction=probing.contact.traction and level)
        )
        for probing in session.probings
    )
    return replace(session, probings=tuple(probings))


def _close(actual: np.ndarray, wanted: np.ndarray) -> None:
    np.testing.assert_allclose(actual, wanted, atol=1e-12 * np.abs(wanted).max())
    assert wanted.any()


def test_columns_of_a_contact_are_those_of_its_load_and_its_dip(
    session: Session, system: BoundarySystem
) -> None:
    session = _without_outward(session)
    table = _table(session, system)
    terms = table.integrate(system)[0].terms
    loads = [surface_load(patch) for patch in table.patches.values()]
    dips = indentation_corrections(system.surface, loads)
    assert None not in dips
    for probing, load, dip in zip(session.probings, loads, dips, strict=True):
        columns = table.force_columns(probing.contact)
        _close(terms[:, :, columns], load_right_hand(system, [load], [dip]).terms)


def test_columns_of_what_is_no_contact(session: Session, system: BoundarySystem) -> None:
    table = _table(session, system)
    right, body = table.integrate(system)
    (load,) = session.probings[0].loads
    (patch,) = table.pressed.values()
    column = table.pressure_columns(load.contact)
    _close(right.terms[:, :, column], pressure_column(system, patch.triangles).terms)
    assert body is not None
    _close(right.terms[:, :, table.weight_columns], body.right.terms)
    motions = support_columns(system, table.shapes).terms
    _close(right.terms[:, :, table.motion_columns], motions)
    # Every column has one owner.
    owned = [
        *(table.force_columns(probing.contact) for probing in session.probings),
        column,
        table.weight_columns,
        table.motion_columns,
        table.perturbation_columns,
    ]
    assert np.concatenate(owned).tolist() == list(range(right.terms.shape[2]))


def test_a_perturbed_contact_takes_the_place_of_the_stated_one(
    session: Session, system: BoundarySystem
) -> None:
    table = _table(session, system)
    terms = table.integrate(system)[0].terms
    stated = _table(_without_outward(session), system, perturbed=False)
    unit = stated.integrate(system)[0].terms
    count = 0
    for column, perturbation in zip(table.perturbation_columns, table.perturbations, strict=True):
        if perturbation.patch is None:
            continue
        count += 1
        load = replace(surface_load(perturbation.patch), cells=load_table._FEWER)
        force = session.probings[perturbation.probing].force
        dips = indentation_corrections(system.surface, [load])
        moved = load_right_hand(system, [load], dips).terms
        k = int(table.patch_of[perturbation.probing])
        wanted = (moved - unit[:, :, 3 * k : 3 * k + 3]) @ force
        np.testing.assert_allclose(terms[:, :, column], wanted, atol=1e-12 * np.abs(unit).max())
    # Five places for each, and a radius: as much as it is known.
    assert count == 12


def test_the_outward_part_and_its_error(session: Session, system: BoundarySystem) -> None:
    table = _table(session, system)
    terms = table.integrate(system)[0].terms
    without = _table(_without_outward(session), system, perturbed=False).integrate(system)[0].terms
    unit = terms[:, :, :3] - without[:, :, :3]
    # In proportion to the normal component of the force.
    (patch, _) = table.patches.values()
    normal = unit_normals(session.mesh)[patch.triangle]
    assert np.abs(unit @ normal).max() > 0.01 * np.abs(without[:, :, 2]).max()
    _close(unit, (unit @ normal)[:, :, None] * normal)
    errors = dict(zip(table.perturbation_columns.tolist(), table.perturbations, strict=True))
    ((column, error),) = (
        (k, perturbation) for k, perturbation in errors.items() if perturbation.outward
    )
    assert [parameter.name for parameter in error.steps] == ["outward traction in top"]
    _close(terms[:, :, column], error.outward * unit @ FORCES["top"])


def test_a_perturbed_dip_is_its_share_of_what_the_dip_adds(
    session: Session, system: BoundarySystem
) -> None:
    table = _table(session, system)
    terms = table.integrate(system)[0].terms
    loads = [surface_load(patch) for patch in table.patches.values()]
    dips = indentation_corrections(system.surface, loads)
    errors = dict(zip(table.perturbation_columns.tolist(), table.perturbations, strict=True))
    perturbed = [(k, perturbation) for k, perturbation in errors.items() if perturbation.dip]
    assert len(perturbed) == 2
    for column, perturbation in perturbed:
        dip = dips[table.patch_of[perturbation.probing]]
        force = session.probings[perturbation.probing].force
        wanted = DIP_ERROR * correction_columns(system, [dip]).terms @ force
        _close(terms[:, :, column], wanted)


def test_loads_are_the_same_however_many_are_integrated_at_a_time(
    session: Session, system: BoundarySystem, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = _table(session, system)
    terms = table.integrate(system)[0].terms
    monkeypatch.setattr(load_table, "_TOGETHER", 3)
    _close(table.integrate(system)[0].terms, terms)
