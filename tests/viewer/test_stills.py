from itertools import pairwise

import cv2
import numpy as np
import pytest
from cube_session import cube_session as cube_session
from PIL import Image

from palpate.app.cli import main
from palpate.errors import InputError
from palpate.viewer import read_subject, stills, write_screenshot, write_turntable


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


def test_other_kinds_of_files_and_probings_are_refused(subject, tmp_path):
    with pytest.raises(InputError, match=r"\.png"):
        write_screenshot(subject, tmp_path / "cube.tiff")
    with pytest.raises(InputError, match="there are: n01"):
        write_screenshot(subject, tmp_path / "cube.png", probe="n02")
    assert list(tmp_path.glob("cube.*")) == []
