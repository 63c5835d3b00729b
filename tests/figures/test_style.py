"""The style of all pictures: files, pixels, panels."""

import cv2
import matplotlib as mpl
import numpy as np
import pytest

from palpate.figures.style import (
    STYLE,
    figure_pixels,
    magnification_text,
    save_figure,
    save_pixels,
    styled,
    three_panels,
)


def test_pictures_are_written_as_png_without_loss(tmp_path):
    picture = np.random.default_rng(1).integers(0, 256, (12, 9, 4), dtype=np.uint8)
    picture[..., 3] = 255
    save_pixels(picture, tmp_path / "a.png")
    read = cv2.imread(str(tmp_path / "a.png"))
    np.testing.assert_array_equal(read[..., ::-1], picture[..., :3])


def test_a_figure_has_the_same_pixels_in_a_file(tmp_path):
    figure, _ = three_panels(np.array([2.0, 1.0]))
    figure.text(0.5, 0.5, "text")
    read = cv2.imread(str(save_figure(figure, tmp_path / "a.png")))
    np.testing.assert_array_equal(read[..., ::-1], figure_pixels(figure)[..., :3])


@pytest.mark.parametrize(("width", "height", "shown"), [(4.0, 3.0, 4 / 3), (9.0, 1.0, 4.5)])
def test_panels_have_the_proportions_of_what_they_show(width, height, shown):
    figure, panels = three_panels(np.array([width, height]))
    for panel in panels:
        box = panel.get_position()
        size = figure.get_size_inches() * (box.width, box.height)
        # Half a per cent for the gaps between the panels. The flattest panel is 0.6 of 2.7 inches.
        assert size[0] / size[1] == pytest.approx(shown, rel=0.05)


def test_the_style_holds_while_a_figure_is_drawn_and_no_longer():
    before = mpl.rcParams["font.size"]

    @styled
    def size():
        return mpl.rcParams["font.size"]

    assert [size(), size()] == [STYLE["font.size"]] * 2
    assert mpl.rcParams["font.size"] == before != STYLE["font.size"]


@pytest.mark.parametrize(
    ("factor", "text"), [(0.321, "0.32 times"), (9.94, "9.9 times"), (1234.0, "1234 times")]
)
def test_a_magnification_has_two_digits_and_no_exponent(factor, text):
    assert magnification_text(factor) == text
