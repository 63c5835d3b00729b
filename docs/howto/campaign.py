"""Three boxes of soft parts to try a campaign on: the sessions of campaign.md.

python docs/howto/campaign.py parts      # writes the folder `parts`, 21 sessions
"""

import shutil
import sys
from pathlib import Path

import numpy as np

HALF_BALL = Path(__file__).parents[2] / "examples" / "half_ball"
# Young's modulus of each box over that of the half ball; a box scatters by 4 %.
BOXES = {"monday": 1.0, "tuesday": 1.05, "wednesday": 0.9}
PARTS, SCATTER = 7, 0.04
# One part from another mould, and one whose table somebody cut off.
HARD, CUT = ("tuesday", 4, 1.6), ("wednesday", 2)


def write_part(folder: Path, factor: float, rng: np.random.Generator) -> None:
    """The half ball's first three probings on a part so many times as stiff, with new noise."""
    folder.mkdir(parents=True)
    shutil.copy(HALF_BALL / "mesh.ply", folder)
    text = (HALF_BALL / "session.toml").read_text(encoding="utf-8")
    (folder / "session.toml").write_text("[[probe]]".join(text.split("[[probe]]")[:4]))
    for name in ("p1", "p2", "p3"):
        table = np.genfromtxt(HALF_BALL / f"{name}.csv", delimiter=",", skip_header=1)
        table[:, 3:6] /= factor
        table[:, 3:6] += table[:, 6:9] * rng.normal(size=(len(table), 3))
        table[:, 6:9] *= np.hypot(1.0 / factor, 1.0)
        head = (HALF_BALL / f"{name}.csv").open(encoding="utf-8").readline().strip()
        file = folder / f"{name}.csv"
        np.savetxt(file, table, fmt="%.5f", delimiter=",", header=head, comments="")


def main(folder: Path) -> None:
    """Write all parts, box by box."""
    rng = np.random.default_rng(4)
    for box, mean in BOXES.items():
        for number in range(1, PARTS + 1):
            factor = mean * np.exp(SCATTER * rng.normal())
            factor *= HARD[2] if (box, number) == HARD[:2] else 1.0
            write_part(folder / box / f"part {number}", factor, rng)
    broken = folder / CUT[0] / f"part {CUT[1]}" / "p2.csv"
    broken.write_text(broken.read_text()[:2000])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
