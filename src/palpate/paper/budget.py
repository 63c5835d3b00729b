"""Error budget of table 3: its experiment repeated with one source of error at a time.

It starts from a bench without errors, to which each source is added alone, with the size it has in
a careful laboratory. Sources that change the pictures get pictures of their own; those that change
only readings or calibration are drawn several times with the same pictures.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from palpate.checkpoints import Checkpoints, content_digest
from palpate.errors import InputError
from palpate.figures import (
    BLUE,
    GREY,
    INK,
    ORANGE,
    PALE_BLUE,
    Picture,
    figure_pixels,
    open_frame,
    styled,
)
from palpate.geometry import mesh_quality
from palpate.lab import (
    Arm,
    Calibration,
    LabConfig,
    Material,
    Sensor,
    Variant,
    half_ball,
    make_sessions,
    miscalibrated,
)
from palpate.paper.constants import constant_errors
from palpate.paper.result import Cell, ResultTable
from palpate.pipeline import fit_session, with_pictures_measured
from palpate.progress import Progress, part_of, silent
from palpate.records import Session, read_rig, read_session, write_rig
from palpate.threads import Distribute

# (exact session, generator, file for a perturbed rig) -> session that is fitted.
Change = Callable[[Session, np.random.Generator, Path], Session]
# Fraction of the time for making the sessions; the rest is for the estimates.
_MAKING = 0.6
# Standard deviation of the contact point [m]: repeatability of a robot, registration of its frame.
_PLACEMENT = 3e-4
# A calibration with errors of 0.2 px where the object fills the picture, mostly of scale: relative
# rotations of the cameras are visible in the pictures and are removed by calibration.
CALIBRATION = Calibration(focal=1e-3, centre=0.1, rotation=0.002, translation=2e-5)
REGISTRATION = Calibration(object_rotation=0.3, object_translation=3e-4)
# Factor by which the edges of the session's mesh are longer in the coarse variant.
_COARSER = 2.0
# Columns of the errors in `SourceErrors`.
_NU, _YOUNG = 0, 2


@dataclass(frozen=True, slots=True, eq=False)
class SourceErrors:
    """Errors of the constants due to one source alone.

    Attributes
    ----------
    name, size : str                name and size of the source
    single : (k, 3) float [-]       error of nu, relative errors of G and E, of each probing alone
    joint : (d, 3) float [-]        the same of all probings together, one row per draw
    """

    name: str
    size: str
    single: Float[np.ndarray, "k 3"]
    joint: Float[np.ndarray, "d 3"]


@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A source of error: a bench of its own, or a change of the exact session's readings."""

    name: str
    size: str
    bench: LabConfig | None = None
    change: Change | None = None


def error_budget(
    config: LabConfig,
    folder: Path,
    *,
    variant: Variant,
    draws: int = 5,
    progress: Progress = silent,
    parts: Path | None = None,
    distribute: Distribute = map,
) -> tuple[SourceErrors, ...]:
    """Errors of the estimated constants, by source.

    Parameters
    ----------
    config : LabConfig              a half ball with probings; its own errors give the sizes of
                                    force noise, image noise and misalignment
    folder : Path                   an empty folder, in which the sessions are kept
    variant : Variant               of Mitsuba
    draws : int                     number of draws of sources that change no picture, >= 1
    progress : callable             called with the current step (text) and the fraction done, 0..1
    parts, distribute               as in `make_sessions`

    Returns
    -------
    tuple of SourceErrors           the bench without errors first, all of the bench's own errors
                                    together last

    Raises
    ------
    PalpateError                    as in `make_sessions`, `measure_motion` and `fit_session`
    """
    sources = _sources(config)
    folders = {
        source.name: folder / _folder_name(source.name) for source in sources if source.bench
    }
    for source_folder in folders.values():
        source_folder.mkdir()
    make_sessions(
        [(source.bench, folders[source.name]) for source in sources if source.bench],
        variant=variant,
        progress=part_of(progress, 0.0, _MAKING),
        parts=parts,
        distribute=distribute,
    )
    finished = Checkpoints(parts, "" if parts is None else content_digest((config, variant.name)))
    # Its motion is reused by every source that changes neither pictures nor cameras.
    exact = read_session(folders[sources[0].name])
    exact = with_pictures_measured(exact, pose="given", parts=parts)
    readings = [source for source in sources if source.change]
    budget: list[SourceErrors] = []
    for source in sources:
        progress(source.name, _MAKING + (1.0 - _MAKING) * len(budget) / len(sources))
        if source.change is None:
            sessions = [exact if not budget else read_session(folders[source.name])]
        else:
            seeds = ([config.seed, readings.index(source), draw] for draw in range(draws))
            sessions = [
                source.change(
                    exact,
                    np.random.default_rng(seed),
                    folder / f"{_folder_name(source.name)}_{seed[-1]}.toml",
                )
                for seed in seeds
            ]
        errors = [
            finished.load_or_make(
                f"{source.name} {number}", partial(_errors, session, config.material, parts)
            )
            for number, session in enumerate(sessions)
        ]
        single, joint = (np.concatenate(column) for column in zip(*errors, strict=True))
        budget.append(SourceErrors(source.name, source.size, single, joint))
    return tuple(budget)


