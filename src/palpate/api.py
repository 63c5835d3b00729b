"""What `import palpate` offers besides the rooms: a fit in one call, and methods of its result."""

import html
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from palpate.errors import InputError, RecordError
from palpate.estimation import FitResult, FitSettings, Prediction, ProbeFit
from palpate.figures import (
    budget_figure,
    displacement_figure,
    errors_figure,
    likelihood_figure,
    modulus_map_figure,
    predictions_figure,
    probings_figure,
)
from palpate.pipeline import (
    FittedProbing,
    Material,
    PokedState,
    PoseChoice,
    fit_session,
    poke_session,
    pooled,
    require_series,
    tool_contact,
    with_pictures_measured,
)
from palpate.progress import Progress, silent
from palpate.records import (
    FORCE_UNITS,
    LENGTH_UNITS,
    REPORT_FILE,
    Constant,
    Estimate,
    Quantity,
    Session,
    constant_row,
    quantities,
    quantity,
    read_session,
    record_inputs,
    result_folder,
    session_files,
    verdict_text,
    without_pictures,
)
from palpate.report import write_report, write_result_files
from palpate.simulation import FORMATS, FitSource, export_fit, read_fitted

_LABELS = {
    "young_modulus": "Young's modulus",
    "shear_modulus": "shear modulus",
    "poisson_ratio": "Poisson's ratio",
}
_PICTURES = ("likelihood", "probings", "predictions", "errors", "budget", "modulus")


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """Result of a fit, with methods that plot, save, export and query it.

    Attributes
    ----------
    session : Session               session that was fitted, with the displacements used
    fitted : FitResult              all numbers: estimate, likelihood, predictions
    cache : Path or None            folder in which what is computed of the body is kept
    """

    session: Session
    fitted: FitResult
    cache: Path | None = None

    @property
    def estimate(self) -> Estimate:
        """The constants with their status and notes."""
        return self.fitted.estimate

    @property
    def young_modulus(self) -> Constant:
        """Young's modulus E [Pa]."""
        return self.estimate.young_modulus

    @property
    def shear_modulus(self) -> Constant:
        """Shear modulus G [Pa]."""
        return self.estimate.shear_modulus

    @property
    def poisson_ratio(self) -> Constant:
        """Poisson's ratio nu [-]."""
        return self.estimate.poisson_ratio

    def plot(self, what: str = "likelihood") -> Figure:
        """A figure of the result, which a notebook displays.

        Parameters
        ----------
        what : str                  "likelihood", "probings", "predictions", "errors", "budget",
                                    "modulus" (of a body that is not the same everywhere), or the
                                    name of a probing: measured against predicted on its surface

        Returns
        -------
        Figure                      matplotlib figure; `savefig` writes it to a file

        Raises
        ------
        InputError                  no such picture, or this result holds nothing to draw in it
        """
        drawn: Figure | None = None
        if what == "likelihood":
            drawn = likelihood_figure(self.fitted)
        elif what == "probings":
            drawn = probings_figure(self.estimate)
        elif what == "predictions":
            drawn = predictions_figure(self.session, self.fitted)
        elif what == "errors":
            drawn = errors_figure(self.estimate)
        elif what == "budget":
            drawn = budget_figure(self.estimate)
        elif what == "modulus":
            drawn = modulus_map_figure(self.fitted)
        else:
            drawn = self._probing_figure(what)
        if drawn is None:
            raise InputError(f"there is nothing to draw of {what!r} in this result")
        return drawn

    def _probing_figure(self, name: str) -> Figure | None:
        for probing in self.session.probings:
            for fitted in self.fitted.probes:
                if probing.name == fitted.name == name:
                    held = self.session.held_triangles
                    return displacement_figure(self.session.mesh, probing, fitted, held=held)
        names = ", ".join((*_PICTURES, *(probing.name for probing in self.session.probings)))
        raise InputError(f"there is no picture {name!r}; there are: {names}")

    def predict(self, pushes: Session | Path | str) -> tuple[Prediction, ...]:
        """Displacements of pushes that were not fitted, from their forces.

        Parameters
        ----------
        pushes : Session or path    of the same object on the same supports, with measured points;
                                    a path names a session folder

        Returns
        -------
        tuple of Prediction         one for each push, with standard deviations

        Raises
        ------
        InputError                  a push without points, a bad contact
        """
        return self.fitted.predict(_given(pushes))

    def poke(
        self,
        at: Sequence[Quantity],
        force: Sequence[Quantity],
        *,
        radius: Quantity | None = None,
    ) -> PokedState:
        """Response of the fitted object to a further push, at the estimated constants.

        Parameters
        ----------
        at : three numbers or texts     contact centre, in metres or as ("12 mm", "0 mm", ...)
        force : three numbers or texts  force of the tool on the object, in newtons or with a unit
        radius : number or text         contact radius; None: that of the session's first probing

        Returns
        -------
        PokedState

        Raises
        ------
        InputError                      a bad unit, a contact off the surface or on the support
        SingularSystemError             the support does not hold the object
        NotConvergedError               the iteration for a large object does not converge
        """
        size = None if radius is None else quantity(radius, LENGTH_UNITS, "radius")
        return poke_session(
            self.session,
            quantities(force, FORCE_UNITS, "force"),
            tool_contact(self.session, quantities(at, LENGTH_UNITS, "at"), size),
            shear_modulus=self.shear_modulus.value,
            poisson_ratio=self.poisson_ratio.value,
            modulus=self.fitted.map,
            cache=self.cache,
        )

    def save(self, folder: Path | str, *, force: bool = False) -> Path:
        """Write what `palpate fit` writes: estimate.json, residuals, pictures, the report.

        Parameters
        ----------
        folder : path               result folder; written completely or not at all
        force : bool                write even if something else lies there, which is then kept
                                    as NAME.old

        Returns
        -------
        Path                        the folder

        Raises
        ------
        InputError                  something else lies there and `force` is False, or the folder
                                    cannot be written
        """
        with result_folder(folder, kind="fit", force=force) as new:
            record_inputs(new, session_files(self.session.path))
            write_result_files(new, self.session, self.fitted)
            write_report(new, new / REPORT_FILE)
        return Path(folder)

    def export(
        self,
        folder: Path | str,
        to: str,
        *,
        probe: str | None = None,
        nodes: int | None = None,
        force: bool = False,
    ) -> Path:
        """Write the fitted object for a simulator, as `palpate export` does.

        Parameters
        ----------
        folder : path               result folder; written completely or not at all
        to : str                    "mujoco", "calculix", "obj", ...: a format of `palpate export`
        probe : str or None         name of the probing exported as the load case; None: the first
                                    that was held out from the estimate, else the first
        nodes : int or None         at most about so many, for real time (500), in simulators with
                                    linear tetrahedra
        force : bool                write even if something else lies there, which is then kept
                                    as NAME.old

        Returns
        -------
        Path                        the folder

        Raises
        ------
        InputError                  an unknown format, or one that does not accept these constants;
                                    something else lies there, or the folder cannot be written
        SingularSystemError         the support does not hold the object
        NotConvergedError           the iteration for a large object does not converge
        """
        if to not in FORMATS:
            raise InputError(f"there is no simulator {to!r}; there are: {', '.join(FORMATS)}")
        with result_folder(folder, kind=f"export --to {to}", force=force) as new:
            record_inputs(new, session_files(self.session.path))
            source = FitSource(self.session, self.estimate, (), modulus=self.fitted.map)
            export_fit(new, source, to, probe=probe, nodes=nodes, cache=self.cache)
        return Path(folder)

    def report(self, file: Path | str) -> Path:
        """Write the report: one self-contained HTML file.

        Parameters
        ----------
        file : path                 an existing file of that name is replaced

        Returns
        -------
        Path                        the file

        Raises
        ------
        InputError                  a name that does not end in .html
        RecordError                 it cannot be written
        """
        with tempfile.TemporaryDirectory() as folder:
            record_inputs(Path(folder), session_files(self.session.path))
            write_result_files(Path(folder), self.session, self.fitted)
            write_report(Path(folder), Path(file))
        return Path(file)

    def __repr__(self) -> str:
        lines = [f"{self.session.name}: {verdict_text(self.estimate)}"]
        for name, label in _LABELS.items():
            lines.append(f"  {label:16} " + "  ".join(constant_row(self.estimate, name)))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in (label, *texts)) + "</tr>"
            for name, label in _LABELS.items()
            for texts in [constant_row(self.estimate, name)]
        )
        head = "".join(
            f"<th>{heading}</th>" for heading in ("constant", "value", "95 % interval", "unit")
        )
        name, verdict = html.escape(self.session.name), html.escape(verdict_text(self.estimate))
        return f"<p><b>{name}</b>: {verdict}</p><table><tr>{head}</tr>{rows}</table>"


