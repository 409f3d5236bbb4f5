"""Probes as the command line takes them: their frames, their data sheets, and what they are known by."""

from dataclasses import replace
from math import asin, degrees
from typing import Any

import pytest

from ablate.command.compose import jobs_of
from ablate.command.describe import description
from ablate.setting import plain
from ablate.settings.conf import build
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.sources.source import source_of
from ablate.ultrasound import ConvexProbe, LinearProbe
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.pulse import pulse_widths

OTHERS = ("linear", "phased", "c5-2v", "l11-5v", "p4-2v")
SPEED_MM_US = 1.54


def composed(*arguments: str) -> StudySettings:
    return jobs_of(arguments)[0].settings


def test_a_probe_is_known_by_its_kind_and_its_values() -> None:
    with_default, named = composed(), composed("probe=convex")
    assert with_default == named
    probe: dict[str, Any] = source_of(named).identity()["probe"]
    assert probe == {"kind": "convex", "radius_mm": 40.0, "fov_deg": 70.0, "depth_mm": 150.0, "frequency_mhz": 3.0}
    assert composed("preset=paper").probe == ConvexProbe()


@pytest.mark.parametrize("preset", ["tiny", "quick", "laptop", "fine", "paper"])
@pytest.mark.parametrize("probe", OTHERS)
def test_the_frame_keeps_the_rows_of_the_preset_and_has_square_pixels(probe: str, preset: str) -> None:
    before, s = composed(f"preset={preset}"), composed(f"preset={preset}", f"probe={probe}")
    assert s.simulator.image_shape[0] == before.simulator.image_shape[0]
    height, width = pixel_size_mm(s.probe, s.simulator.image_shape)
    assert width == pytest.approx(height, rel=0.01)
    assert min(pulse_widths(s.probe, s.simulator)[:2]) >= 1.99 * height
    assert s.training.crop == before.training.crop


def test_what_is_asked_for_wins() -> None:
    s = composed("probe=linear", "probe.depth_mm=30", "simulator.image_shape=[64,80]", "simulator.axial_fwhm_mm=0.05")
    assert s.probe == LinearProbe(38.0, 30.0, 7.5)
    assert s.simulator.image_shape == (64, 80)
    assert s.simulator.axial_fwhm_mm == 0.05


@pytest.mark.parametrize("probe", OTHERS)
def test_settings_are_read_back_from_json(probe: str) -> None:
    s = composed(f"probe={probe}")
    assert build(StudySettings, plain(s)) == s
    of_earlier = plain(s) | {"tracking": plain(s.tracking) | {"gone": None}}  # a key that no setting has any more
    assert build(StudySettings, of_earlier, stored=True) == s
    with pytest.raises(ValueError, match=r"tracking\.gone"):
        build(StudySettings, of_earlier)
    assert source_of(s).identity() != source_of(replace(s, probe=replace(s.probe, depth_mm=41.0))).identity()


