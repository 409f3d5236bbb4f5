"""Eight defects found in the source of published ultrasound simulators; each test fails if this simulator has it.

What other tests of this folder show as well is not shown again here: the size of single echoes, the lobe, Fresnel and
Snell in `test_monte_carlo.py` and `test_rays.py`, losses in `test_losses.py`, travel times in `test_echo_places.py`,
the scatterers' mean in `test_speckle.py`.

The simulators are open source: i4h raysim (Isaac for Healthcare), MCRay-Tracing and
burgercpp (after Mattausch and Goksel, and Burger et al.), and the renderer of LOTUS. Later versions may differ.
"""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from support.traced_rays import tilted

AHEAD = np.eye(4)


def anechoic(name: str, impedance: float, speed: float = 1540, loss: float = 0.0, **more: float) -> Tissue:
    """A tissue without scatterers, with a mirror-like surface."""
    return Tissue(name, speed, impedance, loss, 0.0, 0.0, 0.0, **{"roughness": 0.0, **more})


def spikiness(density: float) -> float:
    """<I^2> / <I>^2 less the 2 of fully developed speckle, for a pulse hardly wider than a sample.

    Over N scatterers of normal strength, of which a share p is there, it is (3 / p - 2) / N.
    """
    settings = SimulatorSettings(
        rays=1, layers=1, image_shape=(8, 8), scanlines=96, axial_fwhm_mm=0.15, lateral_fwhm_mm=0.2
    )
    tissue = Tissue("t", 1540, 1.5, 0.0, density, 0.0, 1.0)
    intensity = Simulator(Scene((), tissue, "s"), ConvexProbe(), settings).render(AHEAD).envelope.astype(float) ** 2
    return (intensity**2).mean() / intensity.mean() ** 2 - 2


def test_1_echoes_add_up(gel, slab, pencil, apart, amplitudes) -> None:
    """An echo replaces its sample's value instead of adding to it; reflected rays are switched off (i4h raysim)."""
    hard, harder = anechoic("hard", 4.5), anechoic("harder", 13.5)
    two = Scene((slab(hard, 30.0, 400.0), slab(harder, 60.0, 400.0)), gel, "s")
    assert amplitudes(two, pencil, apart, (80, 100)).mean() > 1e-3  # reflected at 60, 30 and 60 mm
    strong = Scene((slab(hard, 50.0, 400.0),), gel, "s")
    assert amplitudes(strong, pencil, apart, (60, 150)).max() == 0
    in_one_pulse = slab(anechoic("a", 1.8), 50.0, 400.0), slab(anechoic("b", 2.2), 50.4, 400.0)
    both = 0.3 / 3.3 + 0.4 / 4.0 * (1 - (0.3 / 3.3) ** 2)
    assert amplitudes(Scene(in_one_pulse, gel, "s"), pencil, apart, (45, 55)).mean() == pytest.approx(both, rel=0.02)
    speckled = Scene(strong.structures, replace(gel, scatterer_density=0.6, scatterer_sd=1.0), "s")
    simulator = Simulator(speckled, pencil, replace(apart, scatterer_level_db=-44.0))
    assert np.std([simulator.render(AHEAD, seed).envelope[341, 0] for seed in range(8)]) > 1e-3  # at the face


def test_2_reflection_knows_both_angles_and_loss_both_ways(slab, pencil, apart, amplitudes) -> None:
    """R depends on the angle of incidence only, and attenuation is applied one way only (i4h raysim).

    Where only the speeds differ, the short form of R is zero at every angle.
    """
    angle, sine = np.radians(30.0), 2000 / 1540 * np.sin(np.radians(30.0))
    cos_i, cos_t = np.cos(angle), np.sqrt(1 - sine**2)
    fast = slab(anechoic("fast", 1.5, 2000, specularity=0.0), 40.0, 400.0)
    echo = (cos_i - cos_t) / (cos_i + cos_t) * 10 ** (-2 * 0.5 * 3.0 * (4 / cos_i) / 20)
    measured = amplitudes(Scene((fast,), anechoic("body", 1.5, loss=0.5), "s"), pencil, apart, (40, 55), tilted(30.0))
    np.testing.assert_allclose(measured, echo, rtol=2e-3)


