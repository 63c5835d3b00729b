"""Laws of the estimated material as CalculiX, Abaqus, FEBio and SOFA have them: elastic,
stiffening, creeping.

Source
------
CalculiX and Abaqus: *HYPERELASTIC, YEOH takes C1, C2, C3 and the compliances D1, D2, D3 of
(J - 1)^2, ^4, ^6. FEBio User Manual 4, "Yeoh": c1, c2 and the bulk modulus k of the logarithm of J.
SofaViscoElastic for SOFA 25.12, MaxwellFirstOrder: a strain E gives a stress 2 G (E - V) + lambda
tr E 1 with tau dV/dt = E - V; its tangent has 2 G.
"""

from pathlib import Path
from typing import Any

from palpate.records import write_text
from palpate.simulation.estimated_object import EstimatedObject, SolidModel

_MATERIAL = """    <material id="{number}" name="estimated{number}" type="isotropic elastic">
      <density>{density:.9g}</density>
      <E>{young:.9g}</E>
      <v>{poisson:.9g}</v>
    </material>"""
_STIFFENING = """    <material id="{number}" name="estimated{number}" type="Yeoh">
      <density>{density:.9g}</density>
      <c1>{first:.9g}</c1>
      <c2>{second:.9g}</c2>
      <k>{bulk:.9g}</k>
    </material>"""
# Of Yeoh's law: terms of higher order in the volume are left out by a compliance so many times as
# large; the programs take no zero for it.
_NO_TERM = 1e9


def prony(body: EstimatedObject) -> dict[str, Any] | None:
    """Young's modulus over time as a Prony series: `at_once` and `long_term` [Pa], and `terms`, a
    share of the former and its time [s] each; None of a body that is elastic.

    Parameters
    ----------
    body : EstimatedObject
    """
    relaxation = body.estimate.relaxation
    if relaxation is None or not relaxation.terms:
        return None
    at_once = relaxation.unrelaxed
    if relaxation.constant == "shear_modulus":
        at_once *= 2.0 * (1.0 + body.material.poisson_ratio)
    terms = [(term.share, term.time.value) for term in relaxation.terms]
    long_term = at_once * (1.0 - sum(share for share, _ in terms))
    return {"at_once": at_once, "long_term": long_term, "terms": terms}


def yeoh_constants(body: EstimatedObject, young_modulus: float) -> tuple[float, float, float]:
    """C1, C2 and the bulk modulus K of Yeoh's law [Pa]: C1 (I - 3) + C2 (I - 3)^2 + K / 2 (J - 1)^2
    with I = J^(-2/3) tr C.

    Parameters
    ----------
    body : EstimatedObject          of a material that stiffens
    young_modulus : float [Pa]      of a part of it
    """
    ratio, stiffening = body.material.poisson_ratio, body.estimate.stiffening
    first = 0.25 * young_modulus / (1.0 + ratio)
    second = first * stiffening.value if stiffening is not None else 0.0
    return first, second, young_modulus / (3.0 * (1.0 - 2.0 * ratio))


def abaqus_law(model: SolidModel, young_modulus: float) -> list[str]:
    """Lines of the elastic law of a material in CalculiX and Abaqus.

    Parameters
    ----------
    model : SolidModel
    young_modulus : float [Pa]
    """
    if model.body.estimate.stiffening is None:
        return ["*ELASTIC", f"{young_modulus:.9g}, {model.body.material.poisson_ratio:.9g}"]
    first, second, bulk = yeoh_constants(model.body, young_modulus)
    volume = (2.0 / bulk, _NO_TERM * 2.0 / bulk, _NO_TERM * 2.0 / bulk)
    numbers = ", ".join(f"{number:.9g}" for number in (first, second, 0.0, *volume))
    return ["*HYPERELASTIC, YEOH", numbers]


