"""Is a gauge that reads 5 % too much in one of eight pushes found without any model?

Bodies of `bodies.py` with the truth of quadratic tetrahedra, pressed eight times at three places,
five of them obliquely; sessions told wrong by draws from their priors, noise of 1 % of the motion
(`coverage_of_bodies.py`). Half of the sessions are left as they are: reciprocity should not object.
In the other half one push, another one each time, tells 5 % more force. Run it with

    python -m benchmarks.reciprocity FOLDER [DRAWS [BODY ...]]

FOLDER keeps the true displacements, which take minutes a body.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.bodies import BODIES
from benchmarks.coverage_of_bodies import measured_body, session
from palpate.pipeline import reciprocity
from palpate.records import Session
from palpate.records.error_priors import ErrorPriors

NOISE = 0.01
GAIN = 0.05
# As a careful laboratory has them; contacts placed by a stage, with a better gauge.
PRIORS = {
    "usual priors": ErrorPriors(),
    "contacts to 0.1 mm": ErrorPriors(contact_point=1e-4),
    "and forces to 0.5 %": ErrorPriors(contact_point=1e-4, force=0.005),
}


def with_gain(given: Session, index: int, gain: float) -> Session:
    """A session with one force told too large."""
    probings = list(given.probings)
    chosen = probings[index]
    probings[index] = replace(chosen, force=(1.0 + gain) * chosen.force)
    return replace(given, probings=tuple(probings))


def main() -> None:
    """Print how often sound sessions are contradicted, and how often the odd push is named."""
    folder, draws = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 20
    for text, errors in PRIORS.items():
        total = np.zeros(3, dtype=np.int64)
        names = sys.argv[3:] or list(BODIES)
        for name in names:
            body = measured_body(name, folder, oblique=True)
            counts = np.zeros(3, dtype=np.int64)
            stds = []
            for seed in range(draws):
                sound = session(body, errors, NOISE, seed)
                index = seed % len(sound.probings)
                right = sound.probings[index].name
                judged, before = reciprocity(with_gain(sound, index, GAIN)), reciprocity(sound)
                named = judged.odd == (right,) and not judged.grows
                counts += [not before.holds or bool(before.odd), not judged.holds, named]
                stds += [push.std for push in judged.pushes if push.name == right]
            print(f"{text:20s} {name:10s} {_words(counts, draws)}; the others tell its force"
                  f" within {100 * float(np.mean(stds)):.1f} %", flush=True)  # fmt: skip
            total += counts
        print(f"{text:20s} all        {_words(total, draws * len(names))}", flush=True)


def _words(counts: np.ndarray, draws: int) -> str:
    return (
        f"sound ones contradicted or named {counts[0]} of {draws}; with a gain of"
        f" {100 * GAIN:.0f} %"
        f" contradicted {counts[1]}, the push named {counts[2]}"
    )


if __name__ == "__main__":
    main()
