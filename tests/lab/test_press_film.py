"""Films of presses: what a frame shows has moved by what was solved."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fault_injection import largest_file
from scipy.ndimage import spline_filter

from palpate.errors import RecordError
from palpate.lab.press_film import _warped, write_film
from palpate.vision import video_frames


@pytest.mark.parametrize("most", [0.05, 0.3])
def test_films_move_by_what_was_solved(most: float) -> None:
    """Tenths of a pixel, which a remap that rounds places makes a tenth longer.

    What a ramp shows is how far it has gone.
    """
    ramp = np.tile(np.arange(160.0, dtype=np.float32), (80, 1))
    motion = np.zeros((20, 40, 2), dtype=np.float32)
    motion[..., 0] = most * np.linspace(-1.0, 1.0, 40)
    gone = ramp - _warped(spline_filter(ramp, order=5, output=np.float32), motion)
    # A sample is every fourth pixel of the doubled picture, from its first half pixel on; the
    # field itself stretches by its gradient, 0.75 % at most.
    expected = 2.0 * most * (-1.0 + 2.0 * ((np.arange(160) - 0.5) / 4.0) / 39.0)
    inner = np.s_[20:-20, 20:-20]
    np.testing.assert_allclose(
        gone[inner], np.tile(expected, (80, 1))[inner], atol=0.01 * 2.0 * most
    )


def noisy_frames(count: int) -> Iterator[np.ndarray]:
    """Frames that no codec makes much smaller."""
    rng = np.random.default_rng(0)
    return (rng.integers(0, 256, size=(120, 160), dtype=np.uint8) for _ in range(count))


def test_a_film_gives_its_frames_back(tmp_path: Path) -> None:
    write_film(tmp_path / "c0.avi", noisy_frames(12), 30.0)
    frames = [grey for _, grey in video_frames(tmp_path / "c0.avi")]
    # FFV1 is lossless; half a grey level is lost on the way through the colours of the codec.
    for grey, frame in zip(frames, noisy_frames(12), strict=True):
        assert np.abs(grey.astype(int) - frame).max() <= 1


# In the middle of the film; and where only its index, the very end, is missing, so that OpenCV says
# of every frame that it was written.
@pytest.mark.parametrize("missing", [0.5, 0.001])
def test_a_film_on_a_full_disk_is_refused(tmp_path: Path, missing: float) -> None:
    whole, path = tmp_path / "whole.avi", tmp_path / "c0.avi"
    write_film(whole, noisy_frames(12), 30.0)
    with (
        largest_file(int((1.0 - missing) * whole.stat().st_size)),
        pytest.raises(RecordError, match=r"c0\.avi: the film could not be written completely"),
    ):
        write_film(path, noisy_frames(12), 30.0)
    assert not path.exists()


def test_a_frame_of_another_size_is_refused(tmp_path: Path) -> None:
    frames = [np.zeros((120, 160), dtype=np.uint8), np.zeros((60, 160), dtype=np.uint8)]
    with pytest.raises(RecordError, match="that all frames are of one size"):
        write_film(tmp_path / "c0.avi", iter(frames), 30.0)
