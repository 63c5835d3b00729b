# %% [markdown]
# # Displacements of an image correlation program
# A table as VIC-3D exports it, in millimetres and in its own frame; `palpate import` does the same
# at the command line, and writes it into the session.

# %%
import tempfile
from pathlib import Path

import numpy as np

from palpate.records import in_object_frame, on_surface, read_measured, read_session

HERE = Path.cwd()
EXAMPLES = next(p for p in (HERE, *HERE.parents) if (p / "examples").is_dir()) / "examples"
session = read_session(EXAMPLES / "half_ball")
# Where the program's frame lies in the object's: x_object = T x_program.
T_OBJECT_PROGRAM = np.array(
    [[0.0, -1.0, 0.0, 0.010], [1.0, 0.0, 0.0, -0.005], [0.0, 0.0, 1.0, 0.400], [0.0, 0.0, 0.0, 1.0]]
)

# %% [markdown]
# The file, made here of a known measurement.

# %%
field = session.probings[0].displacement
turn, shift = T_OBJECT_PROGRAM[:3, :3], T_OBJECT_PROGRAM[:3, 3]
table = 1e3 * np.hstack([(field.points - shift) @ turn, field.displacement @ turn])
table = table[np.isfinite(table).all(axis=1)]
file = Path(tempfile.mkdtemp()) / "B00012.csv"
header = ",".join(f"{name} [mm]" for name in "XYZUVW")
np.savetxt(file, table, delimiter=",", header=header, comments="")

# %% [markdown]
# Read, brought into the object's frame, tied to its surface.

# %%
imported = on_surface(in_object_frame(read_measured("vic3d", file), T_OBJECT_PROGRAM), session.mesh)
print(f"{imported.read} points, {1e3 * imported.median_distance:.3f} mm off the surface (median)")

# %%
known = np.isfinite(field.displacement).all(axis=1)
assert np.allclose(imported.field.displacement, field.displacement[known], atol=1e-9)
