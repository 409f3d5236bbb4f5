"""The linear envelope against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, DepthMode, Simulator
from ablate.ultrasound.point_spread import FWHM_PER_SIGMA, along_lines, beam_widening, blur, point_spread
from ablate.ultrasound.probe import sample_depths_mm, scanline_spacing_mm


def mean_level_db(envelope: np.ndarray) -> np.ndarray:
    return 10 * np.log10((envelope.astype(np.float64) ** 2).mean(axis=1))


def test_uniform_tissue_falls_by_twice_alpha_f(tissue, probe, small, ahead) -> None:
    envelope = Simulator(Scene((), tissue, "s"), probe, small).render(ahead).envelope
    depth_cm = sample_depths_mm(probe, small.axial_samples) / 10
    slope = np.polyfit(depth_cm[20:-20], mean_level_db(envelope)[20:-20], 1)[0]
    assert slope == pytest.approx(-2 * 0.5 * 3.0, rel=0.02)


@pytest.mark.parametrize("axial_samples", [512, 1024, 3072])
def test_speckle_level_does_not_depend_on_sampling(probe, small, ahead, axial_samples) -> None:
    tissue = Tissue("t", attenuation_db_cm_mhz=0.0, scatterer_density=0.7, scatterer_mean=0.5, scatterer_sd=0.6)
    settings = replace(small, axial_samples=axial_samples, scatterer_level_db=-30.0)
    pose = ahead.copy()
    pose[:3, :3] = [[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]
    envelope = Simulator(Scene((), tissue, "s"), probe, settings).render(pose).envelope
    rms_db = 10 * np.log10((envelope.astype(np.float64) ** 2).mean())
    assert rms_db == pytest.approx(-30 + 10 * np.log10(tissue.scatter_power), abs=0.35)


def test_speckle_is_fully_developed(ahead) -> None:
    tissue = Tissue("t", attenuation_db_cm_mhz=0.0, scatterer_density=0.6, scatterer_sd=0.3)
    from ablate.ultrasound import SimulatorSettings

    settings = SimulatorSettings(rays=1, image_shape=(50, 70), axial_samples=3072, scanlines=192)
    envelope = Simulator(Scene((), tissue, "s"), ConvexProbe(), settings).render(ahead).envelope
    for part in np.array_split(envelope[100:-100], 3):
        assert part.mean() / part.std() == pytest.approx(1.91, abs=0.05)
    thinned = envelope[200:-200:13, ::7].ravel().astype(np.float64)
    scale = np.sqrt((thinned**2).mean() / 2)
    assert stats.kstest(thinned, stats.rayleigh(scale=scale).cdf).statistic < 0.02


def test_contrast_follows_the_scatterers(probe, small, ahead, slab) -> None:
    a = Tissue("a", attenuation_db_cm_mhz=0.0, scatterer_density=0.5, scatterer_mean=0.4, scatterer_sd=0.2)
    b = Tissue("b", attenuation_db_cm_mhz=0.0, scatterer_density=0.9, scatterer_mean=0.0, scatterer_sd=0.9)
    envelope = Simulator(Scene((slab(b, 75.0, 300.0),), a, "s"), probe, small).render(ahead).envelope
    level = 10 * np.log10([(envelope[part] ** 2).mean() for part in (slice(50, 450), slice(620, 1000))])
    assert level[1] - level[0] == pytest.approx(10 * np.log10(b.scatter_power / a.scatter_power), abs=1.0)


def test_texture_keeps_the_mean_power(probe, small, ahead) -> None:
    plain = Tissue("t", attenuation_db_cm_mhz=0.0)
    rough = Tissue("t", attenuation_db_cm_mhz=0.0, texture_contrast_db=4.0, texture_mm=(2.0, 2.0, 2.0))
    power = [
        (Simulator(Scene((), tissue, "s"), probe, small).render(ahead).envelope ** 2).mean()
        for tissue in (plain, rough)
    ]
    assert 10 * np.log10(power[1] / power[0]) == pytest.approx(0, abs=0.5)


def test_flat_perfect_reflector_is_0_db(gel, slab, probe, small, ahead) -> None:
    gas = Tissue("gas", 1540, 1e-6, 0.0, roughness=0.0)
    settings = replace(small, scanlines=65)
    envelope = Simulator(Scene((slab(gas, 70.0, 300.0),), gel, "s"), probe, settings).render(ahead).envelope
    peak = int(envelope[:, 32].argmax())
    assert sample_depths_mm(probe, small.axial_samples)[peak] == pytest.approx(70.0, abs=0.15)
    assert 20 * np.log10(envelope[peak, 32]) == pytest.approx(0.0, abs=0.3)


def test_shadow_behind_a_lossy_slab(slab, probe, small, ahead) -> None:
    """Behind 20 mm of 2 dB/cm/MHz instead of 0.5 at 3 MHz the echoes are 18 dB weaker."""
    body = Tissue("body", 1540, 1.5, 0.5, roughness=0.0)
    stone = Tissue("stone", 1540, 1.5, 2.0, roughness=0.0)
    plain = Scene((), body, "s")
    shadowed = Scene((slab(stone, 40.0, 60.0),), body, "s")
    a, b = (Simulator(scene, probe, small).render(ahead).envelope for scene in (plain, shadowed))
    middle, behind = slice(28, 36), slice(500, 1000)
    drop = 10 * np.log10((b[behind, middle] ** 2).mean() / (a[behind, middle] ** 2).mean())
    assert drop == pytest.approx(-2 * 1.5 * 3.0 * 2.0, abs=0.5)


def test_enhancement_behind_fluid(slab, gel, probe, small, ahead) -> None:
    body = Tissue("body", 1540, 1.5, 0.5, roughness=0.0)
    fluid = replace(gel, name="fluid")
    a, b = (
        Simulator(scene, probe, small).render(ahead).envelope
        for scene in (Scene((), body, "s"), Scene((slab(fluid, 40.0, 60.0),), body, "s"))
    )
    gain = 10 * np.log10((b[500:1000, 28:36] ** 2).mean() / (a[500:1000, 28:36] ** 2).mean())
    assert gain == pytest.approx(2 * 0.5 * 3.0 * 2.0, abs=0.5)
    assert b[290:390, 30:34].max() < 1e-3 * a[290:390, 30:34].mean()


@pytest.mark.parametrize("depth_mm", [20.0, 70.0, 130.0])
def test_a_point_has_the_widths_asked_for(probe, small, depth_mm) -> None:
    settings = replace(small, scanlines=256, lateral_fwhm_mm=3.0)
    spread = point_spread(probe, settings, torch.float64)
    point = torch.zeros(256, settings.axial_samples, dtype=torch.float64)
    sample = int(depth_mm / 150.0 * settings.axial_samples)
    point[128, sample] = 1
    response = blur(torch.zeros(2, *point.shape, dtype=torch.float64), point, spread)[0].numpy()

    def fwhm(profile: np.ndarray) -> float:  # of a Gaussian, by its second moment
        x = np.arange(len(profile))
        centre = (profile * x).sum() / profile.sum()
        return FWHM_PER_SIGMA * np.sqrt((profile * (x - centre) ** 2).sum() / profile.sum())

    lateral = fwhm(response[:, sample]) * scanline_spacing_mm(probe, 256, np.array([depth_mm]))[0]
    wanted = 3.0 * beam_widening(settings, np.array([depth_mm]))[0]
    assert lateral == pytest.approx(wanted, rel=0.02)
    assert fwhm(response[128]) * 150.0 / settings.axial_samples == pytest.approx(1.2, rel=0.02)
    assert response[:, sample].sum() == pytest.approx(1, rel=0.02)


def test_along_lines_is_a_convolution() -> None:
    generator = torch.Generator().manual_seed(0)
    lines = torch.randn(3, 5, 173, generator=generator, dtype=torch.float64)
    kernel = torch.tensor([0.1, 0.5, 1.0, 0.5, 0.1], dtype=torch.float64)
    expected = np.apply_along_axis(lambda line: np.convolve(line, kernel.numpy(), "same"), -1, lines.numpy())
    np.testing.assert_allclose(along_lines(lines, kernel).numpy(), expected, atol=1e-12)


def test_time_of_flight_displaces_by_the_speeds(gel, slab, probe, small, ahead) -> None:
    fast = Tissue("fast", 1540 * 1.25, 1.2, 0.0, roughness=0.0)
    gas = Tissue("gas", 1540, 1e-6, 0.0, roughness=0.0)
    scene = Scene((slab(fast, 20.0, 60.0), slab(gas, 60.0, 300.0)), gel, "s")
    peaks = []
    for mode in DepthMode:
        settings = replace(small, scanlines=33, depth_mode=mode, rays=64)
        envelope = Simulator(scene, probe, settings).render(ahead).envelope
        depth = sample_depths_mm(probe, small.axial_samples)
        beyond = depth > 40
        peaks.append(depth[beyond][envelope[beyond, 16].argmax()])
    assert peaks == [pytest.approx(60.0, abs=0.3), pytest.approx(20 + 40 / 1.25, abs=0.3)]


def test_time_of_flight_moves_speckle_with_its_tissue(tissue, gel, slab, probe, small, ahead) -> None:
    fast = Tissue("fast", 1540 * 1.25, 1.5, 0.0, 0.0, roughness=0.0)
    scene = Scene((slab(fast, -50.0, 60.0), slab(tissue, 60.0, 300.0)), gel, "s")
    settings = replace(small, depth_mode=DepthMode.time_of_flight)
    envelope = Simulator(scene, probe, settings).render(ahead).envelope[:, 30:34]
    depth = sample_depths_mm(probe, small.axial_samples)
    assert envelope[depth < 46].max() < 1e-4 < envelope[(depth > 52) & (depth < 60)].mean()
