"""The push of an export to OpenUSD, repeated in Newton."""

from importlib import import_module
from pathlib import Path

import numpy as np

from benchmarks.held_out_push import deviation, read_push

# A step of vertex block descent begins where inertia alone would lead, which throws the light nodes
# under a contact. Ten iterations bring them back from a step of 0.1 ms; with 0.2 ms the half ball
# rests 16 % off (with forty 2 %), with 0.5 ms three and a half times as far away as it should.
_STEP, _ITERATIONS, _STEPS = 1e-4, 10, 400
# Of the velocities that a step leaves, so that the object comes to rest; and of the force: Newton's
# material (stable neo-Hookean) gives way under large compression.
_KEPT, _SHARE = 0.95, 0.02


def replay(folder: Path) -> tuple[float | None, str]:
    """Displacement of the push's point in Newton, off from Palpate's.

    Parameters
    ----------
    folder : Path                   of `palpate export --to openusd`

    Returns
    -------
    float or None [%]               None where Newton is not installed
    str                             what was done, or what is missing
    """
    try:
        newton, wp = import_module("newton"), import_module("warp")
        usd = import_module("pxr.Usd")
    except ModuleNotFoundError:
        return None, "Newton is not installed (pip install newton warp-lang usd-core)"
    import_module("newton.usd")
    stage = usd.Stage.Open(str(folder / "model.usda"))
    mesh = newton.usd.get_tetmesh(stage.GetPrimAtPath("/Object/Body"), compat_namespaces=())
    model = _held_model(newton, wp, mesh)
    push = read_push(folder)
    off = deviation(push, _pushed(newton, wp, model, push))
    return off, f"stable neo-Hookean linear tetrahedra, {100 * _SHARE:g} % of the force"


def _held_model(newton, wp, mesh):
    """The tetrahedra in Newton, without gravity, held where the prim variable says."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_custom_attribute(
        newton.ModelBuilder.CustomAttribute(
            name="held", dtype=wp.int32, frequency=newton.Model.AttributeFrequency.PARTICLE
        )
    )
    builder.add_soft_mesh(
        pos=(0.0, 0.0, 0.0), rot=wp.quat_identity(), scale=1.0, vel=(0.0, 0.0, 0.0), mesh=mesh,
        particle_radius=1e-4, add_surface_mesh_edges=False,
    )  # fmt: skip
    builder.color()
    model = builder.finalize()
    flags = model.particle_flags.numpy()
    flags[model.held.numpy() > 0] &= ~int(newton.ParticleFlags.ACTIVE)
    model.particle_flags = wp.array(flags, dtype=wp.int32)
    return model


def _pushed(newton, wp, model, push: dict) -> np.ndarray:
    """Displacement of the point's nodes at rest under a share of the force [m], over the share."""
    solver = newton.solvers.SolverVBD(model, iterations=_ITERATIONS)
    before, after, control = model.state(), model.state(), model.control()
    rest = before.particle_q.numpy().astype(np.float64)
    force = np.zeros(rest.shape, dtype=np.float32)
    force[push["loaded_nodes"]] = _SHARE * np.array(push["nodal_forces"])
    pushing = wp.array(force, dtype=wp.vec3)
    for _ in range(_STEPS):
        wp.copy(before.particle_f, pushing)
        before.particle_qd.assign(_KEPT * before.particle_qd.numpy())
        solver.step(before, after, control, None, _STEP)
        before, after = after, before
    moved = before.particle_q.numpy().astype(np.float64) - rest
    return moved[push["point_nodes"]] / _SHARE
