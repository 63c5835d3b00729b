"""Linear elasticity of tetrahedra against closed forms, another assembly and stored fields."""

from types import SimpleNamespace

import numpy as np
import pytest
import skfem
from scipy.sparse import csr_array
from skfem.models.elasticity import linear_elasticity
from solids.bodies import even_traction, half_ball, shell, smooth_patch, traction_load
from surfaces import box, sphere

from palpate.errors import InputError, SingularSystemError
from palpate.solids.finite_elements import (
    free_part,
    half_space_compliance,
    held_nodes,
    hooke_moduli,
    make_body,
    quadratic_basis,
    solve_load,
    stiffness_matrix,
    surface_values,
)
from palpate.solids.sparse_cholesky import factorise
from palpate.solids.tetrahedra import make_solid

SHEAR = 7e4
SIZE = np.array([0.04, 0.03, 0.02])


def filled(mesh, **options):
    return make_solid(mesh, **options)


@pytest.fixture(scope="module")
def block():
    """A block of some hundred elements."""
    return filled(box(SIZE), edge=0.012)


@pytest.fixture(scope="module")
def ball():
    """A ball of bent elements."""
    return filled(sphere(3, 0.03), edge=0.014)


def stiffness(solid, poisson):
    return stiffness_matrix(quadratic_basis(solid), hooke_moduli(SHEAR, poisson))


def test_bodies_of_many_nodes_have_the_matrix_of_few(block):
    # Pairs of 60 000 nodes are more than 32 bits count.
    basis, law, others = quadratic_basis(block), hooke_moduli(SHEAR, 0.3), 60_000
    many = SimpleNamespace(
        basis=basis.basis,
        dx=basis.dx,
        N=basis.N + others,
        element_dofs=(basis.element_dofs + others).astype(basis.element_dofs.dtype),
    )
    full = stiffness_matrix(many, law)[3 * others :, 3 * others :]
    assert abs(full - stiffness_matrix(basis, law)).max() == 0.0


def top(x):
    return np.abs(x[2] - SIZE[2]) < 1e-9


def bottom(x):
    return np.abs(x[2]) < 1e-9


def test_unknowns_are_numbered_as_the_nodes(block, ball):
    for solid in (block, ball):
        basis = quadratic_basis(solid)
        np.testing.assert_array_equal(basis.doflocs.T, solid.nodes)
        np.testing.assert_array_equal(basis.element_dofs.T, solid.elements)


@pytest.mark.parametrize("poisson", [-0.3, 0.0, 0.2, 0.45, 0.499])
def test_uniaxial_tension_is_in_equilibrium(block, poisson):
    # Nodal forces of the exact field: the traction on the loaded face and its reaction, no more.
    young = 2 * SHEAR * (1 + poisson)
    strain = 1e-3 * np.array([-poisson, -poisson, 1.0])
    inner = (stiffness(block, poisson) @ (block.nodes * strain).ravel()).reshape(-1, 3)
    ends = sum(
        traction_load(block, even_traction([0.0, 0.0, sign * 1e-3 * young]), where)
        for where, sign in ((top, 1.0), (bottom, -1.0))
    )
    # Rounding; lambda is 500 times the shear modulus at 0.499.
    np.testing.assert_allclose(inner, ends, atol=1e-10 * young * 0.03**2 * 1e-3 * 500)


@pytest.mark.parametrize("poisson", [-0.3, 0.2, 0.499])
def test_rigid_motions_need_no_force_and_the_matrix_is_symmetric(ball, poisson):
    matrix = stiffness(ball, poisson)
    scale = abs(matrix).max()
    # Rounding of sums over some dozen elements.
    assert abs(matrix - matrix.T).max() < 1e-13 * scale
    for axis in np.eye(3):
        shift = np.broadcast_to(axis, ball.nodes.shape)
        turn = np.cross(axis, ball.nodes) / 0.03
        for motion in (shift, turn):
            assert np.abs(matrix @ motion.ravel()).max() < 1e-12 * scale