def write_abaqus_prony(folder: Path, model: SolidModel) -> None:
    """Write viscoelastic.inp: the materials of model.inp for Abaqus, as far as they creep.

    Bulk and shear modulus relax alike: Poisson's ratio is constant.
    """
    series = prony(model.body)
    if series is None:
        return
    lines = [
        "** In Abaqus, in place of the materials of model.inp, in a *VISCO step; see README.txt"
    ]
    for number, (young, _) in enumerate(model.materials, start=1):
        modulus = series["at_once"] * young / model.body.material.young_modulus
        lines += [
            f"*MATERIAL, NAME=ESTIMATED{number}",
            "*ELASTIC, MODULI=INSTANTANEOUS",
            f"{modulus:.9g}, {model.body.material.poisson_ratio:.9g}",
            "*VISCOELASTIC, TIME=PRONY",
            *(f"{share:.9g}, {share:.9g}, {time:.9g}" for share, time in series["terms"]),
            "*DENSITY",
            f"{model.body.density:.9g}",
        ]
    write_text(folder / "viscoelastic.inp", "\n".join([*lines, ""]))


def write_febio_prony(folder: Path, model: SolidModel) -> None:
    """Write viscoelastic.xml: the section Material of model.feb for a body that creeps.

    FEBio's stress is int (1 + sum_i g_i exp(-(t - s) / t_i)) dS(s) of an elastic S, that of the
    long term.
    """
    series = prony(model.body)
    if series is None:
        return
    lines = ["<Material>"]
    for number, (young, _) in enumerate(model.materials, start=1):
        modulus = series["long_term"] * young / model.body.material.young_modulus
        lines.append(f'  <material id="{number}" name="estimated{number}" type="viscoelastic">')
        for k, (share, time) in enumerate(series["terms"], start=1):
            weight = share * series["at_once"] / series["long_term"]
            lines.append(f"    <g{k}>{weight:.9g}</g{k}><t{k}>{time:.9g}</t{k}>")
        lines += [
            '    <elastic type="isotropic elastic">',
            f"      <density>{model.body.density:.9g}</density>",
            f"      <E>{modulus:.9g}</E><v>{model.body.material.poisson_ratio:.9g}</v>",
            "    </elastic>",
            "  </material>",
        ]
    write_text(folder / "viscoelastic.xml", "\n".join([*lines, "</Material>", ""]))


def sofa_branches(
    body: EstimatedObject,
) -> tuple[float, float, list[tuple[float, float]]] | None:
    """A spring and parallel Maxwell branches that relax as the body does; None for an elastic body.

    Branches have no bulk of their own: Lame's first constant stays that of the written constants,
    and Poisson's ratio rises as the shear modulus relaxes.

    Parameters
    ----------
    body : EstimatedObject

    Returns
    -------
    float, float                    Lame's first constant and the spring's shear modulus [Pa]
    list of (float, float)          shear modulus [Pa] and relaxation time [s] of every branch
    """
    series, written = prony(body), body.material
    if series is None:
        return None
    # Of few nodes the written constants are those of a softer body.
    unit = written.shear_modulus / body.estimate.shear_modulus.value
    unit *= 0.5 / (1.0 + written.poisson_ratio)
    lame = 2.0 * written.shear_modulus * written.poisson_ratio / (1.0 - 2.0 * written.poisson_ratio)
    branches = [(unit * series["at_once"] * share, time) for share, time in series["terms"]]
    return lame, unit * series["long_term"], branches


def febio_material(body: EstimatedObject, number: int, young_modulus: float) -> str:
    """A material of FEBio.

    Parameters
    ----------
    body : EstimatedObject
    number : int                    from 1
    young_modulus : float [Pa]
    """
    if body.estimate.stiffening is not None:
        first, second, bulk = yeoh_constants(body, young_modulus)
        return _STIFFENING.format(
            number=number, density=body.density, first=first, second=second, bulk=bulk
        )
    ratio = body.material.poisson_ratio
    return _MATERIAL.format(number=number, density=body.density, young=young_modulus, poisson=ratio)
