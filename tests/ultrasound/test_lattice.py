"""The lattice of scatterers belongs to the body, is white, and is what the simulator's speckle is made of."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ablate.anatomy import Scene, Structure, Tissue, load_tissues
from ablate.ultrasound import ConvexProbe, LinearProbe, PhasedProbe, Simulator, SimulatorSettings, grain
from ablate.ultrasound.imaging import scatterers

SETTINGS = SimulatorSettings(scanlines=24, axial_samples=300, rays=2, layers=3, image_shape=(60, 80))
PROBES = [ConvexProbe(frequency_mhz=3.0), LinearProbe(), PhasedProbe()]
DENSE = Tissue("dense", attenuation_db_cm_mhz=0.0, scatterer_density=0.6, scatterer_sd=1.0)


def rigid(seed: int, reach_mm: float = 80.0) -> np.ndarray:
    random = np.random.default_rng(seed)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    pose[:3, 3] = random.uniform(-reach_mm, reach_mm, 3)
    return pose


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Modulus of the complex correlation."""
    return float(abs(np.vdot(a, b)) / np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real))


@pytest.mark.parametrize("probe", PROBES, ids=lambda probe: probe.kind)
@pytest.mark.parametrize("seed", range(5))
def test_a_body_that_moves_with_the_probe_has_the_same_grain_to_the_bit(probe, seed) -> None:
    pose, motion = rigid(seed), rigid(seed + 100)
    still = grain(pose, probe, SETTINGS, seed=4)
    np.testing.assert_array_equal(grain(motion @ pose, probe, SETTINGS, seed=4, body=motion), still)
    assert correlation(grain(motion @ pose, probe, SETTINGS, seed=4), still) < 0.05


def test_a_scene_that_is_moved_takes_its_scatterers_along() -> None:
    """Frames differ by the amplifier's noise alone, which is drawn anew at each pose; here it is far below."""
    settings = replace(SETTINGS, noise_level_db=-200.0, plan="full")
    scene = Scene((Structure(trimesh.creation.box((400, 400, 400)), load_tissues()["liver"]),), DENSE, "block")
    pose, motion = np.eye(4), rigid(7)
    frame = Simulator(scene, PROBES[0], settings).render(pose, seed=2)
    moved = Simulator(scene.moved(motion), PROBES[0], settings).render(motion @ pose, seed=2)
    np.testing.assert_array_equal(moved.beam.grain, frame.beam.grain)
    apart = np.abs(moved.beam.image.astype(int) - frame.beam.image)
    assert apart.mean() < 0.2
    elsewhere = Simulator(Scene(scene.moved(motion).structures, DENSE, "block"), PROBES[0], settings)
    assert np.abs(elsewhere.render(motion @ pose, seed=2).beam.image.astype(int) - frame.beam.image).mean() > 5


@pytest.mark.parametrize("probe", PROBES, ids=lambda probe: probe.kind)
def test_grain_is_white_noise_of_unit_power(probe) -> None:
    wide = replace(SETTINGS, scanlines=64, axial_samples=600, scatterer_pitch_mm=0.02)
    values = grain(rigid(1), probe, wide, seed=3)
    assert values.shape == (300, 64, 2)
    assert values.dtype == np.complex64
    assert np.mean(np.abs(values) ** 2) == pytest.approx(1.0, abs=0.03)
    assert np.mean(values.real**2) == pytest.approx(0.5, abs=0.03)
    for first, second in ((values[1:], values[:-1]), (values[:, 1:], values[:, :-1]), (values[..., 0], values[..., 1])):
        assert correlation(first, second) < 0.03
    assert correlation(values, grain(rigid(1), probe, wide, seed=4)) < 0.03