@pytest.mark.parametrize("poisson", [0.0, 0.45])
def test_glued_block_obeys_reciprocity_and_at_zero_ratio_its_closed_form(block, poisson):
    # Only at Poisson's ratio 0 does the glue leave the block in uniaxial tension.
    held = block.nodes[:, 2] == 0.0
    body = make_body(block, held, shear_modulus=SHEAR, poisson_ratio=poisson)
    pull, push = (
        traction_load(block, even_traction(vector), top)
        for vector in ([0.0, 0.0, 100.0], [30.0, 0.0, 0.0])
    )
    np.testing.assert_allclose(pull.sum(axis=0), [0.0, 0.0, 100.0 * 0.04 * 0.03], atol=1e-12)
    first, second = solve_load(body, pull), solve_load(body, push)
    assert (first[held] == 0.0).all()
    assert (first * push).sum() == pytest.approx((second * pull).sum(), rel=1e-9, abs=1e-15)
    inner = (stiffness(block, poisson) @ first.ravel()).reshape(-1, 3)
    # Rounding times the condition number, of forces of 0.1 N.
    np.testing.assert_allclose(inner[~held], pull[~held], atol=1e-10)
    if poisson == 0.0:
        exact = 100.0 / (2 * SHEAR) * block.nodes[:, 2]
        np.testing.assert_allclose(first[:, 2], exact, atol=1e-9 * exact.max())
        np.testing.assert_allclose(first[:, :2], 0.0, atol=1e-9 * exact.max())


def lame_error(poisson, subdivisions, layers):
    """Relative error of a hollow ball under inner pressure, its outer sphere held."""
    inner, outer, pressure = 0.01, 0.02, 1e3
    solid, hole = shell(inner, outer, subdivisions, layers)
    held = np.zeros(len(solid.nodes), dtype=bool)
    held[solid.facets[~hole]] = True
    body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=poisson)
    # The pressure's direction is the radius; n = x / r to the accuracy of the bent facets.
    load = traction_load(
        solid,
        lambda x: pressure * x / np.linalg.norm(x, axis=0),
        lambda x: np.linalg.norm(x, axis=0) < 0.5 * (inner + outer),
        order=4,
    )
    displacement = solve_load(body, load)
    # u = A r + B / r^2 with u(outer) = 0 and radial stress -p at the inner radius.
    lame = 2 * SHEAR * poisson / (1 - 2 * poisson)
    bulk = 3 * lame + 2 * SHEAR
    b = pressure / (bulk / outer**3 + 4 * SHEAR / inner**3)
    r = np.linalg.norm(solid.nodes, axis=1)
    exact = (b / r**2 - b * r / outer**3)[:, None] * solid.nodes / r[:, None]
    return np.linalg.norm(displacement - exact) / np.linalg.norm(exact)


@pytest.mark.parametrize(("poisson", "limit"), [(0.2, 0.02), (0.45, 0.04), (0.499, 0.18)])
def test_hollow_ball_under_inner_pressure(poisson, limit):
    assert lame_error(poisson, 2, 3) < limit


def test_error_falls_with_more_than_the_second_power_of_the_size():
    # 13.2 % and 2.4 %; the next halving reaches 0.33 % (order 2.9), too slow for every run.
    coarse, fine = lame_error(0.3, 1, 1), lame_error(0.3, 2, 2)
    assert np.log2(coarse / fine) > 2.2


@pytest.mark.parametrize("poisson", [0.2, 0.45])
def test_stiffness_is_that_of_another_program(block, poisson):
    """scikit-fem's own elasticity and vector elements, numbered its own way."""
    corners = block.elements[:, :4]
    mesh = skfem.MeshTet(block.nodes[: corners.max() + 1].T.copy(), corners.T.copy())
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=2)
    lame = 2 * SHEAR * poisson / (1 - 2 * poisson)
    other = linear_elasticity(lame, SHEAR).assemble(basis)
    field = np.random.default_rng(1).normal(size=(len(block.nodes), 3))
    # The other program numbers its unknowns otherwise: tie them by place and component.
    position = basis.doflocs.T
    node = np.linalg.norm(position[:, None] - block.nodes[None], axis=2).argmin(axis=1)
    component = np.empty(len(node), dtype=int)
    for i in range(3):
        component[np.concatenate([basis.nodal_dofs[i], basis.edge_dofs[i]])] = i
    inner = (stiffness(block, poisson) @ field.ravel()).reshape(-1, 3)
    theirs = other @ field[node, component]
    # Rounding.
    np.testing.assert_allclose(inner[node, component], theirs, atol=1e-12 * np.abs(theirs).max())