@pytest.mark.parametrize(("depth_mm", "samples"), [(150.0, 3072), (150.0, 1100), (90.0, 1500), (200.0, 2000)])
def test_3_pulse_and_gain_know_the_spacing_of_samples(gel, slab, apart, small, depth_mm, samples) -> None:
    """Pulse and time gain are made for one sampling rate and applied to samples at another spacing (i4h raysim)."""
    spacing = depth_mm / samples
    settings = replace(apart, axial_samples=samples)
    face = Scene((slab(anechoic("hard", 4.5), 60.0, 400.0),), gel, "s")
    line = Simulator(face, ConvexProbe(fov_deg=0.002, depth_mm=depth_mm), settings).render(AHEAD).envelope[:, 0]
    z = (np.arange(samples) + 0.5) * spacing
    sigma = np.sqrt((line * (z - 60) ** 2).sum() / line.sum())
    assert sigma * np.sqrt(8 * np.log(2)) == pytest.approx(1.2, rel=0.03)

    body = Tissue("body", 1540, 1.5, 0.7, 0.6, 0.0, 1.0)
    probe = ConvexProbe(depth_mm=depth_mm, frequency_mhz=4.0)
    simulator = Simulator(Scene((), body, "s"), probe, replace(small, axial_samples=samples, tgc_db_cm_mhz=0.7))
    shown = [np.where(f.mask, f.image, np.nan) for f in (simulator.render(AHEAD, seed) for seed in range(8))]
    level_db = np.nanmean(shown, axis=(0, 2))[20:-5] * 60 / 255
    rows_cm = np.arange(len(level_db)) * (depth_mm + 40 * (1 - np.cos(np.radians(35)))) / 10 / 200
    assert np.polyfit(rows_cm, level_db, 1)[0] == pytest.approx(0, abs=0.07)  # of 5.6 dB/cm


def test_4_density_grain_and_nesting(gel, slab, pencil, apart, amplitudes) -> None:
    """A uniform texture is interpolated before it is compared with the density, so the density is wrong; the texture is
    coarser than the pulse; one level of nesting is remembered (i4h raysim).
    """
    assert spikiness(0.02) / spikiness(0.1) == pytest.approx((3 / 0.02 - 2) / (3 / 0.1 - 2), rel=0.15)

    # The intensity of a Gaussian pulse's speckle is correlated over the pulse's own width.
    fine = SimulatorSettings(rays=1, image_shape=(8, 8))
    tissue = Tissue("t", 1540, 1.5, 0.0, 0.6, 0.0, 1.0)
    power = Simulator(Scene((), tissue, "s"), ConvexProbe(), fine).render(AHEAD).envelope.astype(float) ** 2
    power -= power.mean()
    lags = np.arange(1, 5)
    rho = [(power[lag:] * power[:-lag]).mean() / (power**2).mean() for lag in lags]
    grain = np.sqrt(-(lags**2) / np.log(rho) * 4 * np.log(2)) * 150 / 3072
    np.testing.assert_allclose(grain, 0.30, rtol=0.05)

    z = (1.5, 1.6, 1.75, 1.9)
    slabs = ((20, 130, z[1]), (40, 105, z[2]), (60, 85, z[3]))
    nested = Scene(tuple(slab(anechoic(f"t{v}", v), near, far) for near, far, v in slabs), gel, "s")
    for face, a, b in zip((20, 40, 60, 85, 105, 130), z[:3] + z[:0:-1], z[1:] + z[2::-1], strict=True):
        echo = amplitudes(nested, pencil, apart, (face - 3, face + 3)).mean()
        assert echo == pytest.approx(abs(a - b) / (a + b), rel=0.04)


def test_5_total_reflection_lets_nothing_through(gel, slab, pencil, apart) -> None:
    """Snell's law has impedances in place of speeds, and total reflection a negative number's root (MCRay-Tracing)."""
    behind = Tissue("fast", 2600, 4.5, 0.0, 0.6, 0.0, 1.0, specularity=0.0)
    total = Simulator(Scene((slab(gel, -400.0, 30.0),), behind, "s"), pencil, apart).render(tilted(40.0)).envelope
    assert np.isfinite(total).all()
    assert total[: round(35 / (150 / 1024))].max() == 0
    assert total[round(50 / (150 / 1024)) :].max() == 0


