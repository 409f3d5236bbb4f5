"""Widths of a point, as the envelope shows it and as the kernels are, against the widths asked for."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.interpolate import InterpolatedUnivariateSpline

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, LinearProbe, PhasedProbe, Probe, Simulator, SimulatorSettings
from ablate.ultrasound.imaging.point_spread import along_lines, lateral_kernels

DOT = Tissue("dot", 1540, 1.5, 0.0, 1.0, 1.0, 1.0, roughness=0.0)
DEPTHS_MM = [20.0, 70.0, 130.0]
LINES = 257
LINE_RAD = np.radians(70) / (LINES - 1)
SAMPLE_MM = 150 / 3072


def widening(depth_mm: float) -> float:
    return float(np.sqrt(1 + ((depth_mm - 70) / 40) ** 2))


def full_width(profile: np.ndarray, spacing: float) -> float:
    """Full width at half maximum, from a spline through the logarithm: exact for a sampled Gaussian."""
    peak = int(profile.argmax())
    around = np.arange(max(peak - 12, 0), min(peak + 13, len(profile)))
    around = around[profile[around] > 1e-4 * profile[peak]]
    level = InterpolatedUnivariateSpline(around, np.log(profile[around].astype(float)))
    fine = np.linspace(around[0], around[-1], 20_001)
    level = level(fine) - level(fine).max()
    above = fine[level > np.log(0.5)]
    return float(above[-1] - above[0]) * spacing


@pytest.fixture
def settings() -> SimulatorSettings:
    """The paper's main lobe and samples, with an odd number of scanlines: the middle one is the probe's axis."""
    return SimulatorSettings(scanlines=LINES, layers=1, image_shape=(8, 8), sidelobe_db=-1e3)


def sample_at(depth_mm: float) -> float:
    """Depth of the sample nearest to a depth, mm."""
    return (int(depth_mm / SAMPLE_MM) + 0.5) * SAMPLE_MM


@pytest.mark.parametrize("depth_mm", DEPTHS_MM)
def test_a_scatterer_has_the_widths_asked_for(gel, ball, probe, settings, ahead, depth_mm) -> None:
    """A ball of 0.04 mm, which one sample of one scanline falls into, with the rays of the whole aperture."""
    scene = Scene((ball(DOT, (0.0, 0.0, sample_at(depth_mm)), 0.02),), gel, "s")
    envelope = Simulator(scene, probe, settings).render(ahead).envelope
    sample, line = np.unravel_index(envelope.argmax(), envelope.shape)
    assert (sample, line) == (int(depth_mm / SAMPLE_MM), LINES // 2)
    assert full_width(envelope[:, line], SAMPLE_MM) == pytest.approx(0.30, rel=0.05)
    lateral_mm = full_width(envelope[sample], LINE_RAD * (40 + depth_mm))
    assert lateral_mm == pytest.approx(0.8 * (40 + depth_mm) / 110, rel=0.05)  # one angular width


@pytest.mark.parametrize("depth_mm", DEPTHS_MM)
def test_a_scatterer_has_the_elevational_width_asked_for(gel, ball, probe, settings, depth_mm) -> None:
    """The probe is moved across a ball; in each place another one of 41 layers, 0.3 mm apart, meets it."""
    middle_mm = 0.05  # of a lattice cell, so that rounding does not decide between two
    scene = Scene((ball(DOT, (0.0, middle_mm, sample_at(depth_mm)), 0.02),), gel, "s")
    simulator = Simulator(scene, probe, replace(settings, scanlines=1, rays=1, layers=41, layer_extent_mm=6.0))
    pose, peaks = np.eye(4), []
    for offset_mm in 0.3 * np.arange(-10, 11):
        pose[1, 3] = middle_mm + offset_mm
        peaks.append(simulator.render(pose).envelope.max())
    assert full_width(np.array(peaks), 0.3) == pytest.approx(2.5 * widening(depth_mm), rel=0.05)


@pytest.mark.parametrize("depth_mm", DEPTHS_MM)
@pytest.mark.parametrize("aperture_mm", [0.0, SimulatorSettings.aperture_mm])
def test_a_wire_has_the_width_asked_for(gel, probe, settings, ahead, depth_mm, aperture_mm) -> None:
    """A reflector of 0.1 mm, a hard wire along the probe's y."""
    wire = trimesh.creation.cylinder(radius=0.05, height=40.0, sections=32)
    wire.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    wire.apply_translation((0.0, 0.0, sample_at(depth_mm) + 0.05))
    hard = Tissue("hard", 1540, 15.0, 0.0, 0.0, 0.0, 0.0, roughness=0.0, specularity=0.0)
    settings = replace(settings, aperture_mm=aperture_mm, rays=512 if aperture_mm else 1)
    envelope = Simulator(Scene((Structure(wire, hard),), gel, "s"), probe, settings).render(ahead).envelope
    sample, line = np.unravel_index(envelope.argmax(), envelope.shape)
    assert abs(sample - int(depth_mm / SAMPLE_MM)) <= 1
    assert abs(full_width(envelope[:, line], SAMPLE_MM) - 0.30) < SAMPLE_MM
    lateral_mm = full_width(envelope[sample], LINE_RAD * (40 + depth_mm))
    assert lateral_mm == pytest.approx(0.8 * (40 + depth_mm) / 110, rel=0.05)  # one angular width


