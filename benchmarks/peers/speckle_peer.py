"""Image correlation and optical flow of other programs on the analytic speckle pairs."""

import json
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.peers.environment import Environment, last_line, run_command

HERE = Path(__file__).resolve().parent / "flow"
PROGRAMS = ("pyvale", "al-dic", "opencv-python-headless")
VERSIONS = """import json, sys
from importlib.metadata import PackageNotFoundError, version
def known(name):
    try:
        return version(name)
    except PackageNotFoundError:
        return None
print(json.dumps({name: known(name) for name in sys.argv[1:]}))"""


def speckle_rows(tool: Path, engines: Sequence[str], *, subset: int, make: bool) -> dict | str:
    """What the shared bench measures of other programs.

    Parameters
    ----------
    tool : Path               flow_bench.py
    engines : names           as the bench calls them
    subset : int [px]         side of the window
    make : bool               whether a missing environment may be made

    Returns
    -------
    dict or str               `versions`: of each program, None where it could not be installed;
                              `rows`: of each engine and case, `error` in place of figures where it
                              stopped; or why there is nothing
    """
    environment = Environment(HERE, ", ".join(PROGRAMS))
    if problem := environment.problem(make=make, all_needed=False):
        return problem
    python = str(environment.python)
    # Some programs leave files where they run.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "found.json"
        bench = [python, str(tool), "--peers", ",".join(engines), "--subset", str(subset)]
        done = run_command([*bench, "--json", str(file)], cwd=Path(folder))
        if done.returncode:
            return f"the bench stopped: {last_line(done.stderr)}"
        rows = json.loads(file.read_text(encoding="utf-8"))["rows"]
    versions = run_command([python, "-c", VERSIONS, *PROGRAMS])
    return {"versions": json.loads(versions.stdout), "rows": rows}
