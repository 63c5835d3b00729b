"""Small result files in the layouts of the programs, made by hand from known points."""

from pathlib import Path

import h5py
import numpy as np
from scipy.io import netcdf_file, savemat

from palpate.records.measured_points import MeasuredPoints
from palpate.records.probing import measured_rows

# Four points at rest and their displacements [mm]; the last one failed.
PLACE = np.array([[1.0, 2.0, 300.0], [4.0, 5.0, 301.0], [7.0, 8.0, 302.5], [3.0, 3.0, 299.0]])
MOVE = np.array([[0.01, -0.02, 0.03], [0.04, 0.05, -0.06], [0.0, 0.08, 0.09], [0.0, 0.0, 0.0]])
GOOD = np.array([True, True, True, False])

DICE_NAMES = [
    *(f"MODEL_COORDINATES_{axis}" for axis in "XYZ"),
    "COORDINATE_X",
    *(f"MODEL_DISPLACEMENT_{axis}" for axis in "XYZ"),
    "SIGMA",
    "MATCH",
]


def write_table(path: Path, header: str, rows: np.ndarray, *, delimiter=",", end="") -> Path:
    """A header and rows of numbers that keep every digit."""
    lines = [delimiter.join(repr(float(x)) for x in row) + end for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


def vic3d_rows() -> np.ndarray:
    """x, y, u, v [px], sigma, X, Y, Z, U, V, W; the failed point has sigma -1 and zeros."""
    pixels = np.arange(16.0).reshape(4, 4)
    sigma = np.where(GOOD, 0.012, -1.0)
    position = np.where(GOOD[:, None], PLACE, 0.0)
    return np.column_stack([pixels, sigma, position, MOVE])


def dice_values() -> np.ndarray:
    """Columns of DICE_NAMES; the failed point has MATCH = SIGMA = -1."""
    sigma, match = np.where(GOOD, 0.015, -1.0), np.where(GOOD, 0.0, -1.0)
    return np.column_stack([PLACE, np.arange(4.0), MOVE, sigma, match])


def dice_states() -> np.ndarray:
    """States of an Exodus file (t, variables, n): rest, half and full displacement."""
    full = dice_values().T
    states = np.stack([full, full, full])
    states[:, 4:7] *= np.array([0.0, 0.5, 1.0])[:, None, None]
    return states


def write_exodus(path: Path, states: np.ndarray, *, form: str) -> Path:
    """Exodus: `large` (a variable each), `small` (one for all) in NetCDF classic, or `hdf5`."""
    letters = np.array([list(name.ljust(33, "\0")) for name in DICE_NAMES], dtype="S1")
    if form == "hdf5":
        with h5py.File(path, "w") as file:
            file["name_nod_var"] = letters
            for k in range(states.shape[1]):
                file[f"vals_nod_var{k + 1}"] = states[:, k].astype("<f4")
        return path
    with netcdf_file(path, "w", version=2) as file:
        sizes = {"time_step": None, "num_nodes": 4, "num_nod_var": len(DICE_NAMES), "len_name": 33}
        for name, size in sizes.items():
            file.createDimension(name, size)
        file.createVariable("name_nod_var", "S1", ("num_nod_var", "len_name"))[:] = letters
        if form == "small":
            shape = ("time_step", "num_nod_var", "num_nodes")
            file.createVariable("vals_nod_var", "f8", shape)[: len(states)] = states
            return path
        for k in range(states.shape[1]):
            name = f"vals_nod_var{k + 1}"
            variable = file.createVariable(name, "f8", ("time_step", "num_nodes"))
            variable[: len(states)] = states[:, k]
    return path


def multidic_states() -> list[np.ndarray]:
    """Points3D of rest, half and full load; the failed point is NaN under load, and at rest."""
    states = [PLACE + share * MOVE for share in (0.0, 0.5, 1.0)]
    for state in states:
        state[~GOOD] = np.nan
    return states


def write_mat(
    path: Path, name: str, states: list[np.ndarray], *, version: str, criteria=()
) -> Path:
    """A struct with Points3D as MultiDIC saves it (version 5), or DuoDIC (version 7.3)."""
    fields = {"Points3D": states, **({"corrComb": criteria} if criteria else {})}
    return write_cells(path, name, fields, version=version)


def write_cells(path: Path, name: str, fields: dict, *, version: str) -> Path:
    """A struct of cells of arrays, and a field with an array, in a MATLAB file."""
    if version == "5":
        cells = {key: np.empty((len(states), 1), dtype=object) for key, states in fields.items()}
        for key, states in fields.items():
            cells[key][:, 0] = states
        savemat(path, {name: {"Faces": np.eye(3), **cells}, "other": 1.0})
        return path
    # MATLAB puts 512 bytes of its own before the HDF5 part.
    with h5py.File(path, "w", userblock_size=512) as file:
        for key, states in fields.items():
            links = np.empty((len(states), 1), dtype=h5py.ref_dtype)
            for i, state in enumerate(states):
                links[i, 0] = file.create_dataset(f"#refs#/{key}{i}", data=state.T).ref
            cell = file.create_dataset(f"{name}/{key}", data=links, dtype=h5py.ref_dtype)
            cell.attrs["MATLAB_class"] = b"cell"
        file[f"{name}/Faces"] = np.eye(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" "))
    return path


def check_four_points(measured: MeasuredPoints, *, nowhere=False) -> None:
    """The four points in metres; the failed one as NaN, with or without its place."""
    # The largest number is 302.5 mm; one rounding of the sum of place and displacement.
    exact = {"rtol": 0.0, "atol": 1e-16}
    assert list(measured_rows(measured.displacement)) == list(GOOD)
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], **exact)
    position = np.where((GOOD | (not nowhere))[:, None], 1e-3 * PLACE, np.nan)
    np.testing.assert_allclose(measured.points, position, **exact)


def dice_gold(path: Path) -> dict[str, np.ndarray]:
    """Nodal variables of the first state of an Exodus file, read without Palpate."""
    with netcdf_file(path, mmap=False) as file:
        names = [b"".join(row).split(b"\0")[0].decode() for row in file.variables["name_nod_var"]]
        return {
            name: np.array(file.variables[f"vals_nod_var{i + 1}"][0], dtype=np.float64)
            for i, name in enumerate(names)
        }


def gold_columns(gold: dict[str, np.ndarray], *names: str) -> np.ndarray:
    """Some of them side by side."""
    return np.stack([gold[name] for name in names], axis=1)


def cv_pixels(points: np.ndarray, matrix: np.ndarray, lens: list[float]) -> np.ndarray:
    """Pixels of points in the camera's frame by OpenCV's formula, with skew."""
    x, y = (points[:, :2] / points[:, 2:]).T
    k1, k2, p1, p2, k3 = [*lens, 0.0, 0.0][:5]
    r2 = x**2 + y**2
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = np.stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x**2),
            y * radial + p1 * (r2 + 2.0 * y**2) + 2.0 * p2 * x * y,
            np.ones(len(x)),
        ]
    )
    return (matrix @ bent)[:2].T
