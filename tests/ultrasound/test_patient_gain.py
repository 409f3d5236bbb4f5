"""The time gain of `tgc=patient`: layers in closed form, and what must not change it."""

import logging
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue, load_tissues
from ablate.ultrasound import (
    ConvexProbe,
    LinearProbe,
    Simulator,
    SimulatorSettings,
    TimeGain,
    compensated_attenuation,
    compensated_beam,
    with_patient_gain,
)

TISSUES = load_tissues()
PATIENT = SimulatorSettings(tgc=TimeGain.patient, image_shape=(64, 64), scanlines=32, axial_samples=512, rays=2)
LINEAR = LinearProbe(width_mm=20, depth_mm=70, frequency_mhz=5)
AHEAD = np.eye(4)[None]


def slab(tissue: Tissue, near_mm: float, far_mm: float, width_mm: float = 400.0, aside_mm: float = 0.0) -> Structure:
    box = trimesh.creation.box((width_mm, 400, far_mm - near_mm))
    return Structure(box.apply_translation((aside_mm, 0, (near_mm + far_mm) / 2)), tissue)


def curve(*structures: Structure) -> np.ndarray:
    scene = Scene(structures, TISSUES["coupling_gel"], "slabs")
    return np.array(with_patient_gain(scene, LINEAR, PATIENT, AHEAD).time_gain_db)


def test_one_tissue_has_its_own_slope() -> None:
    liver = replace(TISSUES["liver"], attenuation_power=1.0)
    np.testing.assert_allclose(
        curve(slab(liver, -5, 200)), 2 * liver.attenuation_db_cm_mhz * 5 * np.arange(8), atol=0.051
    )


def test_fluid_is_passed_over_and_the_curve_never_falls() -> None:
    """Half of the scanlines pass 30 mm of fluid."""
    liver, fluid = TISSUES["liver"], TISSUES["amniotic_fluid"]
    here = curve(slab(liver, -5, 200), slab(fluid, 20, 50, 20.0, 10.0))
    assert (np.diff(here) >= 0).all()
    assert (here <= curve(slab(liver, -5, 200)) + 0.051).all()
    assert here[-1] >= curve(slab(liver, -5, 200), slab(fluid, 20, 50))[-1] - 0.051


def test_tissue_in_the_shadow_of_bone_does_not_count() -> None:
    liver = TISSUES["liver"]
    with_bone = curve(slab(liver, -5, 200), slab(TISSUES["bone"], 30, 34, 8.0))
    np.testing.assert_allclose(with_bone, curve(slab(liver, -5, 200)), atol=0.15)


def test_tissue_is_equally_bright_at_all_depths() -> None:
    """The curve, which knows attenuation alone, makes simulated speckle flat within 1 dB."""
    scene = Scene(
        (slab(replace(TISSUES["soft_tissue"], texture_contrast_db=0.0), -5, 200),), TISSUES["soft_tissue"], "s"
    )
    probe = ConvexProbe(depth_mm=80, frequency_mhz=4)
    settings = with_patient_gain(scene, probe, replace(PATIENT, scanlines=96, noise_level_db=-300.0), AHEAD)
    simulator = Simulator(scene, probe, settings)
    images = np.stack([simulator.image(np.eye(4), seed) for seed in range(6)])
    rows = [images[:, a:b, 24:40].mean() for a, b in ((16, 28), (28, 40), (40, 52))]
    assert np.ptp(rows) * 60 / 255 < 1.5


def test_what_needs_no_curve_is_as_it_was(caplog: pytest.LogCaptureFixture) -> None:
    scene = Scene((slab(TISSUES["liver"], -5, 200),), TISSUES["coupling_gel"], "liver")
    for settings in (replace(PATIENT, tgc=TimeGain.fixed), replace(PATIENT, time_gain_db=(0, 1, 2, 3, 4, 5, 6, 7))):
        assert with_patient_gain(scene, LINEAR, settings, AHEAD) is settings
    gel = Scene((slab(TISSUES["coupling_gel"], 5, 50),), TISSUES["coupling_gel"], "gel")
    with caplog.at_level(logging.WARNING):
        assert with_patient_gain(gel, LINEAR, PATIENT, AHEAD).tgc is TimeGain.fixed
    assert "no tissue that scatters is seen from these poses" in caplog.text


def test_a_straight_curve_is_the_fixed_gain() -> None:
    scene = Scene((slab(TISSUES["liver"], -5, 200),), TISSUES["coupling_gel"], "liver")
    straight = tuple(2 * 0.4 * 5 * depth for depth in range(8))
    fixed, curved = (
        Simulator(scene, LINEAR, replace(PATIENT, tgc=TimeGain.fixed, time_gain_db=g)) for g in (None, straight)
    )
    assert np.abs(fixed.image(np.eye(4)).astype(int) - curved.image(np.eye(4))).max() <= 1


def test_sliders_that_fall_at_the_end_leave_noise_and_echoes_before_as_they_were() -> None:
    """Noise has one level before the gain, and Russian roulette ends what is faint where the gain is largest."""
    scene = Scene((slab(TISSUES["liver"], -5, 200),), TISSUES["coupling_gel"], "liver")
    gel = Scene((), TISSUES["coupling_gel"], "gel")
    for shown in (scene, gel):
        flat, fallen = (
            Simulator(shown, LINEAR, replace(PATIENT, tgc=TimeGain.fixed, time_gain_db=(20.0,) * 7 + (last,)))
            for last in (20.0, -20.0)
        )
        shallow = slice(0, PATIENT.image_shape[0] // 2)
        np.testing.assert_array_equal(fallen.image(np.eye(4))[shallow], flat.image(np.eye(4))[shallow])


def test_a_simulator_without_the_curve_says_what_makes_it() -> None:
    with pytest.raises(ValueError, match="tgc=patient: a curve is needed, which with_patient_gain computes from poses"):
        Simulator(Scene((), TISSUES["liver"], "liver"), LINEAR, PATIENT)
    with pytest.raises(ValueError, match=r"time_gain_db=.*allowed are 8 numbers from -300 to 300, or null"):
        replace(PATIENT, time_gain_db=(1.0, 2.0))


def test_a_list_of_poses_and_an_array_of_sliders_are_taken_as_they_are_meant() -> None:
    scene = Scene((slab(TISSUES["liver"], -5, 200),), TISSUES["coupling_gel"], "liver")
    chosen = with_patient_gain(scene, LINEAR, PATIENT, list(AHEAD))
    assert chosen == with_patient_gain(scene, LINEAR, PATIENT, AHEAD)
    sliders = chosen.time_gain
    attenuation = np.random.default_rng(0).random((8, 6)).astype(np.float32)  # as many rows as there are sliders
    for compensated in (compensated_attenuation, compensated_beam):
        given = [compensated(attenuation, LINEAR, kind(sliders)) for kind in (tuple, list, np.array)]
        assert given[0].std() > 0.1
        assert all((values == given[0]).all() for values in given)
        assert (compensated(attenuation, LINEAR, np.float32(0.5)) == compensated(attenuation, LINEAR, 0.5)).all()


def test_settings_of_the_low_quality_image_may_be_changed() -> None:
    assert (SimulatorSettings.low_quality().rays, SimulatorSettings.low_quality().layers) == (1, 1)
    assert SimulatorSettings.low_quality(rays=8) == SimulatorSettings(rays=8, layers=1)
