"""An export for Abaqus, run by SfePy: elements, material and loads as the files have them, and
SfePy's terms for a fading memory."""

import json

import numpy as np
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from sfepy.discrete import Equation, Equations, FieldVariable, Integral, Material, Problem
from sfepy.discrete.fem import FEDomain, Field, Mesh
from sfepy.mechanics.matcoefs import stiffness_from_youngpoisson
from sfepy.solvers.ts import TimeStepper
from sfepy.terms import Term


def moved_by_sfepy(folder, *, rise, step, count):
    """Displacement of the push's point, (count + 1, 3) [m], at the ends of the steps, under the
    push's forces that rise and are held; and that of the body that does not creep, (3,) [m]."""
    text = (folder / "model.inp").read_text()
    nodes = _rows(text, "*NODE, NSET=ALL")[:, 1:]
    elements = _rows(text, "*ELEMENT, TYPE=C3D10, ELSET=BODY1")[:, 1:].astype(int) - 1
    held = _rows(text, "*NSET, NSET=HELD").astype(int).ravel() - 1
    node, component, size = _rows(text, "*CLOAD").T
    series = (folder / "viscoelastic.inp").read_text()
    young, ratio = _rows(series, "*ELASTIC, MODULI=INSTANTANEOUS").ravel()
    shares, bulk_shares, times = _rows(series, "*VISCOELASTIC, TIME=PRONY").T
    # One stiffness relaxes as a whole.
    np.testing.assert_array_equal(shares, bulk_shares)

    space, position = _space(nodes, elements)
    free = np.ones((len(position), 3), dtype=bool)
    at = cKDTree(position).query(nodes)[1]
    free[at[held]] = False
    force = np.zeros((len(position), 3))
    np.add.at(force, (at[node.astype(int) - 1], component.astype(int) - 1), size)
    push = json.loads((folder / "replay.json").read_text())
    point, weight = at[push["point_nodes"]], np.array(push["point_shares"])

    def run(shares, count, rise):
        problem = _Creep(space, young, ratio, shares, times, step, count)
        nodal = problem.solve(force, free, [min(k * step / rise, 1.0) for k in range(count + 1)])
        return np.array([weight @ nodal_motion[point] for nodal_motion in nodal])

    return run(shares, count, rise), run(np.zeros_like(shares), 1, step)[-1]


def _rows(text, keyword):
    rows = text.split(keyword + "\n")[1].split("\n*")[0].splitlines()
    return np.array([row.rstrip(",").split(",") for row in rows], dtype=float)


def _space(nodes, elements):
    """Quadratic displacements on tetrahedra with straight edges, and the places of their nodes."""
    corners, cells = np.unique(elements[:, :4], return_inverse=True)
    cells = cells.reshape(-1, 4).astype(np.int32)
    group = np.zeros(len(cells), dtype=np.int32)
    mesh = Mesh.from_data("body", nodes[corners], None, [cells], [group], ["3_4"])
    region = FEDomain("body", mesh).create_region("Omega", "all")
    field = Field.from_args("displacement", np.float64, 3, region, approx_order=2)
    return field, field.get_coor()


class _Creep:
    """Elements in parallel: a spring, and one Maxwell element for each term."""

    def __init__(self, field, young, ratio, shares, times, step, count):
        u = FieldVariable("u", "unknown", field, history=1)
        v = FieldVariable("v", "test", field, primary_var_name="u")
        stiffness, rule = stiffness_from_youngpoisson(3, young, ratio), Integral("i", order=2)
        self.steps = TimeStepper(0.0, count * step, dt=step)
        spring = Material("spring", D=(1.0 - shares.sum()) * stiffness)
        terms = Term.new(
            "dw_lin_elastic(spring.D, v, u)", rule, field.region, spring=spring, v=v, u=u
        )
        for k, (share, time) in enumerate(zip(shares, times, strict=True)):
            # Exact where strain is linear in time over a step; SfePy multiplies by the step.
            decay = np.exp(-step / time)
            size = share * (1.0 - decay) * time / step
            material = Material(f"term{k}", D=size * stiffness, decay=np.array([[decay]]))
            terms = terms + Term.new(
                f"dw_lin_elastic_eth(ts, term{k}.D, term{k}.decay, v, du/dt)", rule, field.region,
                ts=self.steps, v=v, u=u, **{f"term{k}": material},
            )  # fmt: skip
        self.equations = Equations([Equation("balance", terms)])
        self.problem = Problem("creep", equations=self.equations)

    def solve(self, force, free, loads):
        """Nodal displacements at the ends of the steps."""
        problem, equations, free = self.problem, self.equations, free.ravel()
        problem.time_update(self.steps)
        state, now, moved = problem.get_initial_state(), np.zeros(force.size), []
        for (step, _), load in zip(self.steps, loads, strict=True):
            equations.time_update_materials(self.steps, mode="force", problem=problem)
            # The tangent of the first step differs, as there is no rate before it.
            for _ in range(2):
                state.set_state(now, preserve_caches=True)
                residual = load * force.ravel() - equations.eval_residuals(now)
                if step < 2:
                    tangent = equations.eval_tangent_matrices(now, problem.mtx_a)
                    solved = splu(tangent.tocsr()[free][:, free].tocsc())
                now = now.copy()
                now[free] += solved.solve(residual[free])
            state.set_state(now, preserve_caches=True)
            equations.eval_residuals(now)
            equations.advance(self.steps)
            moved.append(now.reshape(-1, 3))
        return moved
