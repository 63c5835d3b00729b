# %% [markdown]
# # A phantom with something stiff inside
# Ten pushes on a block, seen from one side, and nothing else known: is it the same everywhere, and
# if not, what is inside? (Computed data with noise, `examples/phantom/README.md`; about a minute.)

# %%
from dataclasses import replace
from pathlib import Path

import numpy as np

import palpate

HERE = Path.cwd()
EXAMPLES = next(p for p in (HERE, *HERE.parents) if (p / "examples").is_dir()) / "examples"
whole = palpate.read_session(EXAMPLES / "phantom")
fitted, kept = (
    replace(whole, probings=part) for part in (whole.probings[:10], whole.probings[10:])
)
result = palpate.fit(fitted)
result

# %% [markdown]
# The data are decisively likelier with a round part of another modulus. Its place is sharp; its
# size and its contrast can hardly be told apart, and the sentence says so.

# %%
for part in result.estimate.field.parts:
    print(part.sentence)
result.plot("modulus")

# %% [markdown]
# Two pushes were not used. Predicted from their forces, with this model and with one modulus:

# %%
one_modulus = palpate.fit(fitted, material="homogeneous")


def off(model):
    predictions = model.predict(kept)
    return [
        np.linalg.norm(p.predicted - p.measured) / np.linalg.norm(p.measured) for p in predictions
    ]


print(
    "off by, relative:",
    np.round(off(result), 4),
    "with one modulus:",
    np.round(off(one_modulus), 4),
)

# %%
(ball,) = result.estimate.field.parts
assert np.linalg.norm(np.array(ball.centre) - [9e-3, -2.25e-3, 29.25e-3]) < 2e-3
assert ball.low < 5.0 < ball.high
assert np.mean(off(result)) < 0.5 * np.mean(off(one_modulus))