@pytest.mark.parametrize("each", [1, 2, 3, 5])
def test_a_row_has_two_values_however_many_samples_it_is(each) -> None:
    fine = replace(SETTINGS, samples_per_row=2)
    settings = replace(SETTINGS, samples_per_row=each)
    samples = grain(np.eye(4), PROBES[0], fine, seed=1).transpose(1, 0, 2).reshape(24, 300)  # two samples a row
    values = grain(np.eye(4), PROBES[0], settings, seed=1)
    assert values.shape == (*settings.beam_shape, 2)
    half = -(-each // 2)
    of_rows = samples.reshape(24, -1, each)
    expected = np.stack([of_rows[..., :half].sum(-1), of_rows[..., each - half :].sum(-1)], -1) / np.sqrt(half)
    np.testing.assert_allclose(values, expected.transpose(1, 0, 2), atol=1e-6)


def test_grain_is_the_sum_that_its_definition_says() -> None:
    """One scanline computed in whole numbers of Python, as the hash is defined."""
    settings = replace(SETTINGS, scanlines=1, axial_samples=40, layers=2)
    pose = np.eye(4)
    pose[:3, 3] = 3.25, -8.5, 1.75
    from_corner = 0.1 * np.array([0.37, 0.43, 0.31])  # of a cell, to the body's origin
    offsets = (-settings.layer_extent_mm, settings.layer_extent_mm)
    depths = (np.arange(40) + 0.5) * 150.0 / 40
    white = scatterers.white_table()
    expected = np.zeros(40, complex)
    for offset in offsets:  # of equal weight, and their squares sum to 1
        for sample, depth in enumerate(depths):
            mixed = int(scatterers.mix_seed(9))
            point = np.array([3.25, -8.5 + offset, 1.75 + depth]) + from_corner
            for value, factor in zip(point, (0x1B873593, 0x2545F491, 0x27D4EB2F), strict=True):
                cell = int(np.floor(np.float32(value) * np.float32(1 / 0.1)))
                mixed ^= (cell % 2**32 * factor) % 2**32
            for shift, factor in ((15, 0x2C1B3C6D), (12, 0x297A2D39)):
                mixed = (mixed ^ (mixed >> shift)) * factor % 2**32
            expected[sample] += white[(mixed ^ (mixed >> 15)) % len(white)] / np.sqrt(2)
    np.testing.assert_allclose(grain(pose, PROBES[0], settings, seed=9)[:, 0].ravel(), expected, atol=1e-5)


@pytest.mark.parametrize("tissue", [t for t in load_tissues().values() if t.scatter_power], ids=lambda t: t.name)
def test_tissues_keep_their_distribution_and_share_the_lattice(tissue) -> None:
    """Quantiles of the amplitude against sums that are drawn independently; and the order of the lattice's own."""
    random = np.random.default_rng(5)
    shape = (scatterers.DRAWS_PER_SAMPLE, 40_000)
    here = random.random(shape) <= tissue.scatterer_density
    strength = here * (tissue.scatterer_mean + tissue.scatterer_sd * random.standard_normal(shape))
    strength -= tissue.scatterer_density * tissue.scatterer_mean
    drawn = np.abs((strength * np.exp(2j * np.pi * random.random(shape))).sum(axis=0))
    drawn *= np.sqrt(tissue.scatter_power / np.mean(drawn**2))
    table, white = scatterers.scatterer_table(tissue), scatterers.white_table()
    shares = [0.1, 0.25, 0.5, 0.75, 0.9, 0.99]
    np.testing.assert_allclose(np.quantile(np.abs(table), shares), np.quantile(drawn, shares), rtol=0.06)
    assert np.mean(np.abs(table) ** 2) == pytest.approx(tissue.scatter_power, rel=1e-4)
    assert correlation(table, white) > 0.99


def test_the_simulators_speckle_is_made_of_the_grain() -> None:
    """In one tissue without surfaces the envelope is that of the grain through the point spread function."""
    import torch

    from ablate.ultrasound.imaging.point_spread import blur, point_spread

    settings = replace(SETTINGS, scanlines=48, samples_per_row=1, noise_level_db=-200.0, sidelobe_db=-300.0)
    frame = Simulator(Scene((), DENSE, "block"), PROBES[0], settings).render(np.eye(4), seed=6)
    field = frame.beam.grain[..., 0].T
    parts = np.ascontiguousarray(np.stack([field.real, field.imag]), np.float32)
    received = blur(parts, np.zeros(field.shape, np.float32), point_spread(PROBES[0], settings, torch.float32))
    expected = np.hypot(*received).T
    assert np.corrcoef(np.log(expected.ravel()), np.log(frame.envelope.ravel()))[0, 1] > 0.99
