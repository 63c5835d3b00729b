# %% [markdown]
# # Quick start
# A half ball of 30 mm, pressed at six places: forces and displacements with noise, computed by
# finite elements. The truth is E = 60 kPa, nu = 0.30.

# %%
from pathlib import Path

import palpate

HERE = Path.cwd()
EXAMPLES = next(p for p in (HERE, *HERE.parents) if (p / "examples").is_dir()) / "examples"
result = palpate.fit(EXAMPLES / "half_ball")
result

# %% [markdown]
# Which pairs of constants do the data allow?

# %%
result.plot()

# %% [markdown]
# One probing on the surface: measured, predicted, and their difference in sigmas.

# %%
result.plot("p4")

# %% [markdown]
# How far does the fitted object give way under a push that nobody made?

# %%
result.poke(at=("0 mm", "0 mm", "30 mm"), force=(0, 0, "-0.5 N"))

# %%
low, high = result.young_modulus.ci95
assert low < 60e3 < high
