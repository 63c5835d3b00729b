# %% [markdown]
# # To MuJoCo
# The fitted half ball as tetrahedra with its constants, and one probing as a replay. The folder's
# README.txt says how to run it.

# %%
import tempfile
from pathlib import Path

import palpate

HERE = Path.cwd()
EXAMPLES = next(p for p in (HERE, *HERE.parents) if (p / "examples").is_dir()) / "examples"
result = palpate.fit(EXAMPLES / "half_ball", probe=["p2", "p3", "p4", "p5", "p6"])
folder = result.export(Path(tempfile.mkdtemp()) / "ball", "mujoco")

# %%
for path in sorted(folder.iterdir()):
    print(path.name, path.stat().st_size)

# %%
print((folder / "README.txt").read_text())

# %%
assert (folder / "model.xml").is_file()
assert "<flex " in (folder / "model.xml").read_text()
