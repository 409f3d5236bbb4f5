"""Frequency: penetration as published, noise at its level, and a pulse as theory and the pixels allow."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue, fetal_abdomen, fetal_planes, load_tissues
from ablate.command.compose import jobs_of
from ablate.ultrasound import (
    ConvexProbe,
    LinearProbe,
    PhasedProbe,
    Probe,
    Simulator,
    SimulatorSettings,
    TimeGain,
    compensated_beam,
    with_patient_gain,
)
from ablate.ultrasound.formula import Formula
from ablate.ultrasound.pulse import physical_widths, pulse_in_words, pulse_widths

SPEED_MM_US = 1.54
GEL = Tissue("gel", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
LIVER = replace(load_tissues()["liver"], attenuation_power=1.0, texture_contrast_db=0.0, impedance_mrayl=1.5)
AHEAD = np.eye(4)
FREE = {"axial_fwhm_mm": None, "lateral_fwhm_mm": None, "elevational_fwhm_mm": None}
SCANNER = SimulatorSettings(
    **FREE, noise_level_db=-110.0, most_gain_db=45.0, scanlines=96, axial_samples=768, samples_per_row=1, rays=4,
    layers=1, image_shape=(256, 355), dynamic_range_db=200.0, sidelobe_db=-300.0,
)  # fmt: skip


def block(tissue: Tissue) -> Scene:
    box = trimesh.creation.box((500, 500, 400)).apply_translation((0, 0, 190))
    return Scene((Structure(box, tissue),), GEL, "a block of one tissue")


def power(scene: Scene, probe: Probe, settings: SimulatorSettings) -> np.ndarray:
    """Mean power of the picture at each sample, 1 of white, (samples,)."""
    simulator = Simulator(scene, probe, settings)
    grey = np.stack([simulator.beam_image(AHEAD, seed) for seed in range(3)]).astype(float)
    return np.asarray((10 ** ((grey / 255 - 1) * settings.dynamic_range_db / 10)).mean(axis=(0, 2)))


def by_depth(values: np.ndarray, bands: int) -> np.ndarray:
    return values.reshape(bands, -1).mean(axis=1)


def full_width(places: np.ndarray, values: np.ndarray) -> float:
    """Full width at half maximum of a symmetric curve that is largest at place 0, where `places` begin."""
    first = int(np.argmax(values < values[0] / 2))
    return 2 * float(np.interp(values[0] / 2, values[[first, first - 1]], places[[first, first - 1]]))


def penetration_cm(probe: Probe, tissue: Tissue) -> float:
    """The depth where echoes are as strong as noise, of two images as in IEC 61391-2:2010: a phantom's and noise's."""
    bands = 64
    seen, noise = (by_depth(power(scene, probe, SCANNER), bands) for scene in (block(tissue), Scene((), GEL, "gel")))
    share_db = 10 * np.log10(np.maximum(seen / noise - 1, 1e-3))
    depth_cm = (np.arange(bands) + 0.5) * probe.depth_mm / bands / 10
    near = np.flatnonzero(np.abs(share_db) < 8)  # there the loss is a straight line
    slope, at_face = np.polyfit(depth_cm[near], share_db[near], 1)
    return float(-at_face / slope)


@pytest.mark.parametrize("frequency_mhz", [2.5, 5.0, 7.5, 12.0])
def test_penetration_is_as_published(frequency_mhz: float) -> None:
    """40 / f cm is a rule of radiology (A. Manickam, radiologyweb.org, 2018), 500 wavelengths one of physics (OpenStax,
    College Physics, 17.7): 77 / f cm. Their geometric mean is 55.5 / f."""
    probe = ConvexProbe(depth_mm=900 / frequency_mhz, frequency_mhz=frequency_mhz)
    depth_cm = penetration_cm(probe, LIVER)
    assert 40 / frequency_mhz < depth_cm < 500 * SPEED_MM_US / frequency_mhz / 10
    assert depth_cm == pytest.approx(55.5 / frequency_mhz, rel=0.05)


@pytest.mark.parametrize("loss", [0.3, 0.8])
def test_penetration_is_in_inverse_proportion_to_the_attenuation(loss: float) -> None:
    probe = ConvexProbe(depth_mm=200, frequency_mhz=6.0)
    depth_cm = penetration_cm(probe, replace(LIVER, attenuation_db_cm_mhz=loss))
    assert depth_cm == pytest.approx(55.5 * 0.5 / loss / 6, rel=0.05)


OWN = (-10.0, 5.0, 20.0, 60.0, 80.0, 30.0, 10.0, 0.0)


@pytest.mark.parametrize("frequency_mhz", [2.0, 12.0])
@pytest.mark.parametrize("curve", ["fixed", "own", "patient"])
def test_noise_is_at_its_level_plus_the_gain_at_every_depth(curve: str, frequency_mhz: float) -> None:
    probe = LinearProbe(40.0, 140.0, frequency_mhz)
    settings = replace(SCANNER, time_gain_db=OWN if curve == "own" else None)
    if curve == "patient":
        settings = with_patient_gain(block(LIVER), probe, replace(SCANNER, tgc=TimeGain.patient), AHEAD[None])
    depth_cm = (np.arange(768) + 0.5) * 14 / 768
    slope = 2 * (0.5 if curve == "patient" else 0.4) * frequency_mhz  # of LIVER, or `tgc_db_cm_mhz`
    gain_db = np.minimum(slope * depth_cm, 45.0)
    if curve == "own":
        knots = np.arange(8) * 2.0
        gain_db = np.minimum(np.interp(depth_cm, knots, OWN), 45.0)
    level_db = 10 * np.log10(by_depth(power(Scene((), GEL, "gel"), probe, settings), 24))
    expected_db = -110 + 20 + 10 * np.log10(by_depth(10 ** (gain_db / 10), 24))
    bent = 2.5 if curve == "own" else 0.4  # between sliders the curve is a cubic
    np.testing.assert_allclose(level_db, expected_db, atol=bent)
    assert level_db.max() < -45 + 0.4


def test_what_the_receiver_cannot_lift_stays_dark() -> None:
    probe, tissue = LinearProbe(40.0, 140.0, 6.0), block(LIVER)
    limited, any_gain = (
        10 * np.log10(by_depth(power(tissue, probe, replace(SCANNER, noise_level_db=-300.0, most_gain_db=most)), 16))
        for most in (45.0, None)
    )
    lacking_db = np.maximum(2 * 0.4 * 6 * (np.arange(16) + 0.5) * 14 / 16 - 45, 0)
    np.testing.assert_allclose(any_gain - limited, lacking_db, atol=0.6)


def test_maps_and_the_formula_have_the_same_limit_and_noise() -> None:
    probe, settings = LinearProbe(40.0, 140.0, 12.0), replace(SCANNER, dynamic_range_db=60.0)
    lossless = np.ones((140, 4), np.float32)
    gain_db = np.minimum(2 * 0.4 * 12 * (np.arange(140) + 0.5) / 10, 45)
    expected = np.clip((gain_db + 36) / 72, 0, 1)
    np.testing.assert_allclose(compensated_beam(lossless, probe, settings.time_gain)[:, 0], expected, atol=1e-5)
    formula = Formula([GEL], probe, settings)
    maps = {"segmentation": np.ones((768, 96), np.uint8), "attenuation": np.ones((768, 96), np.float32)}
    image = formula(formula.insonified(maps), 0)
    simulated = Simulator(Scene((), GEL, "gel"), probe, settings).beam_image(AHEAD)
    for some in (slice(0, 256), slice(256, 512), slice(512, 768)):
        assert image[some].mean() == pytest.approx(simulated[some].mean(), abs=1.5)


@pytest.mark.parametrize("frequency_mhz", [2.0, 5.0, 12.0])
@pytest.mark.parametrize("bandwidth", [0.5, 0.8])
def test_the_pulse_is_that_of_its_spectrum(frequency_mhz: float, bandwidth: float) -> None:
    """Its envelope is the inverse Fourier transform of a Gaussian that is half as high at half the bandwidth."""
    settings = SimulatorSettings(**FREE, bandwidth=bandwidth)
    spectrum = np.fft.fftfreq(2**16, d=1e-3)  # MHz, at a step of a nanosecond
    gaussian = 0.5 ** ((2 * spectrum / (bandwidth * frequency_mhz)) ** 2)
    envelope = np.abs(np.fft.ifft(gaussian))[: 2**14]
    expected_mm = SPEED_MM_US / 2 * full_width(np.arange(2**14) * 1e-3, envelope)
    probe = ConvexProbe(frequency_mhz=frequency_mhz)
    assert physical_widths(probe, settings).axial_mm == pytest.approx(expected_mm, rel=1e-3)


@pytest.mark.parametrize("frequency_mhz", [2.0, 12.0])
def test_the_beam_is_that_of_its_apertures(frequency_mhz: float) -> None:
    """The field of an aperture in its focus is the sum of waves from all of it; both ways, its square."""
    settings = SimulatorSettings(**FREE, active_aperture_mm=20.0, focus_mm=60.0, element_height_mm=12.0)

    def width_mm(aperture_mm: float) -> float:
        elements, beside = np.linspace(-0.5, 0.5, 2001) * aperture_mm, np.linspace(0, 8, 2001)
        turns = np.outer(beside, elements) / 60.0 * frequency_mhz / SPEED_MM_US
        return full_width(beside, np.exp(2j * np.pi * turns).mean(axis=1).real ** 2)

    for probe, across_mm in ((ConvexProbe(frequency_mhz=frequency_mhz), 20.0), (LinearProbe(), 20.0)):
        widths = physical_widths(replace(probe, frequency_mhz=frequency_mhz), settings)
        assert widths.lateral_mm == pytest.approx(width_mm(across_mm), rel=2e-3)
        assert widths.elevational_mm == pytest.approx(width_mm(12.0), rel=2e-3)
    phased = PhasedProbe(aperture_mm=16.0, frequency_mhz=frequency_mhz)
    assert physical_widths(phased, settings).lateral_mm == pytest.approx(width_mm(16.0), rel=2e-3)
    near = replace(settings, focus_mm=15.0)  # where fewer elements see a point: at `f_number`
    expected_mm = 0.886 * SPEED_MM_US / frequency_mhz * near.f_number
    assert physical_widths(ConvexProbe(frequency_mhz=frequency_mhz), near).lateral_mm == pytest.approx(expected_mm)


def test_no_width_in_the_image_is_finer_than_two_pixels_and_it_is_said() -> None:
    probe, settings = LinearProbe(40.0, 100.0, 12.0), SimulatorSettings(**FREE, image_shape=(100, 50))
    own, seen = physical_widths(probe, settings), pulse_widths(probe, settings)
    assert seen == (2.0, 1.6, own.elevational_mm)
    assert (
        "2.00 mm along (two pixels; of a finer image 0.08 mm); 1.60 mm across at 70 mm (two pixels"
        in pulse_in_words(probe, settings)
    )
    assert pulse_widths(probe, replace(settings, image_shape=(10_000, 5_000))) == own
    finer = replace(settings, axial_fwhm_mm=0.5, lateral_fwhm_mm=0.25, elevational_fwhm_mm=3.0)  # what is set, is
    assert pulse_widths(probe, finer) == (0.5, 0.25, 3.0)
    assert "0.50 mm along, as set" in pulse_in_words(probe, finer)


def test_a_beam_without_an_aperture_is_refused_unless_its_width_is_set() -> None:
    settings = replace(SCANNER, active_aperture_mm=0.0)
    with pytest.raises(ValueError, match=r"^active_aperture_mm=0\.0: allowed with lateral_fwhm_mm=null are numbers "):
        Simulator(block(LIVER), ConvexProbe(), settings)
    Simulator(block(LIVER), ConvexProbe(), replace(settings, lateral_fwhm_mm=1.0))
    Simulator(block(LIVER), PhasedProbe(), settings)


def test_the_grain_gets_finer_with_frequency_until_two_pixels() -> None:
    """The autocovariance of the intensity of speckle is as wide as the pulse, if that is a Gaussian (Wagner et al.,
    IEEE Trans. Sonics Ultrason. 30, 1983)."""
    scene = block(replace(LIVER, attenuation_db_cm_mhz=0.0))
    shape = (300, 225)  # two pixels are 1.0 mm and 0.53 mm
    fine = {"scanlines": 300, "axial_samples": 1500, "image_shape": shape}
    settings = replace(SCANNER, **fine, noise_level_db=-300.0, bandwidth=0.35)
    found = []
    for frequency_mhz in (1.0, 2.0, 5.0, 12.0):
        probe = LinearProbe(60.0, 150.0, frequency_mhz)
        simulator = Simulator(scene, probe, settings)
        intensity = np.stack([simulator.render(AHEAD, seed).envelope[500:900, 60:240] ** 2 for seed in range(4)])
        spectrum = np.abs(np.fft.fft2(intensity - intensity.mean())) ** 2
        covariance = np.fft.ifft2(spectrum.mean(axis=0)).real
        along_mm = full_width(np.arange(100) * 0.1, covariance[:100, 0])
        across_mm = full_width(np.arange(60) * 60 / 299, covariance[0, :60])
        widths = pulse_widths(probe, settings)
        assert along_mm == pytest.approx(widths.axial_mm, rel=0.1)
        assert across_mm == pytest.approx(widths.lateral_mm, rel=0.15)
        found.append((along_mm, across_mm))
    (along_1, across_1), (along_2, across_2), (_, across_5), (along_12, across_12) = found
    assert along_1 > 1.7 * along_2
    assert along_2 == pytest.approx(along_12, rel=0.1)
    assert across_1 > 1.7 * across_2 > 1.7**2 * across_5 > 1.7**2 * 1.1 * across_12


def test_the_default_preset_is_darker_below_with_every_frequency() -> None:
    """Before noise had a level, the deepest sixth was 131, 147 and 185 here: the white of amplified noise."""
    scene, planes = fetal_abdomen(triangles=20_000), fetal_planes()
    deep, shallow = {}, {}
    for frequency_mhz in (2, 5, 12):
        (job,) = jobs_of([f"probe.frequency_mhz={frequency_mhz}"])
        settings, probe = job.settings.simulator, job.settings.probe
        chosen = with_patient_gain(scene, probe, settings, np.array(list(planes.values())))
        image = Simulator(scene, probe, chosen).beam_image(planes["abdomen"])
        sixth = len(image) // 6
        deep[frequency_mhz], shallow[frequency_mhz] = image[-sixth:].mean(), image[:sixth].mean()
    assert deep[2] > deep[5] + 15
    assert deep[5] > deep[12] + 15
    # noise alone: 45 dB below white, and the mean logarithm of a Rayleigh variable is 2.5 dB below its power
    assert deep[12] == pytest.approx(255 * (1 - 47.5 / 60), abs=4)
    assert np.ptp(list(shallow.values())) < 10
