"""Take over displacements that another program measured, in its own frame and unit.

python examples/04_import_displacements.py
"""

import tempfile
from pathlib import Path

import numpy as np

import palpate
from palpate.records import in_object_frame, on_surface, read_measured

HERE = Path(__file__).parent
# Where the program's frame lies in the object's: x_object = T_object_program x_program.
T_OBJECT_PROGRAM = np.array(
    [[0.0, -1.0, 0.0, 0.010], [1.0, 0.0, 0.0, -0.005], [0.0, 0.0, 1.0, 0.400], [0.0, 0.0, 0.0, 1.0]]
)


def export_vic3d(path: Path) -> None:
    """Write the first probing of the half ball as VIC-3D would: millimetres, another frame."""
    field = palpate.read_session(HERE / "half_ball").probings[0].displacement
    turn, shift = T_OBJECT_PROGRAM[:3, :3], T_OBJECT_PROGRAM[:3, 3]
    points = (field.points - shift) @ turn
    table = 1e3 * np.hstack([points, field.displacement @ turn])
    table = table[np.isfinite(table).all(axis=1)]
    header = ",".join(f"{name} [mm]" for name in "XYZUVW")
    np.savetxt(path, table, delimiter=",", header=header, comments="")


def main() -> float:
    """Read the file back onto the mesh; gives the points' median distance from it [m]."""
    session = palpate.read_session(HERE / "half_ball")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "B00012.csv"
        export_vic3d(path)
        measured = in_object_frame(read_measured("vic3d", path), T_OBJECT_PROGRAM)
    imported = on_surface(measured, session.mesh)
    length = np.linalg.norm(imported.field.displacement, axis=1)
    print(f"{imported.read} points read, {imported.failed} of them not measured")
    print(f"median distance from the surface {1e3 * imported.median_distance:.3f} mm")
    print(f"displacement up to {1e3 * np.nanmax(length):.2f} mm")
    return imported.median_distance


if __name__ == "__main__":
    main()
