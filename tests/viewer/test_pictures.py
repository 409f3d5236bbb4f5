"""Where marks and colours are drawn, against the probe's own geometry."""

import numpy as np
import pytest
from PIL import Image

from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.viewer.pictures import (
    difference_picture,
    framed,
    label_at,
    label_picture,
    mark,
    share_picture,
)
from ablate.viewer.screen import _mosaic
from ablate.viewer.session import Quality

PROBE = ConvexProbe()
SHAPE = (384, 532)
MASK = fan_mask(PROBE, SHAPE)


def middle(picture: Image.Image) -> tuple[int, ...]:
    colour = picture.getpixel((picture.width // 2, picture.height // 2))
    assert isinstance(colour, tuple)
    return colour


def test_grey_levels_and_colours_are_those_of_the_maps() -> None:
    assert middle(framed(np.full(SHAPE, 90, np.uint8), MASK, PROBE)) == (90, 90, 90)
    labels = np.where(MASK, np.uint8(2), np.uint8(0))
    assert middle(label_picture(labels, [(0, 0, 0), (1.0, 0.2, 0.0)], PROBE, Quality.full)) == (255, 51, 0)
    small = fan_mask(PROBE, (256, 355))
    halves = np.where(np.arange(355) < 177, np.uint8(1), np.uint8(3)) * small
    colours = label_picture(
        halves, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], PROBE, Quality.full
    ).getcolors()
    assert colours is not None
    assert (0, 255, 0) not in {colour for _, colour in colours}, "no tissue between two others"
    bright, dark = (np.sum(middle(share_picture(np.full(SHAPE, v), MASK, PROBE, Quality.full))) for v in (1.0, 0.05))
    assert bright > dark
    beside = share_picture(np.ones(SHAPE), MASK, PROBE, Quality.full).getpixel((2, SHAPE[0] - 2))
    assert beside == (0, 0, 0), "outside the fan"


def test_a_difference_is_red_where_the_first_is_brighter_and_blue_where_the_second_is() -> None:
    low, high = np.full(SHAPE, 20, np.uint8), np.full(SHAPE, 200, np.uint8)
    red, _, blue = middle(difference_picture(high, low, MASK, PROBE, Quality.full))
    assert red > blue
    red, _, blue = middle(difference_picture(low, high, MASK, PROBE, Quality.full))
    assert red < blue
    assert min(middle(difference_picture(low, low, MASK, PROBE, Quality.full))) > 240


def test_ticks_of_the_scale_lie_ten_millimetres_apart() -> None:
    picture = np.asarray(framed(np.zeros(SHAPE, np.uint8), MASK, PROBE))
    rows = np.flatnonzero(picture[:, 2].any(axis=-1))
    assert len(rows) == 16  # 0 to 150 mm
    assert np.diff(rows).mean() == pytest.approx(10 * SHAPE[0] / 157.23, rel=0.02)
    assert rows[0] == pytest.approx(7.23 / 157.23 * SHAPE[0], abs=1)


def test_a_cross_lies_where_the_label_of_its_point_is_read() -> None:
    """A labelled pixel is marked at its centre; the yellow of the cross is on the same pixel."""
    labels = np.zeros(SHAPE, np.uint8)
    row, column = 250, 300
    labels[row, column] = 7
    x = (column + 0.5) * 217.96 / SHAPE[1] - 217.96 / 2
    z = (row + 0.5) * 157.23 / SHAPE[0] - 7.23
    assert label_at(labels, np.array([x, z]), PROBE) == 7
    assert label_at(labels, np.array([1e4, z]), PROBE) == 0
    picture = Image.new("RGB", SHAPE[::-1])
    mark(picture, np.array([[x, z]]), PROBE)
    yellow = np.argwhere(np.asarray(picture).any(axis=-1)).mean(axis=0)
    np.testing.assert_allclose(yellow, (row, column), atol=1.5)


def test_a_distance_is_written_beside_its_second_point() -> None:
    bare, marked = (Image.new("RGB", SHAPE[::-1]) for _ in range(2))
    points = np.array([[-30.0, 60.0], [10.0, 60.0]])
    mark(bare, points[:1], PROBE)
    mark(bare, points[1:], PROBE)
    mark(marked, points, PROBE)
    added = np.argwhere((np.asarray(marked) != np.asarray(bare)).any(axis=-1))
    second = SHAPE[1] / 2 + 10 / 217.96 * SHAPE[1]
    assert second + 40 < added[:, 1].max() < second + 120, "letters to the right of the second cross"
    assert np.ptp(added[:, 0]) > 8, "and not the line alone"


def test_narrow_images_stand_in_the_middle_of_cells_that_are_wider_than_high() -> None:
    bright = Image.new("RGB", (300, 400), "white")
    picture = _mosaic([("a", "", bright)] * 4)
    assert picture.shape[1] / picture.shape[0] > 1.1, "all four are seen at once"
    columns = np.flatnonzero((picture[200] == 255).all(axis=-1))
    assert len(columns) == 2 * 300
    assert columns[0] == 100, "500 wide, half of the margin on either side"
    wide = _mosaic([("a", "", Image.new("RGB", (600, 400), "white"))])
    assert (wide[200, :600] == 255).all()


def test_a_picture_of_a_moving_probe_is_a_smaller_one_of_the_same_layout() -> None:
    """Shown in the same width, nothing in it moves when the probe comes to rest."""
    image = np.zeros(SHAPE, np.uint8)
    full, coarse = (framed(image, MASK, PROBE, quality) for quality in (Quality.full, Quality.coarse))
    assert (coarse.height, coarse.width) == (SHAPE[0] * 2 // 3, round(SHAPE[1] * 2 / 3))
    marks = [np.argwhere(np.asarray(picture)[..., 1] > 100) / picture.height for picture in (full, coarse)]
    np.testing.assert_allclose(marks[0].max(axis=0), marks[1].max(axis=0), atol=0.01)
    sheets = [_mosaic([("title", "note", picture)] * 4).shape for picture in (full, coarse)]
    assert sheets[1][1] / sheets[1][0] == pytest.approx(sheets[0][1] / sheets[0][0], rel=0.003)