@pytest.mark.parametrize("probe", [ConvexProbe(), LinearProbe(), PhasedProbe()])
def test_side_lobes_have_their_power_and_a_smooth_surface_does_not_show_them(probe: Probe) -> None:
    settings = SimulatorSettings(scanlines=192, lateral_fwhm_mm=1.0)
    main = lateral_kernels(probe, settings)[:13][-1]  # 30 mm deep
    both = lateral_kernels(probe, settings, sidelobe_db=-27.0)[:13][-1]
    side = (both - main)[86:106]  # in the middle, where no part of the lobes lies beyond the ends
    np.testing.assert_allclose(main.sum(axis=1), 1)
    np.testing.assert_allclose(both.sum(axis=1), 1)  # what a plane sends back
    assert 10 * np.log10((side**2).sum() / (main[86:106] ** 2).sum()) == pytest.approx(-27.0, abs=1.0)
    apart = np.abs(np.arange(192) - np.arange(86, 106)[:, None])
    beside = apart > 5 * np.sqrt((main[96] * apart[10] ** 2).sum())
    assert (side[beside] ** 2).sum() > 0.5 * (side**2).sum()  # most of it comes from beside the main lobe


@pytest.mark.parametrize("depth_mm", [40.0, 70.0, 100.0])
def test_side_lobes_fill_a_cyst(gel, ball, slab, ahead, depth_mm) -> None:
    """14 mm wide, as in PyMUST: at -25 to -30 dB there (docs/against_pymust.md), at every depth."""
    tissue = Tissue("tissue", 1540, 1.5, 0.0, 1.0, 1.0, 1.0)
    cyst = Tissue("cyst", 1540, 1.5, 0.0, 0.0, 0.0, 0.0)
    probe = ConvexProbe(depth_mm=120.0, frequency_mhz=3.0)
    settings = SimulatorSettings(axial_samples=1024, rays=1, layers=1, lateral_fwhm_mm=1.6, image_shape=(8, 8))
    scene = Scene((slab(tissue, 1.0, 400.0), ball(cyst, (0.0, 0.0, depth_mm), 7.0)), gel, "s")
    simulator = Simulator(scene, probe, settings)
    power = np.mean([simulator.render(ahead, seed).envelope.astype(float) ** 2 for seed in range(8)], axis=0)
    depth, line = (np.arange(1024) + 0.5) * 120 / 1024, np.radians(70) * (np.arange(192) / 191 - 0.5)
    apart = np.hypot((40 + depth[:, None]) * np.sin(line), (40 + depth[:, None]) * np.cos(line) - 40 - depth_mm)
    contrast = power[apart < 4].mean() / power[(apart > 10) & (apart < 14)].mean()
    assert -33 < 10 * np.log10(contrast) < -24


def test_along_lines_is_a_convolution() -> None:
    generator = torch.Generator().manual_seed(0)
    lines = torch.randn(3, 5, 173, generator=generator, dtype=torch.float64)
    kernel = torch.tensor([0.1, 0.5, 1.0, 0.5, 0.1], dtype=torch.float64)
    expected = np.apply_along_axis(lambda line: np.convolve(line, kernel.numpy(), "same"), -1, lines.numpy())
    np.testing.assert_allclose(along_lines(lines, kernel).numpy(), expected, atol=1e-12)
    otherwise_in_memory = lines.transpose(1, 2).contiguous().transpose(1, 2)
    np.testing.assert_allclose(along_lines(otherwise_in_memory, kernel).numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("samples", [512, 1024, 3072])
def test_an_echo_between_two_samples_is_shared_by_them(gel, slab, tissue, samples) -> None:
    """Its peak is then the mean of the pulse at its centre and one sample beside: docs/simulator.md, limits."""
    spacing_mm = 150 / samples
    probe = LinearProbe(depth_mm=150.0, frequency_mhz=3.0)
    settings = SimulatorSettings(
        scanlines=16, axial_samples=samples, rays=4, layers=1, image_shape=(20, 20),
        aperture_mm=0.0, elevational_aperture_mm=0.0,
    )  # fmt: skip
    hard = replace(tissue, impedance_mrayl=gel.impedance_mrayl * 1.2, roughness=0.0, scatterer_density=0.0)
    peaks = []
    for place in (0.0, 0.5):
        scene = Scene((slab(hard, (samples // 2 + 0.5 + place) * spacing_mm, 400.0),), gel, "s")
        peaks.append(Simulator(scene, probe, settings).render(np.eye(4)).envelope[:, 8].max())
    sigma = settings.axial_fwhm_mm / np.sqrt(8 * np.log(2)) / spacing_mm
    assert peaks[1] / peaks[0] == pytest.approx((1 + np.exp(-0.5 / sigma**2)) / 2, rel=0.02)


@pytest.mark.parametrize("probe", [ConvexProbe(), LinearProbe(), PhasedProbe()], ids=lambda probe: type(probe).__name__)
def test_no_kernel_holds_denormal_numbers(probe: Probe) -> None:
    """On Intel's processors a product with some of them is much slower."""
    settings = SimulatorSettings()
    kernels = lateral_kernels(probe, settings, sidelobe_db=settings.sidelobe_db)
    least = np.abs(kernels[kernels != 0]).min()
    assert least > np.finfo(np.float32).tiny / np.finfo(np.float32).eps  # nor do products with a signal
