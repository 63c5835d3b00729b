"""Displacement CSVs: round trips, units, and every bad input with its message."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from surfaces import box

from palpate.errors import RecordError
from palpate.geometry import closest_points
from palpate.records import DisplacementField, observed_rows, write_displacement
from palpate.records.files.displacement import read_displacement

CUBE = box(size=(0.04, 0.04, 0.04), cells=4)
HEAD = "x,y,z,ux,uy,uz"
ROW = "0.02,0.02,0.04,0,0,-0.001"


@pytest.fixture
def csv_file(tmp_path):
    """Function that writes a CSV of the given lines and gives its path."""

    def write(*lines):
        path = tmp_path / "n01.csv"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def test_columns_may_come_in_any_order_and_units(csv_file):
    path = csv_file(" UZ,ux,uy,X,y,z,sigma", "-1,0.5,nan,20,10,40,0.1", "-1,0.5,0,20,11,40,0.2")
    field, notes = read_displacement(path, CUBE, metres_per_unit=0.001)
    assert notes == ()
    np.testing.assert_allclose(field.points, [[0.02, 0.01, 0.04], [0.02, 0.011, 0.04]])
    assert observed_rows(field).tolist() == [False, True]
    assert np.isnan(field.displacement[0]).all()
    np.testing.assert_allclose(field.displacement[1], [0.0005, 0.0, -0.001])
    np.testing.assert_allclose(field.std, [[1e-4] * 3, [2e-4] * 3])
    assert field.source == str(path)


def test_points_are_tied_to_the_surface(csv_file):
    field, _ = read_displacement(csv_file(HEAD, "0.02,0.011,0.0401,0,0,0"), CUBE)
    assert field.surface.distance[0] == pytest.approx(1e-4, rel=1e-10)
    np.testing.assert_allclose(field.surface.position[0], [0.02, 0.011, 0.04], atol=1e-15)


def test_empty_displacement_cells_are_not_measured(csv_file):
    field, _ = read_displacement(csv_file(HEAD, "0.02,0.02,0.04,,,", ROW), CUBE)
    assert observed_rows(field).tolist() == [False, True]


def test_comments_and_byte_order_marks_are_skipped(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("\ufeff# from the scanner\n" + HEAD + "\n" + ROW + "\n\n")
    assert len(read_displacement(path, CUBE)[0].points) == 1


def test_vertex_and_std_columns_round_trip_exactly(tmp_path, csv_file):
    index = 7
    point = ",".join(repr(float(x)) for x in CUBE.vertices[index])
    path = csv_file(
        HEAD + ",sx,sy,sz,vertex",
        f"{point},0.0001,nan,0.1,1e-5,2e-5,3e-5,7",
        f"{point},{1 / 3:.17g},0,1e-300,1e-5,2e-5,3e-5,7",
    )
    field, _ = read_displacement(path, CUBE)
    assert field.vertex.tolist() == [7, 7]
    write_displacement(tmp_path / "again.csv", field)
    again, _ = read_displacement(tmp_path / "again.csv", CUBE)
    for name in ("points", "displacement", "std", "vertex"):
        assert np.array_equal(getattr(again, name), getattr(field, name), equal_nan=True)


def test_round_trip_through_another_unit(tmp_path, csv_file):
    field, _ = read_displacement(csv_file(HEAD, ROW), CUBE)
    write_displacement(tmp_path / "mm.csv", field, metres_per_unit=0.001)
    again, _ = read_displacement(tmp_path / "mm.csv", CUBE, metres_per_unit=0.001)
    # One division and one multiplication: two roundings.
    np.testing.assert_allclose(again.displacement, field.displacement, rtol=5e-16)


PLACES = st.tuples(*[st.just(0.0) | st.floats(1e-29, 0.04)] * 2)
# Less than 1e-30 is read as zero.
MOVES = st.none() | st.tuples(*[st.floats(1e-29, 1e3) | st.floats(-1e3, -1e-29) | st.just(0.0)] * 3)
# An instrument's, of a cube of 40 mm.
STDS = st.tuples(*[st.floats(1e-13, 0.06)] * 3)


@settings(max_examples=40, deadline=None)
@given(
    # A row that repeats another is left out.
    rows=st.lists(
        st.tuples(PLACES, MOVES, STDS), min_size=1, max_size=6, unique_by=lambda row: row[:2]
    ).filter(lambda rows: any(move is not None for _, move, _ in rows)),
    with_std=st.booleans(),
)
def test_whatever_is_written_is_read_back(tmp_path_factory, rows, with_std):
    """In metres every digit of points, displacements, deviations and NaN rows comes back."""
    path = tmp_path_factory.mktemp("law") / "a.csv"
    points = np.array([[x, y, 0.04] for (x, y), _, _ in rows])
    moved = np.array([(np.nan,) * 3 if move is None else move for _, move, _ in rows])
    std = np.array([std for _, _, std in rows]) if with_std else None
    surface = closest_points(CUBE, points)
    field = DisplacementField(points, moved, std, None, surface, "memory")
    write_displacement(path, field)
    again, notes = read_displacement(path, CUBE)
    assert notes == ()
    np.testing.assert_array_equal(again.points, field.points)
    np.testing.assert_array_equal(again.displacement, field.displacement)
    if with_std:
        np.testing.assert_array_equal(again.std, std)
    else:
        assert again.std is None


def test_unknown_columns_are_left_out_and_said(csv_file):
    _, notes = read_displacement(csv_file(HEAD + ",correlation", ROW + ",high"), CUBE)
    assert "columns ['correlation'] are not of the format and were left out" in notes[0]


def test_points_off_the_surface_are_noted(csv_file):
    _, notes = read_displacement(csv_file(HEAD, "0.02,0.02,0.0412,0,0,0"), CUBE)
    assert "lie up to 0.0012 m off the surface" in notes[0]


BAD = [
    (("x,y,z,ux,uy", "0,0,0,0,0"), "the column 'uz' is missing; the first line must hold"),
    (
        ("x;y;z;ux;uy;uz", "0;0;0;0;0;0"),
        "columns are separated by semicolons; separate them by commas",
    ),
    ((HEAD + ",ux", ROW + ",0"), "the column 'ux' is there twice"),
    ((HEAD + ",sx", ROW + ",0"), r"has sx only; give sx, sy and sz"),
    ((HEAD + ",sx,sy,sz,sigma", ROW + ",1,1,1,1"), "has both sx,sy,sz and sigma"),
    ((HEAD + ",sigmas", ROW + ",1"), "unknown column 'sigmas'; did you mean 'sigma'"),
    ((HEAD, ROW, "0.02,0.02,top,0,0,0"), "line 3: column 'z' holds 'top'; must be a number"),
    ((HEAD, ROW, "0.02,0.02"), "line 3: has 2 cells; the header has 6 columns"),
    ((HEAD, ROW, "0,02,0,02,0,04,0,0,0"), "line 3: has 9 cells; the header has 6"),
    ((HEAD, "", ROW, ROW + ",1"), "line 4: has 7 cells"),
    ((HEAD,), "has a header and no rows"),
    ((HEAD, "0.02,0.02,0.04,nan,nan,nan"), r"not one of its 1 rows has a displacement \(all NaN"),
    ((HEAD, ROW, "nan,0.02,0.04,0,0,0"), "line 3: x, y or z is not a finite number"),
    ((HEAD, ROW, "0.02,0.02,0.04,inf,0,0"), "ux is infinite"),
    ((HEAD, ROW, "0.02,0.02,0.05,0,0,0"), r"line 3: the point is 0.01 m off the surface, farther"),
    ((HEAD + ",sigma", ROW + ",0"), "line 2: the standard deviation is 0 m"),
    ((HEAD + ",vertex", ROW + ",98"), "line 2: vertex is 98; must be a whole number from 0 to 97"),
    ((HEAD + ",vertex", ROW + ",0.5"), "line 2: vertex is 0.5; must be a whole number"),
    ((HEAD + ",vertex", ROW + ",0"), "vertex 0 of the mesh is 0.04899 m from the row's"),
    (("",), "is empty; give a header x,y,z,ux,uy,uz and a row"),
]


@pytest.mark.parametrize(("lines", "message"), BAD)
def test_bad_files_are_told_where_and_what(csv_file, lines, message):
    with pytest.raises(RecordError, match=message) as caught:
        read_displacement(csv_file(*lines), CUBE)
    assert "n01.csv" in str(caught.value)


def test_far_points_are_counted_and_the_worst_named(csv_file):
    rows = ["0.02,0.02,0.05,0,0,0", ROW, "0.02,0.02,0.09,0,0,0"]
    with pytest.raises(
        RecordError, match=r"2 of 3 points are, the worst by 0.05 m \(line 4\); .* 0.0693 m across"
    ):
        read_displacement(csv_file(HEAD, *rows), CUBE)


def test_limit_is_half_an_edge_where_the_mesh_is_coarse(csv_file):
    coarse = box(size=(0.04, 0.04, 0.04))
    row = "0.02,0.02,0.06,0,0,0"
    assert len(read_displacement(csv_file(HEAD, row), coarse)[0].points) == 1
    with pytest.raises(RecordError, match=r"0\.02 m off the surface, farther than 0\.00"):
        read_displacement(csv_file(HEAD, row), CUBE)


def test_files_that_cannot_be_read_or_written_are_named(tmp_path, csv_file):
    with pytest.raises(RecordError, match=r"none\.csv: cannot be read"):
        read_displacement(tmp_path / "none.csv", CUBE)
    (tmp_path / "binary.csv").write_bytes(b"\x89PNG\x00\x01")
    with pytest.raises(RecordError, match="not a text file"):
        read_displacement(tmp_path / "binary.csv", CUBE)
    field, _ = read_displacement(csv_file(HEAD, ROW), CUBE)
    with pytest.raises(RecordError, match="cannot be written"):
        write_displacement(tmp_path / "none" / "a.csv", field)


@pytest.mark.parametrize(("height", "noted"), [(0.0403, False), (0.0404, True)])
def test_half_a_percent_of_the_object_off_the_surface_is_noted(csv_file, height, noted):
    """0.005 of the cube's diagonal of 69.3 mm is 0.346 mm."""
    _, notes = read_displacement(csv_file(HEAD, f"0.02,0.02,{height},0,0,0"), CUBE)
    assert bool(notes) is noted


