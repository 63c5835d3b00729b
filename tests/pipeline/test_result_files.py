"""Files and tables of measured motions: what is in them, in which unit, and what is left out."""

import base64
import json
import math
import zlib
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from flow_samples import SIDE, SIGMA, camera, motion, sample
from rich.console import Console

from palpate.app.tables import flow_table
from palpate.errors import RecordError
from palpate.pipeline import MeasuredMotion
from palpate.pipeline.motion.figures import motion_figures, write_flow_document
from palpate.pipeline.result_files import (
    seen_vertices,
    write_flow_npz,
    write_flow_vtp,
    write_vertices,
)
from palpate.records import observed_rows
from palpate.records.files.displacement import read_displacement
from palpate.records.quantities import length_unit
from palpate.vision import Outcome, SurfaceMap, dense_maps, is_valid
from palpate.vision.projection import camera_sigma

REJECT = {Outcome.SCORE: [0, 1, 2], Outcome.LOST: [7]}


@pytest.fixture(scope="module")
def cube():
    return sample(reject=REJECT)


@pytest.fixture(scope="module")
def seen(cube):
    return seen_vertices(cube.surface, cube.mesh)


def figures_of(name, given, vertices, seen):
    """Figures of a step with a sample's flow."""
    measured = MeasuredMotion(name, None, True, given.picture, given.flow, vertices, None)
    return motion_figures(measured, given.rig, seen)


def lost_figures(name, given, seen):
    """Figures of a step whose pictures could not be read."""
    measured = MeasuredMotion(name, None, True, given.picture, None, None, "torn picture")
    return motion_figures(measured, given.rig, seen)


def shown(table, width=100):
    """What a terminal of that width shows."""
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    with console.file:
        console.print(table)
    return console.export_text()


# Vertices


def test_only_the_face_toward_the_camera_is_seen(cube, seen):
    np.testing.assert_array_equal(seen, cube.mesh.vertices[:, 2] > 0.99 * SIDE)


def test_vertices_of_one_triangle_are_seen_where_it_alone_is(cube):
    alone = SurfaceMap(cube.surface.point, np.where(cube.surface.triangle < 0, -1, 5))
    flags = seen_vertices(alone, cube.mesh)
    np.testing.assert_array_equal(np.flatnonzero(flags), np.sort(cube.mesh.triangles[5]))


@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_the_csv_is_what_a_fit_reads(cube, seen, tmp_path, unit):
    write_vertices(tmp_path / "n01.csv", cube.mesh, cube.vertices, seen=seen, metres_per_unit=unit)
    field, notes = read_displacement(tmp_path / "n01.csv", cube.mesh, metres_per_unit=unit)
    assert notes == ()
    known = np.isfinite(cube.vertices.displacement[:, 0])
    np.testing.assert_array_equal(field.vertex, np.flatnonzero(seen))
    np.testing.assert_array_equal(observed_rows(field), known[seen])
    assert 0 < known.sum() < seen.sum() < len(seen)
    # A factor of the unit and back: two roundings.
    expected = motion(cube.mesh.vertices[known])
    np.testing.assert_allclose(field.displacement[known[seen]], expected, rtol=1e-14, atol=0)
    np.testing.assert_allclose(field.std[known[seen]], 0.5 * SIGMA * np.ones_like(expected))
    np.testing.assert_allclose(field.points, cube.mesh.vertices[seen], rtol=0, atol=1e-16)


def test_the_file_itself_is_in_the_sessions_unit(cube, seen, tmp_path):
    write_vertices(tmp_path / "mm.csv", cube.mesh, cube.vertices, seen=seen, metres_per_unit=1e-3)
    table = np.genfromtxt(tmp_path / "mm.csv", delimiter=",", names=True)
    assert table.dtype.names == (*"xyz", "ux", "uy", "uz", "sx", "sy", "sz", "vertex")
    np.testing.assert_allclose(table["z"], 1e3 * SIDE)
    assert np.nanmax(table["ux"]) == pytest.approx(0.1 + 5e-3 * table["x"][table["ux"] > 0].max())


def test_a_measured_vertex_that_the_map_does_not_show_is_kept(cube, tmp_path):
    nothing = np.zeros(len(cube.mesh.vertices), dtype=bool)
    write_vertices(tmp_path / "a.csv", cube.mesh, cube.vertices, seen=nothing)
    field, _ = read_displacement(tmp_path / "a.csv", cube.mesh)
    assert observed_rows(field).all()
    assert len(field.points) == np.isfinite(cube.vertices.displacement[:, 0]).sum()


def test_a_csv_that_cannot_be_written_is_said(cube, seen, tmp_path):
    with pytest.raises(RecordError, match="cannot be written"):
        write_vertices(tmp_path / "no" / "a.csv", cube.mesh, cube.vertices, seen=seen)


# Range flow


