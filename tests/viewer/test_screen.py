"""Where a click on the picture of all images is: a cross that is drawn there is found on it again."""

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from ablate.ultrasound import ConvexProbe, SimulatorSettings, fan_mask
from ablate.viewer.pictures import Sides, Window
from ablate.viewer.screen import Layout, Shown, point_at, screen
from ablate.viewer.session import Quality, ViewerState, Views

SHAPE = (256, 355)
POINT = np.array([14.0, 82.0])


def views_of(quality: Quality, runs: int = 0) -> Views:
    mask = fan_mask(ConvexProbe(), SHAPE)
    folders = tuple(Path(f"run {number}") for number in range(runs))
    return Views(
        state=ViewerState(np.eye(4), ConvexProbe(), SimulatorSettings(image_shape=SHAPE), runs=folders),
        target=np.zeros(SHAPE, np.uint8),
        segmentation=mask.astype(np.uint8),
        attenuation=np.zeros(SHAPE, np.float32),
        mask=mask,
        generated=(np.zeros(SHAPE, np.uint8),) * runs,
        ms={"target": 1.0, "maps": 1.0} | {f"generated {number}": 1.0 for number in range(runs)},
        notes={},
        quality=quality,
    )


@pytest.mark.parametrize("quality", list(Quality))
@pytest.mark.parametrize(
    ("shown", "runs", "images"), [(Shown.all, 0, 4), (Shown.all, 2, 5), (Shown.pair, 1, 2), (Shown.bmode, 1, 1)]
)
@pytest.mark.parametrize("window", [Window(), Window(2.5, (0.55, 0.5), Sides.swapped), Window(1.5, (0.0, 1.0))])
def test_a_click_on_a_cross_is_the_point_that_it_marks(
    quality: Quality, shown: Shown, runs: int, images: int, window: Window
) -> None:
    views = views_of(quality, runs)
    layout = Layout(points=np.array([[POINT[0], 0.0, POINT[1]]]), shown=shown, window=window)
    picture = screen(views, [(0.0, 0.0, 0.6)], layout).astype(int)
    yellow = (picture[..., 0] > 200) & (picture[..., 1] > 180) & (picture[..., 2] < 90)
    labels, count = ndimage.label(yellow)
    assert count == images
    for row, column in ndimage.center_of_mass(yellow, labels, range(1, count + 1)):
        place = (column + 0.5) / picture.shape[1], (row + 0.5) / picture.shape[0]
        found = point_at(views, layout, place)
        assert found is not None
        np.testing.assert_allclose(found, POINT, atol=0.8)
    assert point_at(views, layout, (0.5, 0.001)) is None, "a title"


def test_the_first_scanline_is_on_the_other_side_when_sides_are_swapped() -> None:
    views = views_of(Quality.full)
    half = np.where(np.arange(SHAPE[1]) < SHAPE[1] // 2, np.uint8(200), np.uint8(20)) * views.mask
    object.__setattr__(views, "target", half)
    for sides in Sides:
        picture = screen(views, [(0.0, 0.0, 0.6)], Layout(shown=Shown.bmode, window=Window(sides=sides)))
        row = picture[picture.shape[0] // 2, :, 0].astype(int)
        left, right = row[: len(row) // 2].sum(), row[len(row) // 2 :].sum()
        assert (left > right) == (sides is Sides.kept)


def test_one_image_is_larger_than_four_of_the_same_width() -> None:
    views = views_of(Quality.full)
    heights = {}
    for shown in Shown:
        picture = screen(views, [(0.0, 0.0, 0.6)], Layout(shown=shown))
        heights[shown] = picture.shape[0] / picture.shape[1]
    assert heights[Shown.bmode] == pytest.approx(heights[Shown.all], rel=0.02)
    assert heights[Shown.pair] == pytest.approx(2 * heights[Shown.bmode], rel=0.02)
