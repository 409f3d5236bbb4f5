"""Between beam space and pixels, against closed forms of each probe's geometry and nearest neighbours one by one."""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import Probe, ScanConverter, Simulator, SimulatorSettings
from ablate.ultrasound.probe import position_maps, square_pixels
from support.fans import CONVEX, KINDS, across_and_depth, pixels, place

ROWS, LINES = 61, 48
ACROSS = np.linspace(-1, 1, LINES)


def made(probe: Probe, rows: int = 150) -> tuple[ScanConverter, np.ndarray, np.ndarray, np.ndarray]:
    """A converter; place across, -1 to 1, and depth of its pixels, mm; and depths of its rows."""
    shape = square_pixels(probe, rows)
    depths = (np.arange(ROWS) + 0.5) * probe.depth_mm / ROWS
    return ScanConverter(probe, (ROWS, LINES), shape), *across_and_depth(probe, *pixels(probe, shape)), depths


@KINDS
def test_what_is_linear_in_beam_space_is_so_in_the_image(probe) -> None:
    """In depth and in the place of the scanline; before the first and behind the last row it stays as there."""
    converter, across, depth, depths = made(probe)
    beam = (3 * depths[:, None] + 7 * ACROSS).astype(np.float32)
    expected = np.where(converter.mask, 3 * np.clip(depth, depths[0], depths[-1]) + 7 * across, 0)
    np.testing.assert_allclose(converter.to_image(beam), expected, atol=1e-3)
    twice = converter.to_image(np.stack([beam, -beam]))
    np.testing.assert_allclose(twice, [expected, -expected], atol=1e-3)
    grey = np.random.default_rng(0).integers(0, 256, beam.shape, np.uint8)
    exact = converter.to_image(grey.astype(np.float32))
    assert np.abs(converter.to_image(grey) - exact).max() <= 0.5 + 1e-4, "bytes are rounded"


@KINDS
def test_a_label_is_that_of_the_nearest_sample(probe) -> None:
    converter, across, depth, depths = made(probe)
    labels = np.random.default_rng(0).integers(1, 255, (ROWS, LINES), np.uint8)
    in_rows, in_lines = (np.abs(np.subtract.outer(a, b)) for a, b in ((depth, depths), (across, ACROSS)))
    expected = np.where(converter.mask, labels[in_rows.argmin(axis=-1), in_lines.argmin(axis=-1)], 0)
    sure = (np.diff(np.sort(in_rows)[..., :2]) > 1e-4)[..., 0] & (np.diff(np.sort(in_lines)[..., :2]) > 1e-6)[..., 0]
    assert sure.mean() > 0.95
    np.testing.assert_array_equal(converter.labels_to_image(labels)[sure], expected[sure])


@pytest.mark.parametrize("beam_shape", [(ROWS, LINES), (1, LINES), (ROWS, 1), (1, 1)])
@KINDS
def test_a_constant_fills_the_fan(probe, beam_shape) -> None:
    converter = ScanConverter(probe, beam_shape, (40, 56))
    for dtype in (np.uint8, np.float32):
        beam = np.full(beam_shape, 200, dtype)
        for image in (converter.to_image(beam), converter.labels_to_image(beam.astype(np.uint8))):
            np.testing.assert_array_equal(image, np.where(converter.mask, 200, 0))
        np.testing.assert_allclose(converter.to_beam(converter.to_image(beam)), beam, rtol=1e-6)


@KINDS
def test_samples_of_an_image_are_those_of_its_pixels(probe) -> None:
    """Values that are linear in x and z are reproduced; a label is that of the nearest pixel, and one of the fan."""
    converter, _, _, depths = made(probe)
    x, z = pixels(probe, converter.image_shape)
    at_x, at_z = place(probe, ACROSS, depths[:, None])
    inner = slice(3, -3), slice(3, -3)
    found = converter.to_beam((100 + x + 2 * z).astype(np.float32))
    np.testing.assert_allclose(found[inner], (100 + at_x + 2 * at_z)[inner], atol=1e-3)
    labels = np.random.default_rng(0).integers(1, 255, converter.image_shape, np.uint8)
    nearest = labels[np.abs(at_z[..., None] - z[:, 0]).argmin(axis=-1), np.abs(at_x[..., None] - x).argmin(axis=-1)]
    found = converter.labels_to_beam(np.where(converter.mask, labels, 0))
    np.testing.assert_array_equal(found[inner], nearest[inner])
    assert found.min() > 0


