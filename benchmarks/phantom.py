"""Writes `examples/phantom`: a block with a ball five times as stiff inside, twelve pushes.

    python -m benchmarks.phantom FOLDER

Truth, places and noise are those of `benchmarks.heterogeneous`; FOLDER keeps its displacements.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.bodies import BODIES
from benchmarks.body_truth import SHEAR_MODULUS
from benchmarks.heterogeneous import FITTED, Box, session
from palpate.geometry import write_mesh
from palpate.records import Probing

EXAMPLE = Path(__file__).parents[1] / "examples" / "phantom"
_BODY, _KIND, _PUSHES = "block", "ball x5", FITTED + 2
_HEAD = """format = "palpate-session/1"
name = "phantom with a stiff ball inside, twelve pushes (computed, with noise)"

[object]
mesh = "mesh.ply"
length_unit = "mm"

[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-3 }
"""
_PROBE = """
[[probe]]
name = "{name}"
contact = {{ point = [{point}], radius = {radius:g}, profile = "smooth" }}
force = [{force}]
force_std = {std:.5f}
displacement = "{name}.csv"
"""


def main() -> None:
    """Write the folder."""
    whole = session(_BODY, _KIND, Path(sys.argv[1]), 0)
    EXAMPLE.mkdir(exist_ok=True)
    write_mesh(EXAMPLE / "mesh.ply", whole.mesh, metres_per_unit=1e-3)
    text = _HEAD
    for probing in whole.probings[:_PUSHES]:
        contact = probing.contact
        text += _PROBE.format(
            name=probing.name, point=_numbers(1e3 * contact.point),
            radius=1e3 * float(contact.radius or 0.0), force=_numbers(probing.force),
            std=float(np.linalg.norm(probing.force_std)),
        )  # fmt: skip
        _write_points(probing)
    (EXAMPLE / "session.toml").write_text(text, encoding="utf-8")
    box = Box(whole.mesh.vertices.min(0), np.ptp(whole.mesh.vertices, axis=0), whole.mesh)
    ratio = BODIES[_BODY].poisson_ratio
    (EXAMPLE / "truth.toml").write_text(
        f"young_modulus = {2.0 * SHEAR_MODULUS * (1.0 + ratio):g}\nshear_modulus ="
        f" {SHEAR_MODULUS:g}\npoisson_ratio = {ratio:g}\n\n[ball]\ncentre ="
        f" [{_numbers(1e3 * box.at(0.65, 0.45, 0.65))}]  # mm\nradius = 8.0  # mm\nratio = 5.0\n",
        encoding="utf-8",
    )


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.5f}" for value in values)


def _write_points(probing: Probing) -> None:
    field = probing.displacement
    if field is None or field.std is None:
        return
    rows = 1e3 * np.hstack([field.points, field.displacement, field.std])
    np.savetxt(
        EXAMPLE / f"{probing.name}.csv", rows, fmt=["%.3f"] * 3 + ["%.4f"] * 3 + ["%.3f"] * 3,
        delimiter=",", header="x,y,z,ux,uy,uz,sx,sy,sz", comments="",
    )  # fmt: skip


if __name__ == "__main__":
    main()
