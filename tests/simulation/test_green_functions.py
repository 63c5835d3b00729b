"""Green's functions against the elastic map, and their files."""

from pathlib import Path

import numpy as np
import pytest
from cube_green import NU, SHEAR, TOP
from estimate_samples import sample_result
from fault_injection import largest_file
from surfaces import box

from palpate.errors import InputError, RecordError
from palpate.pipeline import poke_session
from palpate.records import Contact, read_session
from palpate.simulation import (
    GreenFunctions,
    Material,
    estimated_material,
    exact_material,
    make_green_functions,
)
from palpate.simulation.green_functions import read_green_functions, write_green_functions


def test_a_force_on_a_vertex_moves_the_surface_as_a_poke_there(session, green):
    force = np.array([0.3, -0.2, -1.0])
    poked = poke_session(
        session, force, Contact(np.array(TOP), None, "vertex"), shear_modulus=SHEAR,
        poisson_ratio=NU,
    )  # fmt: skip
    at = np.linalg.norm(session.mesh.vertices - TOP, axis=1).argmin()
    moved = np.tensordot(force, green.surface[np.searchsorted(green.nodes, at)], 1)
    # Made symmetric: off by what the discretisation is not.
    np.testing.assert_allclose(moved[at], poked.displacement, rtol=2 * green.asymmetry)
    assert green.asymmetry < 0.05
    held = session.mesh.triangles[session.held_triangles]
    assert not moved[held].any()


def test_files_give_back_what_was_written(tmp_path, green):
    path = tmp_path / "g.npz"
    write_green_functions(path, green)
    again = read_green_functions(path)
    for name in ("nodes", "compliance", "surface", "slope", "held_triangles"):
        np.testing.assert_array_equal(getattr(again, name), getattr(green, name))
    assert again.material.shear_modulus == SHEAR
    assert again.asymmetry == green.asymmetry


def test_a_write_that_fails_halfway_leaves_the_old_file(tmp_path, green):
    path = tmp_path / "g.npz"
    write_green_functions(path, green)
    before = path.read_bytes()
    with (
        largest_file(len(before) // 2),
        pytest.raises(RecordError, match=r"g\.npz: cannot be written \("),
    ):
        write_green_functions(path, green)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["g.npz"]


def spoilt(path, green, **changes):
    write_green_functions(path, green)
    with np.load(path) as file:
        content = {name: file[name] for name in file.files} | changes
    np.savez(path, **{name: value for name, value in content.items() if value is not None})


def test_spoilt_files_are_refused(tmp_path, green):
    path = tmp_path / "g.npz"
    for changes, words in (
        ({"format": np.array("palpate-greens/9")}, "'palpate-greens/9'; this version reads"),
        ({"slope": None}, "'slope' is missing"),
        ({"compliance": 2 * green.compliance}, "not as they were written"),
    ):
        spoilt(path, green, **changes)
        with pytest.raises(RecordError, match=words):
            read_green_functions(path)
    write_green_functions(path, green)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(RecordError, match="only a part of one"):
        read_green_functions(path)
    with pytest.raises(RecordError, match="No such file"):
        read_green_functions(tmp_path / "none.npz")


def test_a_file_with_any_other_byte_is_refused_or_reads_the_same(tmp_path):
    """A small one: two nodes of a cube."""
    mesh = box(size=(0.04, 0.04, 0.04), cells=2)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] == 0.0).all(axis=1))
    nodes = np.flatnonzero(mesh.vertices[:, 2] == 0.04)[:2]
    square = 1e-3 * np.eye(6).reshape(2, 3, 2, 3)
    surface = np.ones((2, 3, len(mesh.vertices), 3))
    small = GreenFunctions(
        "small",
        mesh,
        held,
        nodes,
        square,
        surface,
        square,
        0.1 * square[None],
        exact_material(SHEAR, NU),
        0.01,
    )
    path = tmp_path / "small.npz"
    write_green_functions(path, small)
    whole = path.read_bytes()
    rng = np.random.default_rng(4)
    refused = 0
    for index in rng.integers(0, len(whole), 300):
        broken = bytearray(whole)
        broken[index] ^= 1 << rng.integers(8)
        path.write_bytes(broken)
        try:
            again = read_green_functions(path)
        except RecordError:
            refused += 1
        else:
            np.testing.assert_array_equal(again.surface, small.surface)
    # Few bytes of an archive mean nothing: times, attributes, spare room.
    assert refused > 200


@pytest.mark.slow
def test_vertices_at_narrow_triangles_are_left_out_and_refused_if_chosen(tmp_path):
    """The beam has triangles of 2 degrees near the tip, where its weights hang."""
    beam = read_session(Path(__file__).parents[2] / "examples" / "beam")
    material = exact_material(1e5, 0.3)
    green = make_green_functions(beam, material, most=100)
    assert 0 < len(green.left_out) < 10
    assert len(green.nodes) + len(green.left_out) == 100
    assert green.left_out_text.startswith(f"{len(green.left_out)} of 100 vertices")
    corners = beam.mesh.vertices[beam.mesh.triangles]
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    narrow = beam.mesh.triangles[edges.min(axis=1) < 0.1 * edges.max(axis=1)]
    assert np.isin(green.left_out, narrow).all()
    write_green_functions(tmp_path / "g.npz", green)
    again = read_green_functions(tmp_path / "g.npz")
    np.testing.assert_array_equal(again.left_out, green.left_out)
    chosen = np.union1d(green.nodes, green.left_out)
    with pytest.raises(InputError, match="not positive definite"):
        make_green_functions(beam, material, nodes=chosen)


def test_held_and_unknown_vertices_are_refused(session):
    held = int(session.mesh.triangles[session.held_triangles[0], 0])
    material = exact_material(SHEAR, NU)
    with pytest.raises(InputError, match="belong to the support"):
        make_green_functions(session, material, nodes=np.array([held]))
    with pytest.raises(InputError, match="distinct vertices"):
        make_green_functions(session, material, nodes=np.array([10**6]))


def test_the_covariance_is_the_one_that_gives_all_three_deviations(session):
    estimate = sample_result(session).estimate
    material = estimated_material(estimate)
    slope = np.array([2 * (1 + material.poisson_ratio), 2 * material.shear_modulus])
    # Rounding.
    assert np.sqrt(slope @ material.covariance @ slope) == pytest.approx(estimate.young_modulus.std)


def test_impossible_materials_are_refused():
    with pytest.raises(InputError, match=r"poisson_ratio is 0\.6"):
        exact_material(1e4, 0.6)
    with pytest.raises(InputError, match="covariance must be"):
        Material(1e4, 0.3, np.array([[1.0, 5.0], [5.0, 1.0]]))