def test_6_a_sampled_path_is_weighted_once_and_starts_where_it_was_reflected(
    gel, slab, pencil, apart, amplitudes
) -> None:
    """Reflection is sampled with probability R and then weighted with R again, and transmission likewise, so energy is
    lost; a reflected ray starts on the surface although the surface's thickness moved the echo (MCRay-Tracing).
    """
    many = replace(apart, rays=128)
    gas = anechoic("gas", 1e-4)
    plates = Scene((slab(anechoic("a", 4.5), 30.0, 400.0), slab(gas, 60.0, 400.0)), gel, "s")
    assert amplitudes(plates, pencil, many, (50, 70)).mean() == pytest.approx(1 - 0.5**2, rel=0.01)
    again = amplitudes(plates, pencil, many, (75, 105)).mean() / (np.sqrt(np.pi) / 2)
    assert again > 0.8 * (1 - 0.5**2) * 0.5**2  # weighted twice, it would be 0.19 of that

    thick = Scene((plates.structures[0], slab(replace(gas, thickness_mm=1.5), 60.0, 400.0)), gel, "s")
    z = (np.arange(1024) + 0.5) * 150 / 1024
    mean_mm = np.sqrt(2 / np.pi) * 1.5  # of |N(0, 1.5 mm)|

    def centre(scene: Scene, near: float, far: float) -> float:
        part = (z > near) & (z < far)
        envelope = Simulator(scene, pencil, many).render(AHEAD).envelope[part].astype(float)
        return float((z[part] @ envelope).sum() / envelope.sum())

    assert centre(thick, 55, 75) - centre(plates, 55, 75) == pytest.approx(mean_mm, abs=0.05)
    assert centre(thick, 78, 110) - centre(plates, 78, 110) == pytest.approx(2 * mean_mm, abs=0.4)


def test_7_the_map_is_in_db_per_cm_and_the_pulse_has_no_fringes(gel, slab, apart) -> None:
    """Decibels are taken for nepers and millimetres for centimetres; a pulse cos(2 pi f x) lacks the speed of sound;
    scatterers are where a normal number exceeds the density, so more density gives fewer (MCRay-Tracing, burgercpp).
    """
    z = (np.arange(1024) + 0.5) * 150 / 1024
    face = slab(anechoic("hard", 4.5), 60.0, 400.0)
    for frequency in (1.0, 8.0):
        probe = ConvexProbe(fov_deg=0.002, frequency_mhz=frequency)
        lossy = Scene((slab(anechoic("lossy", 1.5, loss=3.0), 20.0, 30.0), face), gel, "s")
        _, attenuation = Simulator(lossy, probe, replace(apart, axial_samples=3072, image_shape=(100, 3))).maps(AHEAD)
        assert -20 * np.log10(attenuation[40, 1]) == pytest.approx(3.0 * frequency, abs=0.12)  # a sample takes as much
        line = Simulator(Scene((face,), gel, "s"), probe, apart).render(AHEAD).envelope[:, 0]
        np.testing.assert_allclose(line, 0.5 * np.exp(-4 * np.log(2) * ((z - 60) / 1.2) ** 2), atol=0.02 * 0.5)
    assert spikiness(0.02) > 2 * spikiness(0.2) > 0


def test_8_no_step_no_echo_and_depth_in_millimetres(gel, slab, ball, small, apart) -> None:
    """R goes through a sigmoid, which makes 0.5 of 0; the depth axis has no unit (LOTUS)."""
    same = Scene(
        (slab(replace(gel, name="other"), 30.0, 60.0), ball(replace(gel, name="third"), (0, 0, 90.0), 20.0)), gel, "s"
    )
    assert Simulator(same, ConvexProbe(), small).render(AHEAD).envelope.max() == 0

    face = Scene((slab(anechoic("hard", 4.5), 50.0, 400.0),), gel, "s")
    for depth_mm in (60.0, 150.0, 300.0):
        line = Simulator(face, ConvexProbe(fov_deg=0.002, depth_mm=depth_mm), apart).render(AHEAD).envelope[:, 0]
        spacing = depth_mm / apart.axial_samples
        assert (line.argmax() + 0.5) * spacing == pytest.approx(50.0, abs=spacing)