def test_the_npz_holds_all_of_the_range_flow(cube, tmp_path):
    write_flow_npz(tmp_path / "a.npz", cube.flow, name="n01", cameras=["c0", "c1"])
    with np.load(tmp_path / "a.npz") as stored:
        for key in ("pixel", "point", "displacement", "gradient", "covariance", "bias", "score",
                    "reprojection", "cameras", "outcome", "noise", "tangent"):  # fmt: skip
            np.testing.assert_array_equal(stored[key], getattr(cube.flow, key), err_msg=key)
        np.testing.assert_array_equal(stored["through_last"], cube.flow.through_last)
        assert stored["drift"] == cube.flow.drift
        assert (stored["subset"], stored["step"]) == (cube.flow.subset, cube.flow.step)
        assert tuple(stored["shape"]) == cube.flow.shape
        assert (stored["format"], stored["name"]) == ("palpate-range-flow/1", "n01")
        assert stored["camera_names"].tolist() == ["c0", "c1"]
        assert stored["outcome_names"][stored["outcome"][7]] == "lost"


def test_the_flow_at_every_pixel_is_stored_in_single_precision(cube, tmp_path):
    write_flow_npz(tmp_path / "a.npz", cube.flow, name="s1", cameras=["c0", "c1"])
    displacement, sigma = dense_maps(cube.flow)
    with np.load(tmp_path / "a.npz") as stored:
        assert stored["dense_displacement"].dtype == np.float32
        np.testing.assert_array_equal(stored["dense_displacement"], displacement)
        np.testing.assert_array_equal(stored["dense_sigma"], sigma)
    # Points are pixels too: single precision there.
    valid = is_valid(cube.flow)
    column, row = cube.flow.pixel[valid].astype(int).T
    inside = np.isfinite(displacement[row, column, 0])
    assert inside.mean() > 0.8
    np.testing.assert_allclose(
        displacement[row, column][inside], cube.flow.displacement[valid][inside], rtol=1e-6
    )


def vtp_arrays(path):
    """Arrays of a .vtp by name, decoded after VTK's description and not with Palpate's reader."""
    root = ElementTree.parse(path).getroot()
    assert root.get("compressor") == "vtkZLibDataCompressor"
    arrays = {}
    for node in root.iter("DataArray"):
        kind = {"Float32": "<f4", "Float64": "<f8", "Int32": "<i4", "Int64": "<i8"}[
            node.get("type")
        ]
        blocks = np.frombuffer(base64.b64decode(node.text[:12])[:8], "<u8")[0]
        length = -(-8 * int(3 + blocks) // 3) * 4
        raw = zlib.decompress(base64.b64decode(node.text[length:])) if blocks else b""
        values = np.frombuffer(raw, kind)
        arrays[node.get("Name")] = values.reshape(-1, int(node.get("NumberOfComponents"))).squeeze()
    return root.find("PolyData/Piece"), arrays


def test_the_vtp_has_a_vector_at_every_point(cube, tmp_path):
    write_flow_vtp(tmp_path / "a.vtp", cube.flow, camera())
    piece, arrays = vtp_arrays(tmp_path / "a.vtp")
    count, valid = len(cube.flow.point), is_valid(cube.flow)
    assert int(piece.get("NumberOfPoints")) == int(piece.get("NumberOfVerts")) == count
    assert piece.find("PointData").get("Vectors") == "displacement"
    np.testing.assert_array_equal(arrays["Points"], cube.flow.point)
    np.testing.assert_array_equal(arrays["connectivity"], np.arange(count))
    np.testing.assert_array_equal(arrays["offsets"], np.arange(1, count + 1))
    # Single precision. The camera looks along z.
    np.testing.assert_allclose(arrays["displacement"][valid], motion(cube.flow.point[valid]), 1e-7)
    np.testing.assert_allclose(arrays["sigma_depth"][valid], SIGMA[2], 1e-6)
    np.testing.assert_array_equal(arrays["outcome"], cube.flow.outcome)
    assert (arrays["displacement"][~valid] == 0.0).all()
    assert np.isnan(arrays["magnitude"][~valid]).all()


def test_a_flow_without_points_can_be_written(cube, tmp_path):
    away = {
        name: getattr(cube.flow, name)[:0]
        for name in ("pixel", "point", "tangent", "displacement", "gradient", "covariance", "bias",
                     "score", "reprojection", "cameras", "outcome", "through_last")
    }  # fmt: skip
    rest = {
        name: getattr(cube.flow, name) for name in ("drift", "noise", "subset", "step", "shape")
    }
    empty = type(cube.flow)(**away, **rest)
    write_flow_vtp(tmp_path / "a.vtp", empty, camera())
    piece, arrays = vtp_arrays(tmp_path / "a.vtp")
    assert piece.get("NumberOfPoints") == "0"
    assert all(values.size == 0 for values in arrays.values())


# Figures


def test_sigma_is_across_and_along_the_axis_of_the_camera():
    # A camera that looks along x: across is y and z.
    turned = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] = turned
    looking = type(camera())("c", None, camera().matrix, np.zeros(8), pose)
    lateral, depth = camera_sigma(np.diag([4.0, 9.0, 25.0])[None], looking)
    assert depth == pytest.approx(2.0)
    assert lateral == pytest.approx(math.sqrt((9.0 + 25.0) / 2.0))


