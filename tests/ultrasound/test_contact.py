"""Whether the probe can see the scene at all, told from labels."""

import math

import numpy as np
import pytest

from ablate.anatomy import Tissue, load_tissues
from ablate.ultrasound import ConvexProbe
from ablate.ultrasound.surfaces.slices import contact_warning

TABLE = load_tissues()
GEL = TABLE["coupling_gel"]
SAMPLES = 3072


def lines(*layers: tuple[int, float], scanlines: int = 192, depth_mm: float = 150.0) -> np.ndarray:
    """Labels of scanlines that all meet the same layers: (label, thickness in mm); the last goes on for ever."""
    depth = (np.arange(SAMPLES) + 0.5) * depth_mm / SAMPLES
    ends = np.cumsum([thickness for _, thickness in layers[:-1]])
    row = np.array([label for label, _ in layers], np.uint8)[np.searchsorted(ends, depth)]
    return np.tile(row, (scanlines, 1))


@pytest.mark.parametrize("name", ["bone", "fetal_bone", "gas"])
@pytest.mark.parametrize("frequency_mhz", [3.0, 8.0])
def test_a_probe_in_bone_or_gas_is_warned_of(name: str, frequency_mhz: float) -> None:
    said = contact_warning(lines((1, 150.0)), (GEL, TABLE[name]), ConvexProbe(frequency_mhz=frequency_mhz))
    assert said is not None
    assert f"most scanlines start in {name}," in said
    assert "\n" not in said


@pytest.mark.parametrize("name", [name for name in TABLE if name not in ("bone", "fetal_bone", "gas")])
def test_a_probe_in_anything_else_is_not(name: str) -> None:
    assert contact_warning(lines((1, 150.0)), (Tissue("water"), TABLE[name]), ConvexProbe()) is None


@pytest.mark.parametrize(("impedance", "attenuation"), [(1.5, 7.0), (6.0, 7.0), (6.0, 4.0), (0.05, 1.0)])
def test_the_line_is_drawn_where_40_db_are_lost_there_and_back(impedance: float, attenuation: float) -> None:
    reflected = ((impedance - 1.5) / (impedance + 1.5)) ** 2
    face_db = -20 * math.log10(1 - reflected)
    critical_mm = 10 * (40.0 - face_db) / (2 * attenuation * 8.0)
    plate = Tissue("plate", impedance_mrayl=impedance, attenuation_db_cm_mhz=attenuation)
    for share, warned in ((0.97, False), (1.03, True)):
        labels = lines((1, share * critical_mm), (2, 150.0))
        said = contact_warning(labels, (GEL, plate, TABLE["liver"]), ConvexProbe(frequency_mhz=8.0))
        assert (said is not None) == warned


def test_what_lies_behind_a_rib_or_within_half_of_the_face_is_no_matter() -> None:
    tissues = (GEL, TABLE["skin"], TABLE["bone"])
    assert contact_warning(lines((1, 4.0), (2, 150.0)), tissues, ConvexProbe()) is None
    labels = lines((2, 150.0))
    labels[:96] = lines((1, 150.0), scanlines=96)
    assert contact_warning(labels, tissues, ConvexProbe()) is None
    labels[95] = 2
    assert contact_warning(labels, tissues, ConvexProbe()) is not None


def test_a_probe_that_looks_past_the_scene_is_warned_of() -> None:
    labels = lines((0, 150.0))
    said = contact_warning(labels, (GEL, TABLE["liver"]), ConvexProbe())
    assert said == "no scanline meets anything but coupling_gel, the background: the probe looks past the scene"
    labels[50, -1] = 1
    assert contact_warning(labels, (GEL, TABLE["liver"]), ConvexProbe()) is None


def test_nothing_but_background_is_as_it_should_be_where_that_is_all_there_is_or_scatters() -> None:
    labels = lines((0, 150.0))
    assert contact_warning(labels, (GEL,), ConvexProbe()) is None
    assert contact_warning(labels, (TABLE["liver"], TABLE["bile"]), ConvexProbe()) is None


def test_air_before_the_whole_face_is_warned_of() -> None:
    said = contact_warning(lines((0, 2.0), (1, 150.0)), (TABLE["gas"], TABLE["liver"]), ConvexProbe())
    assert said is not None
    assert "start in gas" in said


def test_the_words_are_the_same_for_every_pose_in_the_same_trouble() -> None:
    tissues = (GEL, TABLE["skin"], TABLE["bone"])
    first = contact_warning(lines((2, 150.0)), tissues, ConvexProbe())
    other = lines((2, 20.0), (1, 150.0))
    other[:40] = 1
    assert first == contact_warning(other, tissues, ConvexProbe())


@pytest.mark.parametrize("samples", [1, 9])
def test_too_few_samples_tell_nothing(samples: int) -> None:
    labels = np.ones((4, samples), np.uint8)
    assert contact_warning(labels, (GEL, TABLE["bone"]), ConvexProbe()) is None


@pytest.mark.parametrize("name", ["radius_mm", "fov_deg", "depth_mm", "frequency_mhz"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, "8"])
def test_a_probe_that_cannot_be_is_refused(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{name}=.*: allowed are numbers from"):
        ConvexProbe(**{name: value})  # type: ignore[arg-type]
