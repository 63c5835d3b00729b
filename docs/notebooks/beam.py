# %% [markdown]
# # A beam that bends does not tell Poisson's ratio
# A silicone cantilever with weights at its tip, measured by motion capture (real data,
# `examples/beam/README.md`).

# %%
from pathlib import Path

import palpate

HERE = Path.cwd()
EXAMPLES = next(p for p in (HERE, *HERE.parents) if (p / "examples").is_dir()) / "examples"
result = palpate.fit(EXAMPLES / "beam", probe=["load52_a"])
result

# %% [markdown]
# Bending gives Young's modulus. The region of likely pairs runs through all Poisson's ratios: G and
# nu trade against each other along E = 2 G (1 + nu).

# %%
result.plot()

# %%
assert result.estimate.identifiable["young_modulus"]
assert not result.estimate.identifiable["poisson_ratio"]
