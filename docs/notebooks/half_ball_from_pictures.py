# %% [markdown]
# # From pictures to constants
# A virtual half ball (E 52 kPa, nu 0.21), three cameras, three presses: pictures are rendered, the
# motion of the surface is measured in them, the constants are fitted. Needs `palpate[lab]`; some
# minutes.

# %%
import tempfile
from pathlib import Path

import palpate
from palpate.app.cli import main

folder = Path(tempfile.mkdtemp()) / "demo"
main(["lab", "demo", str(folder)])

# %% [markdown]
# A session of pictures is measured and fitted in one call.

# %%
result = palpate.fit(folder)
result

# %%
result.plot(result.session.probings[0].name)

# %% [markdown]
# E is within its interval. Of nu more is known than this bench tells: see the facility's page.

# %%
low, high = result.young_modulus.ci95
assert low < 52e3 < high