@KINDS
def test_a_frame_is_that_of_its_beam_and_labels_are_those_of_the_places(probe, ball, slab, gel, ahead) -> None:
    settings = SimulatorSettings.low_quality(scanlines=LINES, axial_samples=1000, image_shape=square_pixels(probe, 99))
    scene = Scene((slab(Tissue("t"), 40.0, 300.0), ball(Tissue("b", 1540, 1.6, 2.0), (4.0, 0.0, 60.0), 9.0)), gel, "s")
    simulator = Simulator(scene, probe, settings)
    frame, converter = simulator.render(ahead), ScanConverter(probe, settings.beam_shape, settings.image_shape)
    np.testing.assert_array_equal(frame.image, converter.to_image(frame.beam.image))
    np.testing.assert_array_equal(frame.attenuation, converter.to_image(frame.beam.attenuation))
    np.testing.assert_array_equal(frame.beam.image, simulator.beam_image(ahead))
    samples = place(probe, ACROSS, (np.arange(500)[:, None] + 0.5) * probe.depth_mm / 500)
    cases = ((frame.beam.segmentation, *samples, 0.1), (frame.segmentation, *pixels(probe, settings.image_shape), 0.02))
    for labels, x, z, unsure_mm in cases:
        from_ball = np.hypot(x - 4, z - 60)
        expected = np.where(from_ball < 9, 3, np.where(z + 0 * x > 40, 2, 1))
        sure = (labels > 0) & (np.abs(z - 40) > unsure_mm) & (np.abs(from_ball - 9) > unsure_mm)
        np.testing.assert_array_equal(labels[sure], expected[sure])


@KINDS
def test_maps_of_position_agree_in_both_spaces(probe) -> None:
    converter, across, depth, depths = made(probe)
    of_beam, of_image = (position_maps(probe, shape, (ROWS, LINES)) for shape in (None, converter.image_shape))
    expected = {"depth": 2 * depth / probe.depth_mm - 1, "lateral": across}
    for name, values in expected.items():
        np.testing.assert_allclose(of_image[name], np.where(converter.mask, values, 0), atol=1e-6)
        between = converter.mask & (depth > depths[0]) & (depth < depths[-1])
        np.testing.assert_allclose(converter.to_image(of_beam[name])[between], of_image[name][between], atol=1e-5)


def test_a_row_is_the_mean_grey_level_of_its_samples(slab, gel, ahead) -> None:
    scene = Scene((slab(Tissue("t"), 20.0, 300.0),), gel, "s")
    settings = SimulatorSettings.low_quality(scanlines=16, axial_samples=500, samples_per_row=1, image_shape=(9, 9))
    fine = Simulator(scene, CONVEX, settings).beam_image(ahead).astype(float)
    for each in (2, 5):
        rows = Simulator(scene, CONVEX, replace(settings, samples_per_row=each)).beam_image(ahead)
        means = [fine[first : first + each].mean(axis=0) for first in range(0, 500, each)]
        assert np.abs(rows - means).max() <= 1
    with pytest.raises(ValueError, match="axial_samples=500: allowed are multiples of samples_per_row=3"):
        replace(settings, samples_per_row=3)  # the last row would lie at another depth than the pixels take it from


def test_a_row_that_is_longer_than_a_scanline_has_the_label_of_its_middle(slab, gel, ahead) -> None:
    scene = Scene((slab(Tissue("t"), 0.45 * CONVEX.depth_mm, 0.55 * CONVEX.depth_mm),), gel, "s")
    settings = SimulatorSettings.low_quality(scanlines=8, axial_samples=100, image_shape=(9, 9))
    for each in (100, 150, 1000):
        rows = Simulator(scene, CONVEX, replace(settings, samples_per_row=each)).beam_maps(ahead).segmentation
        assert (rows[0, 4], rows.shape) == (2, (1, 8))


def test_labels_of_another_type_than_bytes_are_refused() -> None:
    converter = ScanConverter(CONVEX, (64, 32), (48, 66))
    with pytest.raises(ValueError, match="labels: allowed are uint8, not int64"):
        converter.labels_to_image(np.full((64, 32), 300))


def test_an_array_of_another_shape_is_refused() -> None:
    """Compiled code does not look where an array ends: it would show other memory as an image."""
    converter = ScanConverter(CONVEX, (64, 32), (48, 66))
    for shape in ((32, 32), (64, 16), (32, 64), (100, 100), (64 * 32,)):
        for convert in (converter.to_image, converter.labels_to_image):
            with pytest.raises(ValueError, match=r"must be \(64, 32\), got"):
                convert(np.zeros(shape, np.uint8))
    for shape in ((24, 33), (96, 132), (66, 48), (1, 48, 66)):
        for convert in (converter.to_beam, converter.labels_to_beam):
            with pytest.raises(ValueError, match=r"must be \(48, 66\), got"):
                convert(np.zeros(shape, np.uint8))
    assert converter.to_image(np.zeros((3, 64, 32))).shape == (3, 48, 66)
