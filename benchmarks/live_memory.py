"""Memory that each push more takes in a live session on the demo's half ball, and that of an hour.

Points and covariances are those of the demo's pictures, taken in turn; displacements are what the
fit of its three pushes predicts at places on a spiral, with the noise that their covariances say.

    python -m benchmarks.live_memory [PUSHES ...]
"""

import copy
import pickle
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.figure import LIVE, Figure
from benchmarks.machine import ROOT, peak_memory
from palpate.checkpoints import Memory
from palpate.geometry import closest_points
from palpate.lab import built_in, choose_variant, make_session, read_lab_config
from palpate.pipeline import (
    Material,
    fit_session,
    fitted_body,
    plan_next,
    with_pictures_measured,
)
from palpate.records import Probing, Session, read_session

COUNTS, HOUR = (20, 40), 180
# Points that the tool hides, over its radius; lowest place on the half ball, over its height.
_HIDDEN, _LOWEST = 1.5, 0.3


def measure(counts: tuple[int, ...] = COUNTS) -> list[Figure]:
    """Memory of an hour, by what a push more takes."""
    whole, peaks = pushes(max(counts)), []
    with tempfile.TemporaryDirectory() as folder:
        for count in counts:
            file = Path(folder, str(count))
            file.write_bytes(pickle.dumps(replace(whole, probings=whole.probings[:count])))
            command = [sys.executable, "-m", "benchmarks.live_memory", "of", str(file)]
            done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
            print(done.stdout, end="", flush=True)
            peaks.append(int(done.stdout.split()[-1]))
    each = (peaks[-1] - peaks[0]) / (counts[-1] - counts[0])
    hour = peaks[-1] + (HOUR - counts[-1]) * each
    note = (
        f"of {HOUR} pushes, fit and plan twice, from that at {counts[0]} and"
        f" {counts[-1]} pushes: {each / 1e6:.1f} MB a push more; without the page and the bench"
    )
    return [Figure(LIVE, "an hour's session, memory", hour / 1e9, "GB", note=note)]


def _live(file: Path) -> None:
    """What `palpate measure` computes after a push, and after the next one."""
    session, kept, begun = pickle.loads(file.read_bytes()), Memory(), time.perf_counter()
    planned = None
    for _ in range(2):
        fitted = fitted_body(fit_session(session, cache=kept, material=Material.AUTO))
        planned = plan_next(session, count=6, fitted=fitted, known=planned, cache=kept)
    young, ratio = fitted.estimate.young_modulus, fitted.estimate.poisson_ratio
    print(
        f"{len(session.probings)} pushes: E {young.value:.6g} +- {young.std:.3g} Pa, nu"
        f" {ratio.value:.6f} +- {ratio.std:.2g}, {time.perf_counter() - begun:.1f} s, bytes at most"
        f" {peak_memory()}"
    )


def pushes(count: int) -> Session:
    """The demo's half ball, pressed at so many places."""
    with tempfile.TemporaryDirectory() as folder:
        make_session(read_lab_config(built_in()["demo"]), Path(folder), variant=choose_variant())
        session = with_pictures_measured(read_session(folder))
        fitted = fit_session(session)
    mesh, session = session.mesh, replace(session, rig=None)
    radius = float(mesh.vertices[:, 2].max())
    height = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - _LOWEST)
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - height**2)
    outward = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    place = closest_points(mesh, radius * outward).position
    rng = np.random.default_rng(0)
    shown = [_pressed(session, k, place[k], -outward[k]) for k in range(count)]
    predictions = fitted.predict(replace(session, probings=tuple(shown)))
    probings = []
    for probing, said in zip(shown, predictions, strict=True):
        field = probing.displacement
        root = np.linalg.cholesky(
            np.where(np.isnan(field.covariance), 0.0, field.covariance) + 1e-20 * np.eye(3)
        )
        noise = (root @ rng.standard_normal((len(root), 3, 1)))[..., 0]
        away = np.linalg.norm(field.points - probing.contact.point, axis=1)
        moved = said.predicted + noise
        moved[away < _HIDDEN * probing.contact.tool.radius] = np.nan
        moved[np.isnan(field.displacement)] = np.nan
        probings.append(replace(probing, displacement=replace(field, displacement=moved)))
    return replace(session, probings=tuple(probings))


def _pressed(session: Session, k: int, place: np.ndarray, inward: np.ndarray) -> Probing:
    like = session.probings[k % len(session.probings)]
    force = float(np.linalg.norm(like.force)) * inward
    contact = replace(like.contact, point=place)
    # Of its own, as every push has one.
    field = copy.deepcopy(like.displacement)
    return replace(
        like, name=f"n{k + 1:03d}", contact=contact, force=force, images=None, displacement=field
    )


if __name__ == "__main__":
    if sys.argv[1:2] == ["of"]:
        _live(Path(sys.argv[2]))
    else:
        for figure in measure(tuple(map(int, sys.argv[1:])) or COUNTS):
            print(figure)
