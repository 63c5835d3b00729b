"""Export of a result of `palpate fit` to a simulator: a self-explanatory folder."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.errors import InputError, RecordError
from palpate.pipeline import (
    FittedSurface,
    kept_motion,
    read_fitted_surface,
    read_modulus,
    with_motions,
)
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    CONSTANT_NAMES,
    INPUTS_FILE,
    Estimate,
    ModulusMap,
    Session,
    Status,
    check_fit_result,
    constant_row,
    file_sums,
    json_text,
    read_estimate,
    read_session,
    read_text,
    session_files,
    sums_in,
    write_text,
)
from palpate.simulation.estimated_object import (
    EstimatedObject,
    Format,
    Material,
    SolidModel,
    check_edge,
    estimated_material,
    make_estimated_object,
    make_solid_model,
    matched_to_push,
)
from palpate.simulation.laws import prony, sofa_branches
from palpate.simulation.solid_formats import CALCULIX, FEBIO, MUJOCO, SOFA, VTU
from palpate.simulation.surface_formats import GENESIS, ISAACLAB, NPZ, OBJ, OPENUSD

# Fractions of the work that are done when the push is known, and when the body is filled.
_PUSHED, _MOSTLY_PUSHED, _FILLED = 0.02, 0.8, 0.95
# Numbers of nodes that may be asked for.
_FEWEST_NODES, _MOST_NODES = 100, 100_000

EXPORT_FORMAT = "palpate-export/1"
# To add a simulator: a file with its `Format`, and one line here.
FORMATS: Mapping[str, Format] = {
    "mujoco": MUJOCO,
    "calculix": CALCULIX,
    "febio": FEBIO,
    "sofa": SOFA,
    "vtu": VTU,
    "openusd": OPENUSD,
    "obj": OBJ,
    "genesis": GENESIS,
    "isaaclab": ISAACLAB,
    "npz": NPZ,
}


@dataclass(frozen=True, slots=True, eq=False)
class FitSource:
    """A result of `palpate fit` with the session from which it was made.

    Attributes
    ----------
    session : Session
    estimate : Estimate
    files : tuple of Path           files of the result that were read
    notes : tuple of str            changes of the session since the fit, in a sentence
    modulus : ModulusMap or None    None: the same everywhere
    """

    session: Session
    estimate: Estimate
    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    modulus: ModulusMap | None = None


def read_fit(result: Path, session: Path | None = None) -> FitSource:
    """Read a result folder of `palpate fit`, and the session from which it was made.

    Parameters
    ----------
    result : Path
    session : Path or None          present location of the session; None: unchanged

    Returns
    -------
    FitSource

    Raises
    ------
    RecordError                     no result, of another version, changed, or copied incompletely;
                                    its session does not exist any more
    """
    check_fit_result(result)
    file = result / "estimate.json"
    source = session or _session_of(result, list(sums_in(result / INPUTS_FILE)))
    moduli = result / "modulus.npz"
    modulus = read_modulus(moduli)
    files = (file,) if modulus is None else (file, moduli)
    return FitSource(
        read_session(source), read_estimate(file), files, _changes(result, source), modulus
    )


def read_fitted(result: Path, session: Path | None = None) -> tuple[FitSource, FittedSurface]:
    """Read a result of `palpate fit` with what its session's pictures gave, and its surface.

    Parameters
    ----------
    result : Path
    session : Path or None          present location of the session; None: unchanged

    Returns
    -------
    FitSource
    FittedSurface

    Raises
    ------
    RecordError                     as of `read_fit`; a damaged surface, or the session has another
                                    mesh now
    """
    source, surface = read_fit(result, session), read_fitted_surface(result)
    fitted_session = source.session
    same = np.array_equal(fitted_session.mesh.vertices, surface.vertices)
    if not same or not np.array_equal(fitted_session.mesh.triangles, surface.triangles):
        raise RecordError(
            f"{result}: was fitted to another mesh than {fitted_session.path} names now; fit the"
            " session again"
        )
    fitted_session = with_motions(fitted_session, kept_motion(fitted_session, result))
    return replace(source, session=fitted_session), surface


def _changes(result: Path, session: Path) -> tuple[str, ...]:
    """Changes of a session with respect to the inputs of its result."""
    fitted = set(sums_in(result / INPUTS_FILE).values())
    files = session_files(session)
    now = file_sums(files, start=session if session.is_dir() else session.parent)
    changed = [name for name, value in now.items() if value not in fitted]
    if not fitted or not changed:
        return ()
    names = ", ".join(changed[:3])
    text = (
        f"the session is another than the one that was fitted ({names} changed): its shape and"
        " contacts are as they are now, the constants those of the fit"
    )
    return (text,)


def _session_of(result: Path, inputs: list[str]) -> Path:
    """The session file among the inputs of a result."""
    for name in inputs:
        file = result / name
        if file.suffix == ".toml" and file.is_file() and "palpate-session/" in read_text(file):
            return file
    raise RecordError(
        f"{result}: the session that it was made from is not where it was; say where it is now"
        " with --session"
    )


def written_material(form: Format, material: Material) -> tuple[Material, str]:
    """The constants within the range of a simulator, and a note of the change.

    Parameters
    ----------
    form : Format
    material : Material

    Returns
    -------
    Material                        Poisson's ratio limited to the simulator's largest; the shear
                                    modulus is unchanged
    str                             empty if nothing was changed

    Raises
    ------
    InputError                      a Poisson's ratio below the simulator's range
    """
    low, high = form.poisson
    ratio = material.poisson_ratio
    if ratio < low:
        raise InputError(
            f"Poisson's ratio is {ratio:.4g}; {form.title} takes {low:g} to {high:g}: choose"
            " another simulator (`--to calculix`), or fit with --poisson-range 0 0.4999 if the"
            " material is not auxetic"
        )
    if ratio <= high:
        return material, ""
    changed = replace(material, poisson_ratio=high)
    return changed, (
        f"Poisson's ratio {ratio:.4g} was written as {high:g}, the most that {form.title} takes"
        f" well; the shear modulus stays, Young's modulus is {changed.young_modulus:.5g} Pa in"
        f" place of {material.young_modulus:.5g} Pa"
    )


def export_fit(
    folder: Path,
    source: FitSource,
    to: str,
    *,
    probe: str | None = None,
    edge: float | None = None,
    nodes: int | None = None,
    cache: Path | None = None,
    progress: Progress = silent,
) -> EstimatedObject:
    """Write the files of one simulator, with README.txt and palpate.json.

    Parameters
    ----------
    folder : Path                   existing and empty
    source : FitSource
    to : str                        one of `FORMATS`
    probe : str or None             probing to be exported; None: the first that was held out from
                                    the estimate, else the first
    edge : float or None [m]        edge length of the tetrahedra away from the contact; None: see
                                    `make_solid_model`
    nodes : int or None             at most about so many of linear tetrahedra, whose modulus is
                                    written smaller so that the push moves as it should
    cache : Path or None            folder in which what is computed of the body is kept
    progress : callable             called with the current step (text) and the fraction done (0 to
                                    1)

    Returns
    -------
    EstimatedObject                 as exported, with its notes

    Raises
    ------
    InputError                      an unknown simulator, a material outside its range, no such
                                    probing
    MeshError                       walls thinner than the tetrahedra
    """
    if to not in FORMATS:
        raise InputError(f"there is no simulator '{to}'; there are: {', '.join(FORMATS)}")
    form = FORMATS[to]
    check_edge(source.session.mesh, edge)
    _check_nodes(form, edge, nodes)
    material, changed = written_material(form, estimated_material(source.estimate))
    progress("the push in the boundary element model", 0.0)
    body = make_estimated_object(
        source.session, source.estimate, material, modulus=source.modulus, probe=probe, cache=cache
    )
    uneven = ""
    if source.modulus is not None and not form.by_element:
        uneven = (
            f"the object is not the same everywhere, but {form.title} takes one modulus: that of"
            " the table was written, so its push ends elsewhere"
        )
    timed = _creep_advice(form, body)
    law = _law_advice(form, source.estimate)
    advice = (_status_advice(source.estimate), law, timed, changed, uneven)
    notes = [note for note in advice if note]
    body = replace(body, notes=(*source.notes, *notes, *body.notes))
    model = None
    if form.of_surface is not None:
        progress(f"files of {form.title}", _PUSHED)
        if left_out := form.of_surface(folder, body):
            body = replace(body, notes=(*body.notes, left_out))
    elif form.of_solid is not None:
        # Few nodes are soon filled in: the push takes the most of the time.
        pushed = _PUSHED if nodes is None else _MOSTLY_PUSHED
        stage_progress = part_of(progress, pushed, _FILLED)
        model = make_solid_model(body, edge=edge, nodes=nodes, progress=stage_progress)
        if nodes is not None:
            model, share = matched_to_push(model)
            body = replace(model.body, notes=(*body.notes, _few_nodes(len(model.nodes), share)))
            model = replace(model, body=body)
        progress(f"files of {form.title}", _FILLED)
        form.of_solid(folder, model)
    write_text(folder / "palpate.json", _facts(form, body, model))
    write_text(folder / "README.txt", _readme(form, body, model))
    return body


def _check_nodes(form: Format, edge: float | None, nodes: int | None) -> None:
    """Refuse a number of nodes for simulators that take none."""
    if nodes is None:
        return
    if not form.is_linear:
        linear = ", ".join(name for name, listed in FORMATS.items() if listed.is_linear)
        raise InputError(
            f"nodes is for simulators that take linear tetrahedra ({linear}), not for"
            f" {form.title}: leave it out"
        )
    if edge is not None:
        raise InputError("nodes and edge both say how fine the tetrahedra are; give one")
    if not _FEWEST_NODES <= nodes <= _MOST_NODES:
        raise InputError(f"nodes is {nodes}; must be {_FEWEST_NODES} to {_MOST_NODES}")


def _few_nodes(count: int, share: float) -> str:
    """What was written of a mesh that is too coarse for its push."""
    return (
        f"{count} nodes are few: their tetrahedra would be {1.0 / share:.3g} times as stiff under"
        f" the push, so the modulus was written {share:.3g} times as large; under loads that spread"
        " farther than the push the object gives way too much, up to that factor"
    )


def _status_advice(estimate: Estimate) -> str:
    """Advice on a status other than OK; empty for that."""
    if estimate.status is Status.OK:
        return ""
    return estimate.status.advice


def _creep_advice(form: Format, body: EstimatedObject) -> str:
    """What one modulus means of a body that creeps; empty of another one."""
    relaxation = body.estimate.relaxation
    if relaxation is None or not relaxation.terms:
        return ""
    advice = (
        f"the object creeps: its modulus was written as at {relaxation.age:.3g} s after contact;"
        " palpate.json has the Prony series (`relaxation`), viscoelastic.inp and viscoelastic.xml"
        " have it as materials of Abaqus and FEBio, viscoelastic.scn as one of SOFA, where these"
        " are written"
    )
    if form is not SOFA or (branches := sofa_branches(body)) is None:
        return advice
    if body.modulus is not None:
        return f"{advice}; SOFA's takes one modulus for all tetrahedra, so there is none"
    lame, shear, terms = branches
    at_once = shear + sum(term for term, _ in terms)
    ratios = (0.5 * lame / (lame + modulus) for modulus in (at_once, shear))
    first, last = (f"{ratio:.3f}" for ratio in ratios)
    return (
        f"{advice}. The bulk of SOFA's branches does not relax as the object's does: Poisson's"
        f" ratio is {first} at once and {last} in the long term"
    )


def _law_advice(form: Format, estimate: Estimate) -> str:
    """What was written of a material that stiffens; empty of another one."""
    stiffening = estimate.stiffening
    if stiffening is None:
        return ""
    if form.stiffens:
        return (
            f"the material stiffens: Yeoh's law was written with C2 / C1 = {stiffening.value:.4g},"
            " for large strain; its small strain has the constants of the table"
        )
    return (
        f"the material stiffens (C2 / C1 of Yeoh's law is {stiffening.value:.4g}), but no such law"
        f" was written for {form.title}: its object gives way too far under large pushes"
    )


def _facts(form: Format, body: EstimatedObject, model: SolidModel | None) -> str:
    """All facts about the export that a program may need, as JSON."""
    estimate, push = body.estimate, body.push
    constants = {name: getattr(estimate, name) for name in CONSTANT_NAMES}
    content = {
        "format": EXPORT_FORMAT,
        "simulator": form.title,
        "units": "SI: m, N, Pa, kg; frame of the session's mesh",
        "session": body.session.name,
        "status": estimate.status.value,
        "constants": {
            name: {
                "value": constant.value,
                "std": constant.std,
                "ci95": list(constant.ci95),
                "determined": estimate.identifiable[name],
            }
            for name, constant in constants.items()
        },
        "written": {
            "young_modulus": body.material.young_modulus,
            "poisson_ratio": body.material.poisson_ratio,
            "shear_modulus": body.material.shear_modulus,
            "density": body.density,
            "materials": len(model.materials) if model and form.by_element else 1,
        },
        "relaxation": prony(body),
        "stiffening": estimate.stiffening and estimate.stiffening.value,
        "push": push
        and {
            "probing": push.name,
            "held_out": push.held_out,
            "point": push.point.tolist(),
            "radius": push.radius,
            "profile": push.patch.contact.profile,
            "force": push.force.tolist(),
            "displacement": push.displacement.tolist(),
        },
        "tetrahedra": model
        and {
            "nodes": len(model.nodes),
            "quadratic": len(model.solid.elements),
            "linear": len(model.linear),
            "held_nodes": int(model.held.sum()),
            "deviation": model.solid.deviation,
        },
        "notes": list(body.notes),
    }
    return json_text(content)


def _readme(form: Format, body: EstimatedObject, model: SolidModel | None) -> str:
    """These facts as text."""
    lines = [f"{body.session.name}, for {form.title}; made by Palpate.", ""]
    lines += ["Units are SI (m, N, Pa, kg), the frame is that of the session's mesh.", ""]
    lines.append("Estimated, with 95 % intervals:")
    for name in CONSTANT_NAMES:
        value, interval, unit = constant_row(body.estimate, name)
        lines.append(f"  {name:15s} {value}   {interval} {unit}".rstrip())
    written = [
        f"{name} {getattr(body.material, name):.6g}{unit}"
        f"{'' if body.estimate.identifiable[name] else ' (assumed)'}"
        for name, unit in (("young_modulus", " Pa"), ("poisson_ratio", ""))
    ]
    lines.append(f"Written: {', '.join(written)}, density {body.density:g} kg/m^3.")
    if model is not None:
        lines.append(
            f"{len(model.solid.elements)} ten-node tetrahedra, {len(model.linear)} of four on the"
            f" same {len(model.nodes)} nodes; {int(model.held.sum())} of them are held."
        )
    if body.push is not None:
        push = body.push
        how = "the estimate was made without it" if push.held_out else "used in the estimate"
        force, motion = (" ".join(f"{x:.5g}" for x in v) for v in (push.force, push.displacement))
        lines += [
            "",
            f"Push: probing '{push.name}' ({how}), force {force} N; its point moves by {motion} m",
            "in Palpate's model.",
        ]
    lines += ["", f"To run: {form.run}", *(["", "Notes:"] if body.notes else [])]
    return "\n".join([*lines, *(f"- {note}" for note in body.notes), ""])