@pytest.mark.parametrize(
    ("name", "limit"), [("oblique_h50_nu020", 0.025), ("pole_h50_nu045", 0.025)]
)
def test_half_ball_of_other_programs(shared_data, name, limit):
    # Stored fields are good to 0.1 to 0.2 %; at 7 mm their facets and our elements differ.
    data, solid, support = half_ball(shared_data, name, edge=0.007)
    nu, force = float(data["nu"]), data["direction"] * float(data["force"])
    shear = float(data["E"]) / 2 / (1 + nu)
    held = held_nodes(solid, support)
    body = make_body(solid, held, shear_modulus=shear, poisson_ratio=nu)
    load = smooth_patch(solid, data["load_point"], float(data["patch_radius"]), force)
    displacement = solve_load(body, load)
    at_vertices = surface_values(solid, data["V"].astype(float)) @ displacement
    error = np.linalg.norm(at_vertices - data["uV"]) / np.linalg.norm(data["uV"])
    work = (load * displacement).sum() / float(data["compliance"]) - 1.0
    print(error, work)
    assert error < limit
    # Work is an integral: it is closer than single points.
    assert abs(work) < 0.015


def test_values_at_the_surface_are_quadratic(block):
    rng = np.random.default_rng(2)
    flat = rng.uniform(size=(50, 2)) * SIZE[:2]
    points = np.column_stack([flat, np.full(50, SIZE[2])])

    def field(x):
        return 1.0 + 3.0 * x[:, 0] + 200.0 * x[:, 0] * x[:, 1] - 150.0 * x[:, 1] ** 2 + x[:, 2]

    # Points off the surface take the value of the nearest place.
    values = surface_values(block, points + 1e-4 * np.array([0, 0, 1]))
    np.testing.assert_allclose(values @ field(block.nodes), field(points), rtol=1e-12)
    np.testing.assert_allclose(values.sum(axis=1), 1.0, rtol=1e-12)


def test_the_same_body_gives_the_same_bytes():
    results = []
    for _ in range(2):
        solid = filled(box(SIZE), edge=0.014)
        held = solid.nodes[:, 2] == 0.0
        body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=0.4)
        load = traction_load(solid, even_traction([1.0, 0.0, -1.0]), top)
        results.append(solve_load(body, load))
    assert results[0].tobytes() == results[1].tobytes()


@pytest.mark.parametrize(
    ("shear", "poisson", "text"),
    [(0.0, 0.2, "shear_modulus is 0"), (1.0, 0.5, "poisson_ratio is 0.5"), (1.0, -1.0, "is -1.0")],
)
def test_constants_out_of_range_are_refused(ball, shear, poisson, text):
    held = ball.nodes[:, 2] < 0.0
    with pytest.raises(InputError, match=text):
        make_body(ball, held, shear_modulus=shear, poisson_ratio=poisson)


@pytest.mark.parametrize("value", [False, True])
def test_none_or_all_held_is_refused(ball, value):
    with pytest.raises(InputError, match="not all"):
        make_body(ball, np.full(len(ball.nodes), value), shear_modulus=1.0, poisson_ratio=0.2)


@pytest.mark.parametrize("count", [1, 2])
def test_held_nodes_in_a_line_are_too_few(ball, count):
    held = np.zeros(len(ball.nodes), dtype=bool)
    held[:count] = True
    with pytest.raises(SingularSystemError, match="lie in a line"):
        make_body(ball, held, shear_modulus=1.0, poisson_ratio=0.2)


