"""Table 3 of the paper made again and again on the virtual bench: do its intervals hold the truth?

Every repeat has its own texture, misalignment, readings and noise; the specimen stays. The fits are
a campaign of their own, the pose as given.
"""

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.figure import FACILITY, Figure
from benchmarks.machine import CORES
from benchmarks.options import Options
from palpate.campaign import DONE, FitOptions, Store, run_campaign, started_engine
from palpate.campaign.store import CampaignItem
from palpate.lab import Material, built_in, choose_variant, make_sessions, read_lab_config
from palpate.paper.budget import CALIBRATION, REGISTRATION, with_misjudged_rig
from palpate.paper.constants import CONSTANTS, constant_errors, intervals_hold
from palpate.paper.sessions import reduced
from palpate.records import Estimate, ProbeEstimate, read_estimate, read_session

REPEATS = 20
# As in the error budget.
_ERROR = replace(
    CALIBRATION,
    object_rotation=REGISTRATION.object_rotation,
    object_translation=REGISTRATION.object_translation,
)
_WRONG = (
    f"focal lengths {100 * _ERROR.focal:g} %, centres {_ERROR.centre:g} px, cameras"
    f" {_ERROR.rotation:g} deg and {1e3 * _ERROR.translation:g} mm, object"
    f" {_ERROR.object_rotation:g} deg and {1e3 * _ERROR.object_translation:g} mm"
)


@dataclass(frozen=True, slots=True)
class Repeats:
    """Estimates of all repeats against the truth.

    Parameters
    ----------
    error : (r, 3) float        of nu, and of G and E in per cent
    held : (r, 3) bool          the 95 % interval holds the truth
    """

    error: Float[np.ndarray, "r 3"]
    held: np.ndarray


def measure(options: Options) -> list[Figure]:
    """Twenty sessions of the built-in half ball, each with all its probings."""
    config = read_lab_config(built_in()["half-ball"])
    config = reduced(config) if options.quick else config
    seeds = range(1, (2 if options.quick else REPEATS) + 1)
    with tempfile.TemporaryDirectory() as name:
        wanted = [(replace(config, seed=seed), Path(name) / str(seed)) for seed in seeds]
        for _, folder in wanted:
            folder.mkdir()
        variant = choose_variant()
        with started_engine(None, CORES) as workers:
            make_sessions(wanted, variant=variant, progress=_log_progress, distribute=workers.map)
        folders = [folder for _, folder in wanted]
        return evaluated(folders, config.material, Path(name) / "campaign")


def evaluated(folders: Sequence[Path], material: Material, campaign: Path) -> list[Figure]:
    """Figures of sessions that repeat each other, each in a folder named by its seed; the campaign
    of their fits is made or gone on with."""
    given = [folder / "session.toml" for folder in folders]
    every = fitted([*given, *map(misjudged_session, folders)], campaign)
    estimates, misjudged = every[: len(folders)], every[len(folders) :]
    together, wrong = _repeats(estimates, material), _repeats(misjudged, material)
    alone = _repeats([probe for estimate in estimates for probe in estimate.probes], material)
    count, singles = len(estimates), len(alone.error)
    note = f"{count} seeds: texture, misalignment, readings and noise anew"
    return [
        *_coverage("all probings", together, note),
        *_coverage("single probings", alone, f"{singles} probings; {note}"),
        *_coverage("all probings, calibration and pose a little wrong", wrong, f"{note}; {_WRONG}"),
        *_errors("all probings", together, note),
        *_errors("all probings, calibration and pose a little wrong", wrong, f"{note}; {_WRONG}"),
        *_spread(alone, f"{singles} probings; {note}"),
    ]


def fitted(files: Sequence[Path], campaign: Path) -> list[Estimate]:
    """Estimates of session files by the default method, the pose as given; two at a time."""
    items = [CampaignItem(f"{file.parent.name}/{file.name}", file.stem, file) for file in files]
    options = FitOptions(pose="given")
    rows = run_campaign(items, campaign, options=options, workers=CORES, progress=_log_progress)
    for row in rows:
        if row.state != DONE:
            raise RuntimeError(f"{row.session}: {row.message}")
        _log(f"{row.session}: nu {row.poisson_ratio}, E {row.young_modulus}, {row.seconds:.0f} s")
    results = Store(campaign)
    return [read_estimate(results.result_at(row.address) / "estimate.json") for row in rows]


def misjudged_session(folder: Path) -> Path:
    """File of a session beside the given one: its calibration and its pose are a little wrong."""
    rng = np.random.default_rng([int(folder.name), 1])
    with_misjudged_rig(read_session(folder), rng, folder / "rig_misjudged.toml", error=_ERROR)
    text = (folder / "session.toml").read_text(encoding="utf-8")
    file = folder / "session_misjudged.toml"
    file.write_text(text.replace('"rig.toml"', '"rig_misjudged.toml"'), encoding="utf-8")
    return file


def _repeats(estimates: Sequence[Estimate | ProbeEstimate], material: Material) -> Repeats:
    error = constant_errors(estimates, material) * [1.0, 100.0, 100.0]
    return Repeats(error, intervals_hold(estimates, material))


def _coverage(which: str, repeats: Repeats, note: str) -> list[Figure]:
    share = 100 * repeats.held.mean(axis=0)
    by_name = ", ".join(f"{s} {x:.0f} %" for s, x in zip(CONSTANTS, share, strict=True))
    # Intervals of one repeat are wrong together: chance is that of the repeats.
    chance = 100 * repeats.held.mean(axis=1).std() / np.sqrt(len(repeats.held))
    return [
        Figure(FACILITY, f"table 3, {which}: 95 % intervals that hold the truth",
               float(share.mean()), "%",
               note=f"{by_name}; +- {chance:.1f} % by chance; {note}"),
    ]  # fmt: skip


def _errors(which: str, repeats: Repeats, note: str) -> list[Figure]:
    rms = np.sqrt((repeats.error**2).mean(axis=0))
    mean = repeats.error.mean(axis=0)
    return [
        Figure(FACILITY, f"table 3, {which}: rms error of E", float(rms[2]), "%",
               note=f"mean error {mean[2]:+.2f} %; {note}"),
        Figure(FACILITY, f"table 3, {which}: rms error of nu", float(rms[0]),
               note=f"mean error {mean[0]:+.4f}; {note}"),
    ]  # fmt: skip


def _spread(repeats: Repeats, note: str) -> list[Figure]:
    spread = repeats.error.std(axis=0, ddof=1)
    return [
        Figure(FACILITY, "table 3, single probings: sd of nu", float(spread[0]), note=note),
        Figure(FACILITY, "table 3, single probings: sd of G", float(spread[1]), "%", note=note),
    ]  # fmt: skip


def _log_progress(text: str, share: float) -> None:
    _log(f"{100 * share:3.0f} % {text}")


def _log(text: str) -> None:
    """The last line of standard output belongs to the figures."""
    print(text, file=sys.stderr, flush=True)
