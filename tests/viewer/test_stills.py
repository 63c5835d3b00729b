from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from cube_session import cube_session as cube_session
from estimate_samples import sample_result
from fault_injection import largest_file
from PIL import Image

from palpate.app.cli import main
from palpate.errors import InputError, RecordError
from palpate.pipeline import FittedSurface
from palpate.records import read_session
from palpate.viewer import read_subject, stills, write_screenshot, write_turntable
from palpate.viewer.subject import Subject, shown_probings


@pytest.fixture
def subject(cube_session):
    return read_subject(cube_session)


def test_a_picture_shows_the_object(cube_session, tmp_path, capsys):
    assert main(["view", str(cube_session), "--screenshot", str(tmp_path / "cube.png")]) == 0
    pixels = np.asarray(Image.open(tmp_path / "cube.png").convert("RGB"), dtype=int)
    # It stands in the middle, grey before white, with coloured points.
    assert pixels[len(pixels) // 2, pixels.shape[1] // 2].max() < 250
    assert (np.ptp(pixels, axis=2) > 60).sum() > 200
    assert (pixels.min(axis=2) > 250).mean() > 0.3


def drawn_by_the_model(cube_session):
    """The cube, sheared along z by a quarter of x."""
    session = read_session(cube_session)
    estimate = sample_result(session).estimate
    (plain,) = shown_probings(Subject(session, None, None, None))
    moved = np.zeros_like(session.mesh.vertices)
    moved[:, 2] = -0.25 * session.mesh.vertices[:, 0]
    fitted = replace(plain, predicted=plain.displacement, surface=moved)
    mesh = session.mesh
    surface = FittedSurface(
        session.name, mesh.vertices, mesh.triangles, session.held_triangles, (fitted,),
        sample_result(session).likelihood,
    )  # fmt: skip
    return Subject(session, estimate, surface, None)


def test_different_displacements_have_different_colours(cube_session, tmp_path):
    write_screenshot(drawn_by_the_model(cube_session), tmp_path / "cube.png")
    pixels = np.asarray(Image.open(tmp_path / "cube.png").convert("RGB"), dtype=int)
    # Of the body, not of the scale below it.
    red, green, blue = pixels[: int(0.87 * len(pixels))].transpose(2, 0, 1)
    yellow = (green > 2 * blue) & (red > 0.9 * green)
    turquoise = (green > 1.2 * red) & (green > 1.05 * blue)
    assert yellow.sum() < turquoise.sum()


def test_a_long_object_fills_the_picture(tmp_path):
    beam = Path(__file__).parents[2] / "examples" / "beam"
    write_screenshot(read_subject(beam), tmp_path / "beam.png")
    pixels = np.asarray(Image.open(tmp_path / "beam.png").convert("RGB"), dtype=int)
    # Between name and scale.
    part = pixels[len(pixels) // 10 : int(0.87 * len(pixels))]
    columns = np.flatnonzero((part.min(axis=2) < 240).any(axis=0))
    assert 0.75 < np.ptp(columns) / pixels.shape[1] < 0.98


@pytest.mark.parametrize("name", ["turn.gif", "turn.mp4"])
def test_a_film_turns_the_object(subject, tmp_path, monkeypatch, name):
    monkeypatch.setattr(stills, "_VIEWS", 4)
    write_turntable(subject, tmp_path / name)
    film = cv2.VideoCapture(str(tmp_path / name))
    views = []
    while (read := film.read())[0]:
        views.append(read[1].astype(float))
    assert len(views) == 4
    # A cube looks much the same after a quarter of a turn, its points do not.
    assert min(np.abs(a - b).mean() for a, b in pairwise(views)) > 0.3
    assert sorted(path.name for path in tmp_path.glob("turn*")) == [name]


# In the middle; and of an MP4 where only the very end is missing, with the table of its pictures.
@pytest.mark.parametrize(
    ("name", "missing", "said"),
    [
        ("turn.mp4", 0.5, "0 of the film's 4 pictures were written"),
        ("turn.mp4", 0.01, "0 of the film's 4 pictures were written"),
        ("turn.gif", 0.5, "File too large"),
    ],
)
def test_a_film_on_a_full_disk_is_refused(subject, tmp_path, monkeypatch, name, missing, said):
    monkeypatch.setattr(stills, "_VIEWS", 4)
    whole, path = tmp_path / f"whole-{name}", tmp_path / name
    write_turntable(subject, whole)
    path.write_bytes(b"an older film")
    with (
        largest_file(int((1.0 - missing) * whole.stat().st_size)),
        pytest.raises(RecordError, match=rf"{name}: cannot be written \({said}"),
    ):
        write_turntable(subject, path)
    assert path.read_bytes() == b"an older film"
    assert sorted(file.name for file in tmp_path.glob("*turn*")) == [name, whole.name]


def test_other_kinds_of_files_and_probings_are_refused(subject, tmp_path):
    with pytest.raises(InputError, match=r"\.png"):
        write_screenshot(subject, tmp_path / "cube.tiff")
    with pytest.raises(InputError, match="there are: n01"):
        write_screenshot(subject, tmp_path / "cube.png", probe="n02")
    assert list(tmp_path.glob("cube.*")) == []