def test_figures_count_and_take_medians(cube, seen):
    f = figures_of("n01", cube, cube.vertices, seen)
    assert f.valid == f.points - 4 == len(cube.flow.point) - 4
    assert {cause: n for cause, n in f.rejected.items() if n} == {"score": 3, "lost": 1}
    assert next(iter(f.rejected)) == "hidden"
    assert len(f.rejected) == len(Outcome) - 1
    assert f.vertices == {"seen": 49, "measured": 25}
    assert f.median_sigma["lateral"] == pytest.approx(math.sqrt((9 + 16) / 2) * 1e-6)
    assert f.median_sigma["depth"] == pytest.approx(2e-5)
    assert f.median_vertex_sigma["depth"] == pytest.approx(1e-5)
    valid = is_valid(cube.flow)
    assert f.median_displacement == pytest.approx(np.median(motion(cube.flow.point[valid])[:, 0]))
    assert f.median_reprojection == pytest.approx(np.median(cube.flow.reprojection[valid]))
    assert f.noise == {"c0": 1.5, "c1": 1.75}
    # The one point that went through the instant before was rejected.
    assert (f.through_last, f.drift) == (0, 3e-6)


def test_figures_of_nothing_are_unknown(seen):
    count = len(sample().flow.point)
    blind = sample(reject={Outcome.TEXTURE: np.arange(count)})
    f = figures_of("n01", blind, None, seen)
    assert (f.valid, f.vertices["measured"], f.rejected["texture"]) == (0, 0, count)
    medians = (*f.median_sigma.values(), *f.median_vertex_sigma.values(), f.median_reprojection)
    assert all(math.isnan(x) for x in medians)


@pytest.mark.parametrize(
    ("length", "unit"), [(2e-3, (1e-3, "mm")), (9e-5, (1e-6, "µm")), (math.nan, (1e-6, "µm"))]
)
def test_a_length_is_told_in_a_unit_of_its_size(length, unit):
    assert length_unit(length) == unit


def test_the_table_shows_causes_that_occur_and_failures(cube, seen):
    good = figures_of("n[01]", cube, cube.vertices, seen)
    lost = lost_figures("n02", cube, seen)
    text = shown(flow_table([good, lost], cube.rig))
    lines = text.splitlines()
    first = next(line for line in lines if line.startswith(" n[01]")).split()
    second = next(line for line in lines if line.startswith(" n02")).split()
    share = f"{100.0 * (good.points - 4) / good.points:.1f}"
    assert first[1:] == [
        str(good.points), share, "score:3", "lost:1", "1.5", "1.8", "3.5,", "20", "0.02", "25/49"
    ]  # fmt: skip
    assert second[1:4] == ["-", "-", "failed"]
    assert "texture" not in text
    assert "c0, c1" in " ".join(text.split())
    assert text.count("µm") == 1


def test_a_narrow_terminal_shows_every_cause_and_cuts_no_number(cube, seen):
    every = sample(reject={cause: [int(cause)] for cause in list(Outcome)[1:]})
    f = figures_of("n05_12", every, every.vertices, seen)
    counts = dict.fromkeys(f.rejected, 12345)
    noise, vertices = {"a": 1.5, "b": 1.5, "c": 12.5}, {"seen": 1049, "measured": 25}
    f = replace(f, points=98765, rejected=counts, noise=noise, vertices=vertices)
    text = shown(flow_table([f], cube.rig), width=80)
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    # Columns that have no room go on below, behind the name again.
    rows = [line.split() for line in text.splitlines() if line.startswith(" n05_12")]
    assert rows[0][1] == "98765"
    assert rows[-1][-2:] == ["0.02", "25/1049"]
    assert all(f"{cause.name.lower()[:6]}" in text for cause in list(Outcome)[1:])
    # A count is never broken.
    assert text.count(":12345") == 7


def test_the_document_is_plain_json_with_null_for_what_is_not_known(cube, seen, tmp_path):
    good = figures_of("s1", cube, cube.vertices, seen)
    lost = lost_figures("s2", cube, seen)
    path = tmp_path / "flow.json"
    names = [{"vertices": "s1.csv"}, {}]
    write_flow_document(path, [good, lost], names, cube.rig, {"session": "cube", "notes": []})
    content = json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert (content["format"], content["session"]) == ("palpate-flow/1", "cube")
    assert (content["cameras"], content["reference"]) == (["c0", "c1"], "c0")
    first, second = content["motions"]
    assert first["vertices"] == {"seen": 49, "measured": 25}
    assert first["noise"] == {"c0": 1.5, "c1": 1.75}
    assert first["median_sigma"]["depth"] == pytest.approx(2e-5)
    assert first["rejected"]["score"] == 3
    assert (first["through_last"], first["drift"]) == (0, 3e-6)
    assert first["files"] == {"vertices": "s1.csv"}
    assert (second["failure"], second["points"]) == ("torn picture", 0)
    assert second["median_sigma"] == {"lateral": None, "depth": None}
    assert second["noise"] == {"c0": None, "c1": None}