def fit(
    session: Session | Path | str,
    *,
    probe: str | Sequence[str] | None = None,
    method: str = "reduced",
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    surface: str = "smooth",
    strain: str = "small",
    material: str = "auto",
    time: bool = False,
    pose: PoseChoice = "auto",
    cache: Path | str | None = None,
    progress: Progress = silent,
) -> Result:
    """Estimate the elastic constants of a session's object.

    Parameters
    ----------
    session : Session or path       a path names a session folder, which is read first
    probe : str or sequence of str  names of the probings to use; only with a folder. None: all
    method : str                    "reduced", or "nelder-mead" on the full model
    poisson_range : (float, float)  range in which Poisson's ratio is searched
    surface : "smooth", "flat"      how to read the mesh: as points on a smooth object, or as facets
    strain : "small", "finite"      finite: correct for the geometric and material nonlinearity that
                                    the linear model leaves out at large displacement, and estimate
                                    the stiffening of the material where the data show it
    material : "auto", "homogeneous", "regions", "field"    one modulus everywhere, one for every
                                    region of the session, or one that differs from place to place;
                                    auto: regions if there are any, else a field only where the data
                                    contradict one modulus
    time : bool                     True: refuse a session from whose probings no modulus over time
                                    can be estimated; False: estimate it where one has a series
    pose : "auto", "given" or "register"    where the object is in pictures: as the rig says, or as
                                    the pictures at rest show; auto: the latter only where they
                                    contradict the rig
    cache : path or None            folder in which what is computed of the body is kept for later
                                    runs
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    Result

    Raises
    ------
    InputError                      invalid input; same messages as `palpate fit`
    SingularSystemError             the support does not hold the object
    NotConvergedError               an iteration does not converge, as in `fit_session`
    """
    _check_choice("surface", surface, ("smooth", "flat"))
    _check_choice("strain", strain, ("small", "finite"))
    _check_choice("material", material, tuple(Material))
    given = replace(_given(session, _probe_names(probe)), smooth=surface == "smooth")
    if time:
        require_series(given)
    folder = None if cache is None else Path(cache)
    measured = with_pictures_measured(given, pose=pose, progress=progress)
    fitted = fit_session(
        measured,
        settings=FitSettings(method=method, poisson_range=poisson_range),
        cache=folder,
        finite_strain=strain == "finite",
        material=Material(material),
        progress=progress,
    )
    return Result(measured, fitted, folder)


