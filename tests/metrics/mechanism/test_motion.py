"""Grain that moves with the body, and grain that sticks to the screen, of images whose texture is known everywhere."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from ablate.dataset.motion import Motion, motion_of, moved_frames, moved_poses, places_before
from ablate.metrics import MovedPair
from ablate.metrics.motion import after_motion, motion, motion_screen, on_screen
from ablate.ultrasound import ConvexProbe, LinearProbe, PhasedProbe, fan_mask
from ablate.ultrasound.probe import pixel_coordinates_mm

PROBES = [ConvexProbe(), LinearProbe(), PhasedProbe()]
SHAPE, LINES = (180, 240), 128


def texture(x: np.ndarray, z: np.ndarray, seed: int) -> np.ndarray:
    """Smooth noise that is fixed to x and z, mm, of mean 128 and standard deviation 40."""
    random = np.random.default_rng(seed)
    field = gaussian_filter(random.standard_normal((1200, 1200)), 3.0)
    step = 0.25
    values = map_coordinates(field, [(z + 100) / step, (x + 150) / step], order=1, mode="wrap")
    return 128 + 40 * values / field.std()


def grey(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def moved_pair(probe, kind: Motion, sticks: float) -> MovedPair:
    """`sticks` is the share of the variance that belongs to the screen."""
    x, z = np.meshgrid(*pixel_coordinates_mm(probe, SHAPE))
    points = np.stack([x, np.zeros_like(x), z], axis=-1)
    transform = motion_of(kind, probe, LINES)
    before_points = points @ transform[:3, :3].T + transform[:3, 3]
    screen = texture(x, z, 1) - 128
    body = [texture(p[..., 0], p[..., 2], 2) - 128 for p in (points, before_points)]
    images = [128 + np.sqrt(1 - sticks) * field + np.sqrt(sticks) * screen for field in body]
    mask = fan_mask(probe, SHAPE)
    before, after = (grey(image) * mask for image in images)
    places = places_before(kind, probe, LINES, SHAPE)
    return MovedPair(before, after, mask, mask, *places, in_plane=kind is not Motion.lift)


@pytest.mark.parametrize(("probe", "kind"), list(product(PROBES, [Motion.rock, Motion.slide])), ids=str)
def test_grain_of_the_body_is_found_again_and_that_of_the_screen_is_not(probe, kind) -> None:
    belongs, sticks = moved_pair(probe, kind, 0.0), moved_pair(probe, kind, 1.0)
    followed = after_motion(belongs)
    assert followed > 0.93
    assert on_screen(sticks) > 0.999
    assert after_motion(sticks) < followed - 0.1
    assert on_screen(belongs) < 0.999 - 0.1


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_between_them_it_falls_with_the_share_that_sticks(share) -> None:
    """Of independent fields the covariances add, so the correlation lies between those of either alone."""
    belongs, mixed, sticks = ([moved_pair(PROBES[1], kind, part) for kind in Motion] for part in (0.0, share, 1.0))
    for measure in (motion, motion_screen):
        expected = (1 - share) * measure(belongs) + share * measure(sticks)
        assert measure(mixed) == pytest.approx(expected, abs=0.05)
    assert motion(belongs) > motion(mixed) > motion(sticks)
    assert motion_screen(belongs) < motion_screen(mixed) < motion_screen(sticks)


def test_images_without_grain_or_tissue_have_no_value() -> None:
    pair = moved_pair(PROBES[0], Motion.slide, 0.0)
    flat = np.full(SHAPE, 90, np.uint8)
    nothing = replace(pair, before=flat, after=np.zeros_like(flat))
    assert after_motion(nothing) is None or abs(after_motion(nothing)) <= 1
    without = MovedPair(
        pair.before, pair.after, pair.mask, pair.mask & False, pair.rows_before, pair.columns_before, True
    )
    assert motion([without]) is None
    assert motion_screen([without]) is None
    assert motion([]) is None


@pytest.mark.parametrize("probe", PROBES, ids=lambda probe: probe.kind)
def test_a_rocked_probe_sees_two_scanlines_further(probe) -> None:
    """Scanline k after the motion is scanline k + 2 before it, whatever the probe."""
    from ablate.ultrasound.probe import scanlines_in_plane

    starts, directions = (part[0] for part in scanlines_in_plane(probe, LINES, np.zeros(1)))
    transform = motion_of(Motion.rock, probe, LINES)
    np.testing.assert_allclose((starts @ transform[:3, :3].T + transform[:3, 3])[:-2], starts[2:], atol=1e-9)
    np.testing.assert_allclose((directions @ transform[:3, :3].T)[:-2], directions[2:], atol=1e-12)


def test_poses_after_every_motion_stand_pose_by_pose() -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, 0, 3] = 7.0
    moved, motions = moved_poses(poses, PROBES[0], LINES)
    assert motions == (*Motion, *Motion)
    assert moved.shape == (6, 4, 4)
    np.testing.assert_allclose(moved[3:, :3, 3] - moved[:3, :3, 3], [[7.0, 0, 0]] * 3, atol=1e-12)
    assert len(moved_frames(np.arange(100, 148))) == 8
    assert moved_frames(np.array([5, 9])).tolist() == [5]
