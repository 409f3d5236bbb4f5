"""A simulator of the user's own: what it is given is all that a frame is made of, and what it returns is checked."""

import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ablate.anatomy import Scene, fetal_abdomen, fetal_planes, load_tissues
from ablate.ultrasound import (
    ConvexProbe,
    Display,
    Echoes,
    Iq,
    LinearProbe,
    OwnSimulator,
    OwnSimulatorError,
    PhasedProbe,
    Rf,
    Simulator,
    SimulatorSettings,
)
from ablate.ultrasound.imaging.point_spread import blur, point_spread
from ablate.ultrasound.settings import Probe

Own = Callable[..., OwnSimulator]
SETTINGS = SimulatorSettings(
    scanlines=64, axial_samples=512, rays=8, layers=3, image_shape=(128, 177), axial_fwhm_mm=1.2, lateral_fwhm_mm=1.6
)
PROBE = ConvexProbe(frequency_mhz=3.0)
SHAPE = SETTINGS.beam_shape


@pytest.fixture(scope="module")
def fetus() -> Scene:
    return fetal_abdomen(6_000)


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fetus: Scene) -> Own:
    """`own(form, settings)`: the simulator of a function."""
    (tmp_path / "of_a_test.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "of_a_test", raising=False)
    import of_a_test

    def make(form: object, settings: SimulatorSettings = SETTINGS, probe: Probe = PROBE) -> OwnSimulator:
        monkeypatch.setattr(of_a_test, "form", form, raising=False)
        return OwnSimulator("of_a_test.form", fetus, probe, settings)

    return make


def by_our_pulse(echoes: Echoes) -> Iq:
    """Ablate's own point spread function."""
    import torch

    received = echoes.scattered.T
    spread = point_spread(echoes.probe, echoes.settings, torch.float32)
    real, imaginary = blur(np.array([received.real, received.imag], order="C"), echoes.surfaces.T.copy(), spread)
    return Iq((real + 1j * imaginary).T + echoes.reverberation)


@pytest.mark.parametrize("probe", [PROBE, LinearProbe(), PhasedProbe()], ids=lambda probe: probe.kind)
def test_our_own_pulse_on_what_is_handed_over_makes_our_own_frame(own: Own, fetus: Scene, probe: Probe) -> None:
    """With what the chain does afterwards, the noise of its amplifier too: all but rounding."""
    ours, theirs = Simulator(fetus, probe, SETTINGS), own(by_our_pulse, probe=probe)
    for name in ("head", "abdomen"):
        pose = fetal_planes()[name]
        expected, frame = ours.render(pose, seed=3), theirs.render(pose, seed=3)
        assert np.abs(frame.image.astype(int) - expected.image).max() <= 1
        np.testing.assert_allclose(frame.envelope, expected.envelope, rtol=1e-4, atol=1e-9)
        np.testing.assert_array_equal(frame.segmentation, expected.segmentation)
        np.testing.assert_array_equal(frame.attenuation, expected.attenuation)
        assert not np.array_equal(theirs.render(pose, seed=4).image, frame.image), "another seed is another speckle"


def from_scratch(echoes: Echoes) -> np.ndarray:
    """The paper's chain in NumPy: a separable Gaussian pulse, its modulus, time gain, logarithm, and rows."""
    s, probe = echoes.settings, echoes.probe
    per_fwhm = 1 / np.sqrt(8 * np.log(2))
    pitch_mm = (probe.radius_mm + s.focus_mm) * np.radians(probe.fov_deg) / (s.scanlines - 1)
    line = np.arange(s.scanlines)
    across = np.exp(-0.5 * ((line[:, None] - line) / (s.lateral_fwhm_mm * per_fwhm / pitch_mm)) ** 2)
    across /= across.sum(axis=1, keepdims=True)
    sample = np.arange(s.axial_samples)
    spacing_mm = probe.depth_mm / s.axial_samples
    along = np.exp(-0.5 * ((sample[:, None] - sample) * spacing_mm / (s.axial_fwhm_mm * per_fwhm)) ** 2)
    energy = (across**2).sum(axis=1) * (along[s.axial_samples // 2] ** 2).sum()
    received = (echoes.strength * echoes.transmission * echoes.weight[:, :, None]).sum(axis=0)
    signal = along @ (received @ across.T / np.sqrt(energy) + echoes.surfaces @ across.T) + echoes.reverberation
    depth_cm = (sample + 0.5) * spacing_mm / 10
    amplified = np.abs(signal) * 10 ** (2 * s.tgc_db_cm_mhz * probe.frequency_mhz * depth_cm / 20)[:, None]
    with np.errstate(divide="ignore"):
        level_db = 20 * np.log10(amplified / s.reference_level)
    grey = 255 * np.clip(level_db / s.dynamic_range_db + 1, 0, 1)
    return grey.reshape(-1, s.samples_per_row, s.scanlines).mean(axis=1)


def test_a_chain_that_shares_no_code_makes_our_frame_of_what_is_handed_over(own: Own, fetus: Scene) -> None:
    """Without side lobes, which are drawn at random, and without the amplifier's noise, which is the chain's own."""
    settings = replace(SETTINGS, sidelobe_db=-300.0, noise_level_db=-300.0)
    ours, theirs = Simulator(fetus, PROBE, settings), own(from_scratch, settings)
    for pose in list(fetal_planes().values())[:3]:
        expected, image = ours.beam_image(pose, seed=3), theirs.beam_image(pose, seed=3)
        error = np.square(expected.astype(float) - image).mean()
        assert 10 * np.log10(255**2 / error) > 60, "float32 here, float64 there"


def test_positions_are_those_of_the_frame(fetus: Scene) -> None:
    """On arcs about the centre of curvature; labels there are those of the segmentation."""
    simulator = Simulator(fetus, PROBE, SETTINGS)
    pose = fetal_planes()["head"]
    echoes = simulator.echoes(pose, seed=1)
    radius = np.hypot(echoes.x_mm, echoes.z_mm + PROBE.radius_mm)
    np.testing.assert_allclose(radius - PROBE.radius_mm, np.tile(echoes.depth_mm[:, None], SETTINGS.scanlines))
    angle = np.degrees(np.arctan2(echoes.x_mm, echoes.z_mm + PROBE.radius_mm))
    np.testing.assert_allclose(angle, np.tile(np.linspace(-35, 35, 64), (512, 1)))
    np.testing.assert_array_equal(echoes.y_mm, [-1.5, 0, 1.5])
    middle = echoes.labels[1, 1::2]  # of the image plane, as rays that are refracted meet it
    assert (middle + 1 == simulator.beam_maps(pose).segmentation).mean() > 0.9
    silent = np.array([tissue.scatter_power == 0 for tissue in echoes.tissues])
    assert (echoes.strength[silent[echoes.labels]] == 0).all()
    assert (echoes.transmission >= 0).all()
    assert echoes.transmission.max() <= 1
    np.testing.assert_allclose((echoes.weight**2).sum(axis=0), 1, rtol=1e-5)


def test_rf_is_detected_as_its_iq(own: Own) -> None:
    """A carrier of a quarter of the samples on the lines; the Hilbert transform takes it off again."""
    pose = fetal_planes()["head"]

    def slow(echoes: Echoes) -> np.ndarray:
        lines = by_our_pulse(echoes).lines
        spectrum = np.fft.fft(lines, axis=0)
        spectrum[np.abs(np.fft.fftfreq(len(lines))) > 0.2] = 0
        return np.fft.ifft(spectrum, axis=0)

    def carried(echoes: Echoes) -> Rf:
        carrier = np.exp(2j * np.pi * 0.25 * np.arange(SETTINGS.axial_samples))[:, None]
        return Rf((slow(echoes) * carrier).real)

    quiet = replace(SETTINGS, noise_level_db=-300.0)
    of_iq = own(lambda echoes: Iq(slow(echoes)), quiet).beam_image(pose)
    of_rf = own(carried, quiet).beam_image(pose)
    assert np.abs(of_iq.astype(int) - of_rf).max() <= 1


def test_lines_of_another_number_of_steps_lie_at_their_depths(own: Own) -> None:
    """A bright line at half the depth, and a level that falls with depth, at any number of steps."""
    quiet, pose = replace(SETTINGS, noise_level_db=-300.0, tgc_db_cm_mhz=0.0), fetal_planes()["head"]

    def falling(steps: int) -> Callable[[Echoes], Iq]:
        depth = (np.arange(steps) + 0.5) / steps
        values = 0.03 * 10 ** (-depth) + 0.05 * np.exp(-0.5 * ((depth - 0.5) / 0.05) ** 2)
        return lambda _: Iq(np.repeat(values[:, None], SETTINGS.scanlines, axis=1) * (0.6 + 0.8j))

    images = [own(falling(steps), quiet).beam_image(pose).astype(int) for steps in (512, 2048, 300)]
    assert np.ptp(images[0]) > 50
    for image in images[1:]:
        assert np.abs(image - images[0]).max() <= 1


def test_grey_levels_are_the_image(own: Own) -> None:
    grey = np.linspace(0, 255, SHAPE[0] * SHAPE[1]).reshape(SHAPE)
    pose = fetal_planes()["head"]
    simulator = own(lambda _: grey)
    np.testing.assert_array_equal(simulator.beam_image(pose), np.rint(grey))
    frame = simulator.render(pose)
    np.testing.assert_array_equal(frame.image, simulator._chain.convert.to_image(np.rint(grey).astype(np.uint8)))
    assert frame.envelope.size == 0
    brighter = simulator.beam_image(pose, display=Display(gain_db=6.0))
    inside = (grey >= 1) & (grey < 220)
    np.testing.assert_allclose(brighter[inside], np.rint(grey)[inside] + 255 * 6 / 60, atol=0.51)


def holds(value: float) -> np.ndarray:
    grey = np.full(SHAPE, 100.0)
    grey[3, 4] = value
    return grey


WRONG = {
    "nothing": (None, "returns NoneType; allowed are grey levels, a NumPy array of 256 x 64, or"),
    "a list": ([[1.0]], "returns list; allowed are grey levels"),
    "a tensor's shape": (np.zeros((256, 64, 1)), "returns grey levels of 256 x 64 x 1; allowed are 256 x 64"),
    "samples": (np.zeros((512, 64)), "returns grey levels of 512 x 64; allowed are 256 x 64, rows x scanlines"),
    "turned": (np.zeros((64, 256)), "returns grey levels of 64 x 256; allowed"),
    "one number": (np.array(3.0), "returns grey levels of one number; allowed"),
    "NaN": (holds(np.nan), "returns 1 of 16384 values that are NaN or infinite"),
    "infinite": (holds(np.inf), "returns 1 of 16384 values that are NaN or infinite"),
    "too bright": (holds(256.0), "returns grey levels from 100 to 256; allowed are 0 to 255"),
    "negative": (holds(-0.5), "returns grey levels from -0.5 to 100; allowed are 0 to 255"),
    "complex": (
        np.zeros(SHAPE, complex),
        "returns complex128; allowed are uint8, or other real numbers from 0 to 255; ",
    ),
    "bool": (np.zeros(SHAPE, bool), "returns bool; allowed are uint8"),
    "text": (np.full(SHAPE, "a"), "returns <U1; allowed are uint8"),
    "real IQ": (Iq(np.zeros((512, 64))), "returns Iq of float64; allowed are complex numbers"),
    "complex RF": (Rf(np.zeros((512, 64), complex)), "returns Rf of complex128; allowed are real numbers"),
    "lines turned": (
        Iq(np.zeros((64, 512), complex)),
        "returns Iq of 64 x 512 values; allowed are lines of any number",
    ),
    "one sample": (Iq(np.zeros((1, 64), complex)), "returns Iq of 1 x 64 values; allowed are lines of any number"),
    "no array": (Rf([1.0]), "returns Rf of list; allowed"),
    "NaN in lines": (Iq(np.full((512, 64), np.nan + 0j)), "returns Iq of 32768 of 32768 values that are NaN"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_image_is_refused_in_one_line(own: Own, name: str) -> None:
    value, message = WRONG[name]
    with pytest.raises(OwnSimulatorError) as error:
        own(lambda _: value).beam_image(fetal_planes()["head"], seed=7)
    assert str(error.value).startswith(f"scene.target=of_a_test.form: {message}")
    assert re.search(r"\(probe at [-\d.]+, [-\d.]+, [-\d.]+ mm, seed 7\)$", str(error.value))
    assert "\n" not in str(error.value)


def test_what_it_raises_is_said_in_one_line(own: Own) -> None:
    def fails(_: Echoes) -> np.ndarray:
        raise RuntimeError("out of\nmemory")

    with pytest.raises(
        OwnSimulatorError, match=r"^scene\.target=of_a_test\.form: fails: RuntimeError: out of memory \("
    ):
        own(fails).beam_image(fetal_planes()["head"])


def test_what_has_no_meaning_for_it_is_refused(own: Own, fetus: Scene) -> None:
    with pytest.raises(OwnSimulatorError, match="allowed is compound_angles=1"):
        own(by_our_pulse, replace(SETTINGS, compound_angles=3))
    with pytest.raises(OwnSimulatorError, match=r"target=of_a_test\.form: is a int, allowed is a function"):
        own(3)
    with pytest.raises(OwnSimulatorError, match=r"target=nowhere\.form: ModuleNotFoundError: .*allowed is the path"):
        OwnSimulator("nowhere.form", fetus)


def test_where_nothing_scatters_there_are_no_echoes() -> None:
    scene = Scene((), load_tissues()["coupling_gel"], "gel")
    echoes = Simulator(scene, PROBE, SETTINGS).echoes(np.eye(4))
    for values in (echoes.strength, echoes.surfaces, echoes.reverberation, echoes.scattered):
        assert not values.any()