def _exact(config: LabConfig) -> LabConfig:
    """A bench without any error."""
    return replace(
        config,
        material=replace(config.material, law="linear"),
        arm=Arm(tip=config.arm.tip, radius=config.arm.radius),
        force_sensor=Sensor(),
        calibration=Calibration(),
        pictures=replace(config.pictures, noise=0.0, full_well=None, gain_drift=0.0),
    )


def _sources(config: LabConfig) -> list[_Source]:
    """The bench without errors, with each source alone, and with all of its own errors."""
    exact = _exact(config)

    def changed(part: str, **values: Any) -> LabConfig:
        return replace(exact, **{part: replace(getattr(exact, part), **values)})

    noise, misalignment = config.pictures.noise, config.arm.misalignment
    edge = mesh_quality(config.specimen.mesh).edge_mean
    radius = float(config.specimen.mesh.vertices[:, 2].max())
    coarse = half_ball(radius=radius, edge=_COARSER * edge)
    edges = f"edges of {1e3 * _COARSER * edge:.2g} mm, not {1e3 * edge:.2g} mm"
    placement = f"{1e3 * _PLACEMENT:g} mm along each direction"
    sensor, calibration, pose = config.force_sensor, CALIBRATION, REGISTRATION
    forces = f"{1e3 * sensor.noise:g} mN and {100 * sensor.relative_noise:g} %"
    cameras = (
        f"focal length {100 * calibration.focal:g} %, centre {calibration.centre:g} px, camera"
        f" {calibration.rotation:g}° and {1e3 * calibration.translation:g} mm"
    )
    frame = f"{pose.object_rotation:g}° and {1e3 * pose.object_translation:g} mm on each axis"
    return [
        _Source("none", "flow and mesh alone", exact),
        _Source("image noise", f"{noise:g} of 255 grey levels", changed("pictures", noise=noise)),
        _Source(
            "tip misalignment",
            f"{misalignment:g}° about each axis",
            changed("arm", misalignment=misalignment),
        ),
        _Source("tip placement", placement, changed("arm", placement=_PLACEMENT)),
        _Source("mesh size", edges, changed("specimen", mesh=coarse)),
        _Source("nonlinearity", "neo-Hookean body", changed("material", law="neo-hookean")),
        _Source("force noise", forces, change=lambda s, rng, _: _with_forces(s, sensor, rng)),
        _Source("calibration", cameras, change=partial(with_misjudged_rig, error=calibration)),
        _Source("registration", frame, change=partial(with_misjudged_rig, error=pose)),
        _Source("table 3", "force and image noise, misalignment", config),
    ]


def _with_forces(session: Session, sensor: Sensor, rng: np.random.Generator) -> Session:
    """A session with simulated sensor readings in place of its exact forces."""
    probings = tuple(
        replace(
            probing,
            force=sensor.read(probing.force, rng=rng),
            force_std=np.full(3, sensor.std(probing.force)),
        )
        for probing in session.probings
    )
    return replace(session, probings=probings)


def with_misjudged_rig(
    session: Session, rng: np.random.Generator, file: Path, *, error: Calibration
) -> Session:
    """A session whose rig has random calibration errors.

    Parameters
    ----------
    session : Session               with the true rig
    rng : Generator                 of the errors
    file : Path                     file to which the perturbed rig is written
    error : Calibration             standard deviations

    Returns
    -------
    Session                         without displacements: they are to be measured with the new rig

    Raises
    ------
    InputError                      a session without a rig
    """
    if session.rig is None:
        raise InputError(f"{session.path}: has no rig")
    write_rig(file, miscalibrated(read_rig(session.rig), error, session.mesh, rng=rng))
    probings = tuple(replace(probing, displacement=None) for probing in session.probings)
    return replace(session, rig=file, probings=probings)


