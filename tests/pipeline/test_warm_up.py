"""After warming up, real measurements find every kernel compiled, for their very types."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """\
import sys
from dataclasses import replace
from numba.core.dispatcher import Dispatcher
from palpate.pipeline import fit_session, measure_pictures, warm_up
from palpate.records import read_session

def compiled():
    return {
        (name, kernel, str(signature))
        for name, module in list(sys.modules.items()) if name.startswith("palpate.")
        for kernel, value in vars(module).items() if isinstance(value, Dispatcher)
        for signature in value.signatures
    }

warm_up()
warm = compiled()
fit_session(read_session(sys.argv[1]))
session = read_session(sys.argv[2])
measure_pictures(replace(session, probings=session.probings[:1]))
print(*sorted(compiled() - warm), sep="\\n")
"""


EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.slow
def test_real_measurements_find_all_kernels(shared_data: Path) -> None:
    words = [str(EXAMPLES / "half_ball"), str(shared_data / "halfball_images")]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ""
