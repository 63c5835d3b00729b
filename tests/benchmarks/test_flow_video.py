"""The pictures of the long video belong to its cameras."""

from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates

from benchmarks.flow_video import COLUMNS, NOISE, ROWS, SOURCE, write_video_session
from palpate.records import read_rig, read_session
from palpate.vision import project, read_pictures


def test_enlarged_cameras_see_what_the_given_ones_see(shared_data: Path, tmp_path: Path) -> None:
    names = write_video_session(tmp_path / "video", 3)
    session = read_session(tmp_path / "video")
    assert [step.name for step in session.steps] == names == ["s0000", "s0001", "s0002"]
    small, large = read_rig(SOURCE / "rig.toml"), read_rig(session.rig)
    given = read_pictures(small, "images/rest_{camera}.png", folder=SOURCE, what="rest").grey
    first, folder = session.steps[0], session.path.parent
    made = read_pictures(large, first.images, folder=folder, what=first.name).grey
    top = session.mesh.vertices[session.mesh.vertices[:, 2] > 0.03]
    for c, (before, after) in enumerate(zip(given, made, strict=True)):
        assert after.shape == (ROWS, COLUMNS)
        pixel, enlarged = project(small.cameras[c], top), project(large.cameras[c], top)
        np.testing.assert_allclose(enlarged, 2.0 * pixel + 0.5, rtol=0, atol=1e-9)
        levels = map_coordinates(before, pixel.T[::-1], order=3)
        difference = map_coordinates(after, enlarged.T[::-1], order=3) - levels
        # The noise that was added, and what is lost between pixels; half a pixel off it is 20.
        assert np.sqrt((difference**2).mean()) < 2.0 * NOISE