@pytest.mark.parametrize(("probe", "active"), [("C5-2v", 0.5), ("P4-2v", 1.0), ("L11-5v", None)])
def test_real_probes_have_the_values_of_their_data_sheets(probe: str, active: float | None) -> None:
    """As PyMUST tabulates them; its widths are those of a pulse, and of a beam that goes both ways by one aperture."""
    pymust = pytest.importorskip("pymust")
    sheet = dict(pymust.getparam(probe))
    s = composed(f"probe={probe.lower()}", "preset=paper", "simulator.image_shape=[4000,4000]")
    frequency_mhz, pitch_mm = sheet["fc"] * 1e-6, sheet["pitch"] * 1e3
    span_mm = (sheet["Nelements"] - 1) * pitch_mm
    assert s.probe.frequency_mhz == pytest.approx(frequency_mhz)
    if isinstance(s.probe, ConvexProbe):
        radius_mm = sheet["radius"] * 1e3
        assert s.probe.radius_mm == pytest.approx(radius_mm)
        between = 2 * asin(pitch_mm / 2 / radius_mm)  # the pitch is a chord
        assert s.probe.fov_deg == pytest.approx(degrees(between * (sheet["Nelements"] - 1)), abs=0.01)
    else:
        assert sheet["radius"] == float("inf")
        own_span_mm = s.probe.width_mm if isinstance(s.probe, LinearProbe) else s.probe.aperture_mm
        assert own_span_mm == pytest.approx(span_mm)
    own = pulse_widths(s.probe, s.simulator)
    wavelength_mm, focus_mm = SPEED_MM_US / frequency_mhz, sheet["focus"] * 1e3
    height_mm = sheet["height"] * 1e3
    assert s.simulator.focus_mm == focus_mm
    assert own.elevational_mm == pytest.approx(0.886 * wavelength_mm * focus_mm / height_mm, rel=0.02)
    pulse_us = 0.8825 / (sheet["bandwidth"] / 100 * frequency_mhz)
    assert own.axial_mm == pytest.approx(SPEED_MM_US / 2 * pulse_us, rel=0.02)
    f_number = 2.0 if active is None else focus_mm / (active * span_mm)
    assert own.lateral_mm == pytest.approx(0.886 * wavelength_mm * f_number, rel=0.03)


@pytest.mark.parametrize("preset", ["tiny", "quick", "fine"])
def test_frequency_acts_as_on_a_scanner_in_every_preset_but_the_papers(preset: str) -> None:
    s, paper = composed(f"preset={preset}").simulator, composed("preset=paper").simulator
    assert (s.noise_level_db, s.most_gain_db) == (-110.0, 45.0)
    assert s.axial_fwhm_mm is s.lateral_fwhm_mm is s.elevational_fwhm_mm is None
    assert (paper.noise_level_db, paper.most_gain_db) == (-177.0, None)
    assert (paper.axial_fwhm_mm, paper.lateral_fwhm_mm, paper.elevational_fwhm_mm) == (0.3, 0.8, 2.5)


def test_what_makes_the_pulse_the_noise_and_the_gain_is_part_of_the_data_and_the_pulse_is_said() -> None:
    words = ("bandwidth=0.6", "element_height_mm=10", "noise_level_db=-120", "most_gain_db=50", "axial_fwhm_mm=1.3")
    known = {
        str(source_of(composed(*chosen)).identity()) for chosen in ([], *([f"simulator.{word}"] for word in words))
    }
    assert len(known) == 1 + len(words)
    text = description(jobs_of(["variant=sa2h"]))
    assert (
        "pulse of 3 MHz: 1.23 mm along (two pixels; of a finer image 0.32 mm); 1.59 mm across at 70 mm; 2.45 mm out"
        in text
    )


def test_steering_decides_nothing_of_one_angle() -> None:
    """Data sets of one angle keep the names that they had before frames could be compounded."""
    one, three = composed(), composed("simulator.compound_angles=3")
    kept = [key for key in source_of(one).identity()["simulator"] if key.startswith("compound")]
    assert not kept
    assert source_of(one).identity() == source_of(composed("simulator.compound_steer_deg=5")).identity()
    steered = composed("simulator.compound_angles=3", "simulator.compound_steer_deg=5")
    assert len({str(source_of(s).identity()) for s in (one, three, steered)}) == 3


def test_compounding_that_is_not_defined_is_refused_with_its_key() -> None:
    phased = source_of(composed("probe=phased", "simulator.compound_angles=3"))
    with pytest.raises(
        ConfigurationError, match=r"^simulator\.compound_angles=3: allowed with a phased probe is 1, .*"
    ):
        phased.check("sa2h")
    one = source_of(composed("model.attenuation=compound"))
    with pytest.raises(ConfigurationError, match=r"^model\.attenuation=compound: .* which is 1; allowed are integral"):
        one.check("sa2h")
    source_of(composed("model.attenuation=compound", "simulator.compound_angles=3")).check("sa2h")