def test_matrices_that_are_not_positive_are_refused():
    matrix = csr_array(np.diag([1.0, 2.0, 3.0, 4.0, -5.0, 6.0]))
    with pytest.raises(SingularSystemError, match="not positive definite"):
        factorise(matrix, np.eye(3)[:2])


def test_factor_solves_and_its_halves_make_the_inverse(ball):
    held = ball.nodes[:, 2] < -0.02
    matrix = free_part(stiffness(ball, 0.4), held)
    factor = factorise(matrix, ball.nodes[~held])
    right = np.random.default_rng(3).normal(size=(matrix.shape[0], 2))
    solution = factor.solve(right)
    # Rounding times the condition number of about 1e4.
    np.testing.assert_allclose(matrix @ solution, right, atol=1e-10)
    half = factor.half_solve(right)
    np.testing.assert_allclose(half.T @ half, right.T @ solution, rtol=1e-10)


def test_held_nodes_are_those_of_the_faces_on_the_triangles(block):
    mesh = box(SIZE)
    base = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] == 0.0).all(axis=1))
    np.testing.assert_array_equal(held_nodes(block, base), block.nodes[:, 2] == 0.0)


def test_a_support_without_faces_is_refused(ball):
    with pytest.raises(InputError, match="none of the body's"):
        held_nodes(ball, np.array([10_000_000]))


def test_a_block_on_springs_sinks_and_rocks_as_winkler_says(block):
    """Exact where nu is nought: the block under a traction that grows along x stays upright."""
    even, tilt, stiffness = 30.0, 2e3, 5e6
    young = 2 * SHEAR
    held = block.nodes[:, 2] == 0.0
    body = make_body(
        block, held, shear_modulus=SHEAR, poisson_ratio=0.0, support_stiffness=stiffness
    )

    def traction(x):
        return np.stack([0 * x[0], 0 * x[0], -even - tilt * x[0]])

    # A linear traction on shapes of degree 2.
    load = traction_load(block, traction, top, order=3)
    x, _, z = block.nodes.T
    wanted = np.zeros_like(block.nodes)
    wanted[:, 0] = tilt * (z**2 / (2 * young) + z / stiffness)
    wanted[:, 2] = -(even + tilt * x) * (z / young + 1 / stiffness)
    # Rounding: the field is of second degree, as the elements are.
    np.testing.assert_allclose(solve_load(body, load), wanted, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("cut", [False, True])
def test_a_half_space_gives_under_a_load_as_in_closed_form(cut):
    """Under pressure 1 - s^2 by Hankel's transform: the integral of (8 J_2(k) / k^2)^2 over k is
    2.0695. A patch of which an edge cuts a third: a plain sum over many points."""
    size, radius = (0.06, 0.06, 0.03), 9e-3
    point = np.array([0.003 if cut else 0.03, 0.03, 0.03])
    solid = filled(box(size, cells=6), edge=6e-3)
    compliance = half_space_compliance(
        solid, point, radius, lambda s: np.clip(1.0 - s**2, 0.0, None)
    )
    expected = 2.0695 / (2.0 * np.pi * radius)
    if cut:
        x, y = np.meshgrid((np.arange(-10, 30) + 0.5) / 30, (np.arange(-30, 30) + 0.5) / 30)
        points = np.stack([x.ravel(), y.ravel()], axis=1)
        weight = np.clip(1.0 - (points**2).sum(axis=1), 0.0, None)
        points, weight = points[weight > 0.0], weight[weight > 0.0] / weight.sum()
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        np.fill_diagonal(apart, 1.0)
        # Mean of 1 / r between two squares of side 1 / 30, to second order, and within one.
        inverse = 1.0 / apart + 1.0 / (12.0 * 30**2 * apart**3)
        np.fill_diagonal(inverse, 30 * 2.9732)
        expected = float(weight @ inverse @ weight) / (2.0 * np.pi * radius)
    assert compliance == pytest.approx(expected, rel=0.01)
