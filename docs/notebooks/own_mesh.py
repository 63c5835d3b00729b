# %% [markdown]
# # Your own mesh
# A block of foam, 60 x 60 x 40 mm, as a mesh of your own; the push and what was seen of it are
# computed here, at 50 kPa and 0.3, in place of your measurement. The files of such a folder alone,
# with a point that was not found: `examples/03_write_a_session.py`.

# %%
import os
import tempfile
from pathlib import Path

import numpy as np
import trimesh

import palpate
from palpate.bem import boundary_system, make_elastic_map, make_surface
from palpate.pipeline import surface_load
from palpate.probe import find_contact_patch

EDGE = float(os.environ.get("PALPATE_EDGE", "10"))  # mm; smaller is better, and slower
folder = Path(tempfile.mkdtemp())
block = trimesh.creation.box(bounds=[[0, 0, 0], [60, 60, 40]])
block.subdivide_to_size(EDGE).export(folder / "mesh.ply")

# %% [markdown]
# What is known before the measurement: shape, support, contact, force.

# %%
(folder / "session.toml").write_text("""
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "mm"
[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 0.01 }
[[probe]]
name = "top"
contact = { point = [24.0, 30.0, 40.0], radius = 8.0, profile = "smooth" }
force = [0, 0, -1.2]
displacement = "top.csv"
""")

# %% [markdown]
# Now the measurement. In a laboratory these rows come from cameras or an arm.

# %%
before = palpate.read_session(folder, observations=False)
push = before.probings[0]
system = boundary_system(make_surface(before.mesh, before.held_triangles))
body = make_elastic_map(system, shear_modulus=50e3 / 2.6, poisson_ratio=0.3)
patch = find_contact_patch(before.mesh, push.contact, before.held_triangles, name="top")
(state,) = body.respond([surface_load(patch)], push.force[None])
moved = state.displacement[: len(before.mesh.vertices)]
seen = before.mesh.vertices[:, 2] > 1e-3
noise = np.random.default_rng(1).normal(scale=2e-5, size=moved[seen].shape)
rows = 1e3 * np.hstack([before.mesh.vertices[seen], moved[seen] + noise])
np.savetxt(folder / "top.csv", rows, delimiter=",", header="x,y,z,ux,uy,uz", comments="")

# %%
result = palpate.fit(folder)
result

# %%
low, high = result.young_modulus.ci95
assert low < 50e3 < high