def read_result(
    folder: Path | str, *, session: Path | str | None = None, cache: Path | str | None = None
) -> Result:
    """Open what a fit wrote, without fitting: constants, figures, report, export and pokes.

    Parameters
    ----------
    folder : path                   result folder of `palpate fit` or `Result.save`
    session : path or None          present location of its session; None: as recorded
    cache : path or None            folder in which what is computed of the body is kept

    Returns
    -------
    Result                          cannot `predict`, which takes the model of a fit; the notes of
                                    its estimate say what has changed in the session since

    Raises
    ------
    RecordError                     no result, or a damaged one; its session is gone, or has another
                                    mesh or other measured points now
    """
    source, surface = read_fitted(Path(folder), None if session is None else Path(session))
    estimate = replace(source.estimate, notes=(*source.notes, *source.estimate.notes))
    given = replace(source.session, smooth=estimate.settings.get("surface") != "flat")
    shown = pooled(given) if without_pictures(given) else given
    measured = {probing.name: probing.displacement for probing in shown.probings}
    for probing in surface.probings:
        field = measured.get(probing.name)
        if field is None or not np.array_equal(field.points, probing.points):
            raise RecordError(
                f"{folder}: probing '{probing.name}' was fitted to other points than those of"
                f" {given.path} now; fit the session again"
            )
    fits = tuple(_fit_read(probing) for probing in surface.probings)
    fitted = FitResult(estimate, surface.likelihood, fits, map=source.modulus)
    return Result(given, fitted, None if cache is None else Path(cache))


def _fit_read(probing: FittedProbing) -> ProbeFit:
    """A probing as it was fitted."""
    return ProbeFit(
        name=probing.name,
        predicted=probing.predicted,
        residual=probing.displacement - probing.predicted,
        weight=probing.weight,
        left_out_predicted=probing.left_out,
        sigma=probing.sigma,
        surface=probing.surface,
    )


def _probe_names(probe: str | Sequence[str] | None) -> Sequence[str] | None:
    """The probings that were named."""
    names = [probe] if isinstance(probe, str) else probe
    if names is not None and not (
        isinstance(names, Sequence) and all(isinstance(name, str) for name in names)
    ):
        raise InputError(f"probe is {probe!r}; must be a probing's name, or a list of them")
    return names


def _given(session: Session | Path | str, probe: Sequence[str] | None = None) -> Session:
    """A session, read where it is a path."""
    if isinstance(session, Session):
        return session
    if isinstance(session, (str, os.PathLike)):
        return read_session(Path(session), probes=None if probe is None else list(probe))
    raise InputError(f"session is {session!r}; must be the path of a session folder, or a Session")


def _check_choice(name: str, given: str, allowed: Sequence[str]) -> None:
    if given not in allowed:
        choices = ", ".join(f"'{choice}'" for choice in allowed)
        raise InputError(f"{name} is {given!r}; must be one of {choices}")