@pytest.mark.parametrize(("shift", "refused"), [(1.3e-3, False), (1.5e-3, True)])
def test_a_vertex_may_be_two_percent_of_the_object_away(csv_file, shift, refused):
    """0.02 of 69.3 mm is 1.386 mm, along the face from the vertex in its middle."""
    middle = int(np.linalg.norm(CUBE.vertices - [0.02, 0.02, 0.04], axis=1).argmin())
    path = csv_file(HEAD + ",vertex", f"{0.02 + shift},0.02,0.04,0,0,0,{middle}")
    if refused:
        with pytest.raises(RecordError, match=f"vertex {middle} of the mesh is 0.0015 m from"):
            read_displacement(path, CUBE)
    else:
        assert read_displacement(path, CUBE)[0].vertex.tolist() == [middle]


def test_repeated_rows_are_left_out_and_counted(csv_file):
    rows = ["0.02,0.02,0.04,0,0,-1e-4", "0.01,0.02,0.04,0,0,-9e-5", "0.01,0.01,0.04,nan,0,0"]
    # The same place measured again is a measurement of its own.
    lines = [HEAD, *rows * 20, "0.01,0.02,0.04,0,0,-8e-5"]
    field, notes = read_displacement(csv_file(*lines), CUBE)
    assert field.displacement[[0, 1, 3], 2].tolist() == [-1e-4, -9e-5, -8e-5]
    assert observed_rows(field).tolist() == [True, True, False, True]
    assert any("57 of 61 rows repeat another one" in note for note in notes)
    with pytest.raises(RecordError, match="line 63: the point is"):
        read_displacement(csv_file(*lines, "5,5,5,0,0,0"), CUBE)
