"""What limits table 3: its experiment repeated with one source of error at a time.

A bench without any error is where it begins; each source is then put in alone, in the size of a
careful laboratory. Sources that change the pictures get pictures of their own. Those that change
only what the estimate is told, readings and calibration, are drawn several times over the same
pictures.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import mesh_quality
from palpate.lab import (
    Arm,
    Calibration,
    LabConfig,
    Material,
    Sensor,
    Specimen,
    Variant,
    half_ball,
    make_sessions,
    miscalibrated,
    read_sensor,
    sensor_std,
)
from palpate.paper.constants import pictures_measured
from palpate.pipeline import fit_session
from palpate.progress import Progress, part_of, silent
from palpate.records import Estimate, ProbeEstimate, Session, read_rig, read_session, write_rig

Change = Callable[[LabConfig], LabConfig]
# Share of the time that goes into the sessions; estimates take the rest.
_MAKING = 0.6
# Where it touches; a robot's repeatability and the care with which its frame was found [m].
_PLACEMENT = 3e-4
# A calibration that leaves 0.2 px where the object fills the picture, most of it in scale: what
# would turn the cameras against each other shows between the pictures, and was calibrated away.
CALIBRATION = Calibration(focal=1e-3, centre=0.1, rotation=0.002, translation=2e-5)
REGISTRATION = Calibration(object_rotation=0.3, object_translation=3e-4)
# The session's mesh, this many times as coarse.
_COARSER = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class ErrorSource:
    """Errors that one source alone makes.

    Attributes
    ----------
    name, size : str                what it is, and how much of it
    single : (k, 3) float [-]       error of nu, of G over G and of E over E, of each probing alone
    joint : (d, 3) float [-]        the same of all probings together, one row a draw
    """

    name: str
    size: str
    single: Float[np.ndarray, "k 3"]
    joint: Float[np.ndarray, "d 3"]


@dataclass(frozen=True, slots=True)
class _Seen:
    """A source that changes the pictures: what it does to the bench without errors."""

    name: str
    size: str
    change: Change


@dataclass(frozen=True, slots=True)
class _Told:
    """A source that changes what the estimate is told: a session from the exact one."""

    name: str
    size: str
    change: Callable[[Session, np.random.Generator, Path], Session]


def error_budget(
    config: LabConfig,
    folder: Path,
    *,
    variant: Variant,
    draws: int = 5,
    progress: Progress | None = None,
) -> tuple[ErrorSource, ...]:
    """Errors of the constants, by source.

    Parameters
    ----------
    config : LabConfig              a half ball with probings; its own errors are the sizes of force
                                    noise, image noise and misalignment
    folder : Path                   empty: the sessions stay there
    variant : Variant               of Mitsuba
    draws : int                     of the sources that only change what is told, >= 1
    progress : callable or None     told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    tuple of ErrorSource            the bench without errors first, all of the bench's own errors
                                    together last

    Raises
    ------
    InputError, RecordError         as `make_sessions`
    """
    say = progress or silent
    seen, told = _seen(config), _told(config)
    exact = _exact(config)
    folders = [folder / _plain(source.name) for source in seen]
    for one in folders:
        one.mkdir()
    make_sessions(
        [(source.change(exact), one) for source, one in zip(seen, folders, strict=True)],
        variant=variant,
        progress=part_of(say, 0.0, _MAKING),
    )
    count = len(seen) + draws * len(told)
    done = 0
    sources = []
    # Its motion serves every source that changes no picture and no camera.
    first = pictures_measured(read_session(folders[0]))
    sessions = [first, *(read_session(one) for one in folders[1:])]
    for source, session in zip(seen, sessions, strict=True):
        say(source.name, _MAKING + (1.0 - _MAKING) * done / count)
        sources.append(_source(source.name, source.size, [session], config.material))
        done += 1
    for number, other in enumerate(told):
        drawn = []
        for draw in range(draws):
            rng = np.random.default_rng([config.seed, number, draw])
            drawn.append(other.change(first, rng, folder / f"{_plain(other.name)}_{draw}.toml"))
        say(other.name, _MAKING + (1.0 - _MAKING) * done / count)
        sources.insert(-1, _source(other.name, other.size, drawn, config.material))
        done += draws
    return tuple(sources)


def _exact(config: LabConfig) -> LabConfig:
    """The same bench without any error."""
    return replace(
        config,
        material=replace(config.material, law="linear"),
        arm=Arm(tip=config.arm.tip, radius=config.arm.radius),
        force_sensor=Sensor(),
        calibration=Calibration(),
        pictures=replace(config.pictures, noise=0.0, full_well=None, gain_drift=0.0),
    )


def _seen(config: LabConfig) -> tuple[_Seen, ...]:
    """Sources that change the pictures."""
    noise, turn = config.pictures.noise, config.arm.misalignment
    edge = mesh_quality(config.specimen.mesh).edge_mean
    return (
        _Seen("none", "flow and mesh alone", lambda exact: exact),
        _Seen(
            "image noise",
            f"{noise:g} of 255 grey levels",
            lambda exact: replace(exact, pictures=replace(exact.pictures, noise=noise)),
        ),
        _Seen(
            "tip misalignment",
            f"{turn:g}° about each axis",
            lambda exact: replace(exact, arm=replace(exact.arm, misalignment=turn)),
        ),
        _Seen(
            "tip placement",
            f"{1e3 * _PLACEMENT:g} mm along each direction",
            lambda exact: replace(exact, arm=replace(exact.arm, placement=_PLACEMENT)),
        ),
        _Seen(
            "mesh size",
            f"edges of {1e3 * _COARSER * edge:.2g} mm, not {1e3 * edge:.2g} mm",
            lambda exact: replace(exact, specimen=_coarse(exact, _COARSER * edge)),
        ),
        _Seen(
            "nonlinearity",
            "neo-Hookean body",
            lambda exact: replace(exact, material=replace(exact.material, law="neo-hookean")),
        ),
        _Seen("table 3", "force and image noise, misalignment", lambda _: config),
    )


def _told(config: LabConfig) -> tuple[_Told, ...]:
    """Sources that change what the estimate is told."""
    sensor, calibration, pose = config.force_sensor, CALIBRATION, REGISTRATION
    return (
        _Told(
            "force noise",
            f"{1e3 * sensor.noise:g} mN and {100 * sensor.relative_noise:g} %",
            lambda session, rng, _: _with_forces(session, sensor, rng),
        ),
        _Told(
            "calibration",
            f"focal length {100 * calibration.focal:g} %, centre {calibration.centre:g} px, camera"
            f" {calibration.rotation:g}° and {1e3 * calibration.translation:g} mm",
            lambda session, rng, file: with_misjudged_rig(session, calibration, rng, file),
        ),
        _Told(
            "registration",
            f"{pose.object_rotation:g}° and {1e3 * pose.object_translation:g} mm on each axis",
            lambda session, rng, file: with_misjudged_rig(session, pose, rng, file),
        ),
    )


def _coarse(config: LabConfig, edge: float) -> Specimen:
    """The same body with a coarser mesh of it for the session."""
    radius = float(config.specimen.mesh.vertices[:, 2].max())
    return replace(config.specimen, mesh=half_ball(radius=radius, edge=edge))


def _with_forces(session: Session, sensor: Sensor, rng: np.random.Generator) -> Session:
    """A session whose exact forces were read from a sensor."""
    probings = tuple(
        replace(
            probing,
            force=read_sensor(probing.force, sensor, rng=rng),
            force_std=np.full(3, sensor_std(probing.force, sensor)),
        )
        for probing in session.probings
    )
    return replace(session, probings=probings)


def with_misjudged_rig(
    session: Session, error: Calibration, rng: np.random.Generator, file: Path
) -> Session:
    """A session that is told another rig than the one that took its pictures.

    Parameters
    ----------
    session : Session               whose rig is the true one
    error : Calibration             standard deviations
    rng : Generator
    file : Path                     where the other rig is written

    Returns
    -------
    Session                         whose motion is still to be measured with that rig

    Raises
    ------
    InputError                      a session without a rig
    """
    if session.rig is None:
        raise InputError(f"{session.path}: has no rig")
    write_rig(file, miscalibrated(read_rig(session.rig), error, session.mesh, rng=rng))
    probings = tuple(replace(probing, displacement=None) for probing in session.probings)
    return replace(session, rig=file, probings=probings)


def _source(name: str, size: str, sessions: Sequence[Session], truth: Material) -> ErrorSource:
    """Errors of the estimates of some sessions; what was measured already is not measured anew."""
    results = [fit_session(pictures_measured(session)) for session in sessions]
    single = [_errors(probe, truth) for result in results for probe in result.estimate.probes]
    joint = [_errors(result.estimate, truth) for result in results]
    return ErrorSource(name, size, np.array(single), np.array(joint))


def _errors(estimate: Estimate | ProbeEstimate, truth: Material) -> list[float]:
    """Error of nu, and of G and E as shares."""
    return [
        estimate.poisson_ratio.value - truth.poisson_ratio,
        estimate.shear_modulus.value / truth.shear_modulus - 1.0,
        estimate.young_modulus.value / truth.young_modulus - 1.0,
    ]


def _plain(name: str) -> str:
    """A source's name as a folder."""
    return name.replace(" ", "_")