def _errors(
    session: Session, truth: Material, parts: Path | None
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "1 3"]]:
    """Errors of single probings and of all together; existing displacements are reused."""
    joint = fit_session(with_pictures_measured(session, pose="given", parts=parts)).estimate
    return constant_errors(joint.probes, truth), constant_errors([joint], truth)


def _folder_name(name: str) -> str:
    """A source's name as the name of a folder."""
    return name.replace(" ", "_")


def budget_table(sources: Sequence[SourceErrors]) -> ResultTable:
    """Mean and root mean square error of single probings, and of all together, by source.

    Parameters
    ----------
    sources : sequence of SourceErrors

    Returns
    -------
    ResultTable                     E in per cent
    """
    percent = np.array([1.0, 100.0, 100.0])
    rows: list[tuple[Cell, ...]] = []
    for source in sources:
        mean = (percent * source.single.mean(axis=0)).tolist()
        single, joint = (percent * _rms(e) for e in (source.single, source.joint))
        numbers = (mean[_YOUNG], single[_YOUNG], mean[_NU], single[_NU], joint[_YOUNG], joint[_NU])
        rows.append((source.name, len(source.joint), *map(float, numbers)))
    columns = (
        "source", "draws", "E mean (%)", "E rms (%)", "nu mean", "nu rms",
        "all: E rms (%)", "all: nu rms",
    )  # fmt: skip
    title = "Error of single probings, and of all together, with one source of error at a time"
    return ResultTable(title, columns, (0, 0, 2, 2, 4, 4, 2, 4), tuple(rows))


def sizes_table(sources: Sequence[SourceErrors]) -> ResultTable:
    """Table of the sizes of the sources.

    Parameters
    ----------
    sources : sequence of SourceErrors

    Returns
    -------
    ResultTable
    """
    rows = tuple((source.name, source.size) for source in sources)
    return ResultTable("Sizes of the sources", ("source", "size"), (0, 0), rows)


@styled
def budget_picture(sources: Sequence[SourceErrors]) -> Picture:
    """Root mean square errors by source, as bars (single probings) and dots (all together).

    Parameters
    ----------
    sources : sequence of SourceErrors      the bench without errors first, the whole bench last

    Returns
    -------
    Picture
    """
    height = 1.1 + 0.27 * len(sources)
    figure = Figure(figsize=(8.4, height))
    panels = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(
        left=0.15, right=0.98, wspace=0.08, top=1 - 0.42 / height, bottom=0.5 / height
    )
    for axes, column, factor, label in (
        (panels[0], _YOUNG, 100.0, "rms error of Young's modulus $E$ (%)"),
        (panels[1], _NU, 1.0, r"rms error of Poisson's ratio $\nu$"),
    ):
        _panel(axes, sources, column, factor)
        axes.set_xlabel(label)
    names = [f"{source.name} ({len(source.joint)})" for source in sources]
    panels[0].set_yticks(range(len(sources)), names)
    panels[0].set_ylim(len(sources) - 0.4, -0.6)
    handles = [panels[0].containers[0], *panels[0].lines[:3]]
    labels = [
        "single probings, rms", "all together, rms", "each draw (their number in brackets)",
        "single, without any source",
    ]  # fmt: skip
    figure.legend(handles, labels, loc="upper center", ncols=4)
    return figure_pixels(figure)


def _panel(axes: Axes, sources: Sequence[SourceErrors], column: int, factor: float) -> None:
    """Draw the bars and dots of one constant."""
    rows = np.arange(len(sources))
    single = factor * np.array([_rms(source.single)[column] for source in sources])
    joint = factor * np.array([_rms(source.joint)[column] for source in sources])
    axes.barh(rows, single, height=0.62, color=PALE_BLUE, edgecolor=BLUE, linewidth=0.6)
    axes.plot(joint, rows, "o", color=ORANGE, markersize=4.5, zorder=3, clip_on=False)
    draws = [factor * np.abs(source.joint[:, column]) for source in sources]
    axes.plot(
        np.concatenate(draws), np.repeat(rows, [len(draw) for draw in draws]), "o", color=INK,
        markersize=1.8, zorder=4, clip_on=False,
    )  # fmt: skip
    axes.axvline(single[0], color=GREY, linestyle="--", linewidth=0.8, zorder=0)
    axes.axhline(len(sources) - 1.5, color=GREY, linewidth=0.5)
    axes.set_xlim(left=0.0)
    axes.tick_params(axis="y", length=0)
    open_frame(axes)


def _rms(errors: np.ndarray) -> np.ndarray:
    """Root mean square of each column."""
    return np.sqrt((errors**2).mean(axis=0))
