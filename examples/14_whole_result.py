"""What `import palpate` offers: a fit in one call; its picture, a poke, the report.

python examples/14_whole_result.py
"""

import tempfile
from pathlib import Path

import palpate

HERE = Path(__file__).parent


def main() -> float:
    """Displacement of the half ball's top under 100 grams-force, in metres."""
    result = palpate.fit(HERE / "half_ball", probe=["p4"])
    # Objects print themselves; in a notebook `result` alone in a cell shows a table.
    print(result.session)
    print(result)
    # Numbers with their units, as people write them.
    poked = result.poke(at=("0 mm", "0 mm", "30 mm"), force=(0, 0, "-100 gf"), radius="5.5 mm")
    print(poked)
    with tempfile.TemporaryDirectory() as folder:
        result.plot("p4").savefig(Path(folder) / "p4.png")
        report = result.report(Path(folder) / "half_ball.html")
        print(f"a report of {report.stat().st_size / 1e6:.1f} MB")
    return float(-poked.displacement[2])


if __name__ == "__main__":
    main()
