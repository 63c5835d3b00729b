"""`make tests` makes kernels anew when a file changes that they may come from: which these are."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ROOT / "src" / "palpate"
# Files of the ground floor that hold functions and types alone.
_FUNCTIONS = {"arrays", "errors", "machine", "optional_imports", "progress", "shapes", "threads"}


def _imports(path: Path) -> set[str]:
    """Rooms, and files of the ground floor, that a file takes names from."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {name.split(".")[1] for name in modules if name.startswith("palpate.")}


def test_kernels_come_from_the_rooms_that_make_looks_at():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    looked_at = set(re.search(r"^KERNEL_ROOMS := (.*)$", makefile, re.M).group(1).split())
    files = [path for path in ROOMS.rglob("*.py") if "njit" in path.read_text(encoding="utf-8")]
    assert len(files) > 20
    assert {path.relative_to(ROOMS).parts[0] for path in files} <= looked_at
    ground = {path.stem for path in ROOMS.glob("*.py")}
    for path in files:
        assert _imports(path) - ground <= looked_at, path
        # A constant of the ground floor within a kernel would go unseen.
        assert _imports(path) & ground <= _FUNCTIONS, path
