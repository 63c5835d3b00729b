"""The shipped silicone beam: Young's modulus from the 0.510 N probings, and from all."""

from dataclasses import replace

from benchmarks.beam_finite_elements import finite_element_modulus
from benchmarks.figure import ESTIMATION, Figure
from benchmarks.machine import ROOT
from benchmarks.options import Options
from palpate.estimation import FitSettings
from palpate.pipeline import fit_session
from palpate.records import Session, read_session

FE_CELLS = ((16, 6, 6), (24, 8, 8))
PROBES = ("load52_a", "load52_b")
# Linear finite elements (quadratic hexahedra) on the same CSVs, by Poisson's ratio [Pa].
FINITE_ELEMENTS = {0.30: 246e3, 0.49: 239e3}
AUTHORS = 263.8e3  # their fit of a corotated finite element model, nu 0.499 [Pa]


def measure(options: Options) -> list[Figure]:
    """E at the Poisson's ratios of the finite elements, and E as it is reported."""
    session = read_session(ROOT / "examples" / "beam", probes=PROBES)
    reported = fit_session(session).estimate
    at_ratio = {nu: _young_modulus_at(session, nu) for nu in FINITE_ELEMENTS}
    errors = {nu: 100 * abs(e / FINITE_ELEMENTS[nu] - 1) for nu, e in at_ratio.items()}
    listed = "; ".join(
        f"nu {nu}: {e / 1e3:.1f} kPa against {FINITE_ELEMENTS[nu] / 1e3:.0f} kPa"
        for nu, e in at_ratio.items()
    )
    young, nu = reported.young_modulus, reported.poisson_ratio
    claimed = (
        f"reported: E {young.value / 1e3:.1f} kPa, 95 % {young.ci95[0] / 1e3:.1f} to"
        f" {young.ci95[1] / 1e3:.1f}; nu {nu.ci95[0]:.2f} to {nu.ci95[1]:.2f}; status"
        f" {reported.status.value}"
    )
    return [
        Figure(
            ESTIMATION,
            "beam, 0.510 N: E against linear finite elements at the same nu",
            max(errors.values()),
            "%",
            note=f"the worse of {listed}",
        ),
        _own_comparison(session, at_ratio[0.30]),
        _at_finite_strain(),
        Figure(
            ESTIMATION,
            "beam, 0.510 N: reported E against the authors' 264 kPa",
            100 * abs(young.value / AUTHORS - 1),
            "%",
            note=claimed,
        ),
    ]


def _own_comparison(session: Session, young_modulus: float) -> Figure:
    """Against finite elements that press exactly where the session says, on two meshes."""
    coarse, fine = (finite_element_modulus(session, 0.30, cells) for cells in FE_CELLS)
    return Figure(
        ESTIMATION,
        "beam, 0.510 N: E against finite elements computed here, nu 0.30",
        100 * abs(young_modulus / fine - 1),
        "%",
        note=f"{young_modulus / 1e3:.1f} kPa against {fine / 1e3:.1f} kPa on {FE_CELLS[1]} cells"
        f" ({coarse / 1e3:.1f} kPa on {FE_CELLS[0]}); same contact, same displacements",
    )


def _at_finite_strain() -> Figure:
    """All four pushes, of which the larger ones bend the beam far."""
    estimate = fit_session(read_session(ROOT / "examples" / "beam"), finite_strain=True).estimate
    young, nu = estimate.young_modulus, estimate.poisson_ratio
    return Figure(
        ESTIMATION,
        "beam, all pushes at finite strain: E against linear finite elements, 0.510 N, nu 0.49",
        100 * abs(young.value / FINITE_ELEMENTS[0.49] - 1),
        "%",
        note=f"E {young.value / 1e3:.1f} kPa, 95 % {young.ci95[0] / 1e3:.1f} to"
        f" {young.ci95[1] / 1e3:.1f}; nu {nu.ci95[0]:.2f} to {nu.ci95[1]:.2f}; status"
        f" {estimate.status.value}",
    )


def _young_modulus_at(session: Session, poisson_ratio: float) -> float:
    """E [Pa] where Poisson's ratio is known: its range is as narrow as a range can be."""
    near = (poisson_ratio - 1e-4, poisson_ratio + 1e-4)
    settings = replace(FitSettings(), poisson_range=near)
    return fit_session(session, settings=settings).estimate.young_modulus.value
