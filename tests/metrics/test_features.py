"""The texture descriptor sorts textures as an eye does."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.feature import local_binary_pattern

from ablate.metrics import FEATURE_NAMES, frechet_distance, speckle_features
from ablate.metrics.features import _local_binary_patterns


@pytest.fixture(scope="module")
def frames(make_frame):
    return {k: np.stack([make_frame(2 * i + k).image for i in range(8)]) for k in (0, 1)}


def test_shape_order_and_determinism(make_frame, frames):
    mask = make_frame(0).mask
    features = speckle_features(frames[0], mask)
    assert features.shape[1] == len(FEATURE_NAMES) == 35
    assert np.isfinite(features).all()
    np.testing.assert_array_equal(features, speckle_features(frames[0], mask))
    patches = len(features) // 8
    np.testing.assert_array_equal(features[patches : 2 * patches], speckle_features(frames[0][1:2], mask))


def test_known_features():
    image = np.full((1, 48, 48), 96, np.uint8)
    values = dict(zip(FEATURE_NAMES, speckle_features(image)[0], strict=True))
    assert values["mean"] == values["quantile_50"] == pytest.approx(2.0)
    assert values["gradient_axial"] == values["correlation_lateral_1px"] == 0
    assert values["lbp_8"] == pytest.approx(5.0)
    stripes = np.tile(np.array([[0], [200]], np.uint8), (24, 48))[None]
    values = dict(zip(FEATURE_NAMES, speckle_features(stripes)[0], strict=True))
    assert values["correlation_axial_1px"] == pytest.approx(-1 / 0.4, rel=0.03)
    assert values["correlation_axial_2px"] == pytest.approx(1 / 0.4, rel=0.05)
    assert values["gradient_lateral"] == 0
    assert values["band_axial_3"] > values["band_lateral_3"] + 3


def test_local_binary_patterns_are_scikit_images():
    image = np.random.default_rng(0).integers(0, 256, (40, 50)).astype(np.uint8)
    ours = _local_binary_patterns(image)[1:-1, 1:-1]
    # scikit-image interpolates the diagonals of a circle; a loop over the 3 x 3 window does not.
    circle = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))
    theirs = np.zeros_like(ours)
    for i in range(1, 39):
        for j in range(1, 49):
            ring = [image[i + a, j + b] for a, b in circle]
            signs = [int(v >= image[i, j]) for v in ring]
            changes = sum(signs[k] != signs[k - 1] for k in range(8))
            theirs[i - 1, j - 1] = sum(signs) if changes <= 2 else 9
    np.testing.assert_array_equal(ours, theirs)
    smooth = np.add.outer(np.arange(30), np.arange(30)).astype(np.uint8)
    reference = local_binary_pattern(smooth, 8, 1, "uniform")
    np.testing.assert_array_equal(_local_binary_patterns(smooth)[2:-2, 2:-2], reference[2:-2, 2:-2])


def test_distance_orders_textures(make_frame, frames):
    """Other speckle < slight blur < strong blur; and other speckle < another level."""
    mask = make_frame(0).mask
    target = speckle_features(frames[0], mask)

    def distance(images):
        return frechet_distance(speckle_features(images * mask, mask), target)

    resimulated = distance(frames[1])
    blurred = [distance(gaussian_filter(frames[1], (0, s, s))) for s in (1.0, 3.0)]
    brighter = distance(np.minimum(frames[1], 215) + np.uint8(40))
    assert resimulated > 0
    assert 10 * resimulated < blurred[0] < blurred[1]
    assert 10 * resimulated < brighter


def test_what_has_no_texture_is_refused():
    for shape, mask in (((1, 50, 50), np.zeros((50, 50), bool)), ((1, 40, 40), None)):
        with pytest.raises(ValueError, match="no patch"):
            speckle_features(np.zeros(shape, np.uint8), mask)


def test_masks_of_another_shape_and_grey_levels_of_another_type_are_refused(frames):
    for images, mask in ((frames[0], np.ones((50, 50), bool)), (frames[0] / 255, None)):
        with pytest.raises(ValueError, match=r"images must be \(n, H, W\) uint8 and the mask \(H, W\), got"):
            speckle_features(images, mask)
