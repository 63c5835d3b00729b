"""What `import palpate` offers: a fit in one call; its picture, a poke, its files, the report.

python examples/02_whole_result.py
"""

import tempfile
from pathlib import Path

import palpate

HERE = Path(__file__).parent


def main() -> float:
    """How far the tip of a beam sinks under a weight that was never hung there, in metres."""
    with tempfile.TemporaryDirectory() as folder:
        return _shown(Path(folder))


def _shown(folder: Path) -> float:
    result = palpate.fit(HERE / "beam", probe=["load52_a"], cache=folder)
    # Objects print themselves; in a notebook `result` alone in a cell shows a table.
    print(result.session)
    print(result)
    # Numbers with their units, as people write them.
    poked = result.poke(at=("-1 mm", "15 mm", "3 cm"), force=(0, 0, "-20 gf"))
    print(poked)
    result.plot("load52_a").savefig(folder / "beam.png")
    # Written once, a result is opened again without a fit.
    opened = palpate.read_result(result.save(folder / "beam-result"))
    report = opened.report(folder / "beam.html")
    print(f"a report of {report.stat().st_size / 1e6:.1f} MB")
    return float(-poked.displacement[2])


if __name__ == "__main__":
    main()
