"""Soft shadows: against waves that pass an opaque strip, and where nothing may change."""

import numpy as np
import pytest

from ablate.ultrasound import ConvexProbe, LinearProbe, Probe, SimulatorSettings
from ablate.ultrasound.transport.aperture import Aperture
from ablate.ultrasound.transport.lines import NO_SOUND_DB

SETTINGS = SimulatorSettings(scanlines=256, layers=1)
PROBE = LinearProbe(width_mm=60.0, depth_mm=128.0, frequency_mhz=5.0)
X = np.linspace(-30, 30, 256)
DEPTH = (np.arange(256) + 0.5) / 2


def behind_a_strip(width_mm: float, strip_mm: float, depth_mm: float) -> float:
    """What waves lose behind an opaque strip before the middle of an aperture that is focused behind it, both ways, dB.

    Each frequency of the pulse is propagated from plane to plane by its angular spectrum (Goodman, Introduction to
    Fourier Optics, 3.10), in two dimensions. The aperture has the span and the apodisation of `Aperture`.
    """
    span = min(SETTINGS.active_aperture_mm, depth_mm / SETTINGS.f_number)
    x = (np.arange(8192) - 4096) * 0.04
    apodisation = np.where(np.abs(x) < span / 2, np.cos(np.pi * x / span) ** 2, 0.0)
    received = np.zeros(2)
    for frequency in PROBE.frequency_mhz * np.linspace(0.7, 1.3, 13):
        k = 2 * np.pi * frequency / 1.54
        lateral = 2 * np.pi * np.fft.fftfreq(len(x), 0.04)
        forward = np.abs(lateral) < k
        axial = np.sqrt(np.where(forward, k**2 - lateral**2, 0.0))

        def ahead(field: np.ndarray, mm: float, axial: np.ndarray = axial, forward: np.ndarray = forward) -> np.ndarray:
            return np.fft.ifft(np.fft.fft(field) * np.exp(1j * axial * mm) * forward)

        there = ahead(apodisation * np.exp(-1j * k * np.hypot(x, depth_mm)), strip_mm)
        for case, field in enumerate((there * (np.abs(x) > width_mm / 2), there)):
            received[case] += np.abs(ahead(field, depth_mm - strip_mm)[len(x) // 2]) ** 4
    return float(10 * np.log10(received[0] / received[1]))


def shadowed(width_mm: float, strip_mm: float) -> np.ndarray:
    """The level of pencils behind a strip that lets nothing through, with what the aperture brings, (256, 256) dB."""
    level_db = np.zeros((256, 256))
    level_db[np.ix_(np.abs(X) < width_mm / 2, DEPTH > strip_mm)] = -400.0
    return Aperture(PROBE, SETTINGS).gain_and_level_db(level_db)[1]


@pytest.mark.parametrize(("width_mm", "strip_mm"), [(2.0, 30.0), (2.0, 70.0), (6.0, 30.0), (6.0, 70.0)])
def test_the_shadow_of_a_rod_is_that_of_waves(width_mm: float, strip_mm: float) -> None:
    """From 15 mm behind it within 3.5 dB where waves are above -25 dB, and dark where they are darker."""
    middle = shadowed(width_mm, strip_mm)[128]
    for depth_mm in np.arange(strip_mm + 15, 125, 10):
        waves, ours = behind_a_strip(width_mm, strip_mm, depth_mm), middle[np.abs(DEPTH - depth_mm).argmin()]
        assert ours == pytest.approx(waves, abs=3.5) if waves > -25 else ours < -22


def test_a_shadow_is_dark_behind_what_casts_it_and_fills_with_depth() -> None:
    shadow = shadowed(4.0, 30.0)
    assert shadow[128, DEPTH > 34].max() > -30 > shadow[128, np.abs(DEPTH - 36).argmin()]
    assert (np.diff(shadow[128, 80::16]) >= -1e-9).all()
    edges = [np.abs(np.interp([-20.0, -6.0], shadow[128:, column], X[128:])) for column in (80, 240)]
    assert np.ptp(edges[1]) > np.ptp(edges[0])  # softer with depth


@pytest.mark.parametrize("probe", [PROBE, ConvexProbe(depth_mm=128.0)])
def test_a_layered_medium_stays_as_it_is(probe: Probe) -> None:
    layers = -np.cumsum(np.random.default_rng(0).exponential(2.0, 256))
    gain_db, _ = Aperture(probe, SETTINGS).gain_and_level_db(np.tile(layers, (256, 1)))
    np.testing.assert_allclose(gain_db, 0.0, atol=1e-3)  # sums in float32


def test_one_element_is_a_pencil_but_for_diffraction() -> None:
    one = SimulatorSettings(scanlines=256, layers=1, active_aperture_mm=0.0)
    fast = LinearProbe(width_mm=60.0, depth_mm=128.0, frequency_mhz=1e3)
    level_db = np.zeros((256, 256))
    level_db[100:150, 60:] = -40.0
    gain_db, _ = Aperture(fast, one).gain_and_level_db(level_db)
    np.testing.assert_allclose(gain_db[104:146], 0.0, atol=1e-6)
    np.testing.assert_allclose(gain_db[:96], 0.0, atol=1e-6)


def test_levels_with_gaps_are_never_lifted_above_the_sound_that_was_sent() -> None:
    """Few rays behind bone leave nodes without sound, and louder ones behind them; neighbours hear nothing of it."""
    random = np.random.default_rng(0)
    settings = SimulatorSettings(scanlines=96, layers=1, image_shape=(8, 8))
    aperture, smooth = Aperture(ConvexProbe(), settings), -np.linspace(0, 60, 256) * np.ones((96, 1))
    level = smooth - random.exponential(10, smooth.shape)
    level[random.random(level.shape) < 0.2] = NO_SOUND_DB
    gain_db, lifted_db = aperture.gain_and_level_db(level)
    assert lifted_db.max() < 1e-3
    assert gain_db.max() < 600  # echoes stay finite
    one = smooth.copy()
    one[48, 100:130] = NO_SOUND_DB
    _, lifted_db = aperture.gain_and_level_db(one)
    np.testing.assert_allclose(lifted_db[:, :95], smooth[:, :95], atol=1e-3)
    beside = np.delete(lifted_db, 48, axis=0)
    np.testing.assert_allclose(beside, np.delete(smooth, 48, axis=0), atol=1.0)


def test_other_elements_hear_what_lies_behind_a_pencil_without_sound() -> None:
    settings = SimulatorSettings(scanlines=96, layers=1, image_shape=(8, 8))
    level = np.zeros((96, 256))
    level[48, 40:] = NO_SOUND_DB
    filled = Aperture(ConvexProbe(), settings).gain_and_level_db(level)[1][48]
    assert filled[60:].min() > -12
    assert filled[-1] > -8
    assert filled[48] < filled[60] - 3  # a shadow of one scanline ends soon


def test_pencils_that_are_no_whole_layers_are_refused() -> None:
    """Compiled code would write beyond its arrays."""
    with pytest.raises(ValueError, match="300 pencils, allowed are multiples of the 256 scanlines"):
        Aperture(PROBE, SETTINGS).gain_and_level_db(np.zeros((300, 256)))
