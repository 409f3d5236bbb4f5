"""Interfaces and illumination of plane layers against closed forms: R_p, 1 - R^2, alpha f, the gain, the incidence."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import halfnorm

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import Simulator
from ablate.ultrasound.imaging.point_spread import axial_kernel
from ablate.ultrasound.transport.surface_maps import _show
from support.fans import KINDS, LINEAR

BODY = Tissue("body", 1540, 1.5, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
HARD = Tissue("hard", 1600, 2.0, 1.0, 0.6, 0.0, 1.0, roughness=0.0, specularity=4.0)
R = 0.5 / 3.5  # of a face between them, met at a right angle
PASSED_DB = 20 * np.log10(1 - R**2)  # through a face, there and back
ROW_MM = 150 / 512


def echo_db(interfaces: np.ndarray) -> np.ndarray:
    """Amplitude against that of a perfect reflector, with the gain: white, at 0.1, is 60 of 80 dB up."""
    return 80.0 * interfaces - 60 - 20


def light_db(illumination: np.ndarray) -> np.ndarray:
    return 72.0 * illumination - 48


@pytest.mark.parametrize("thickness_mm", [0.0, 0.3])
def test_a_flat_interface_returns_what_it_reflects_less_both_ways(pencil, apart, slab, ahead, thickness_mm) -> None:
    """Both faces of a slab, in the row of their mean depth; all other rows are dark."""
    hard, shift = replace(HARD, thickness_mm=thickness_mm), halfnorm.mean() * thickness_mm
    near, far = (170.5 * ROW_MM - shift, 239.5 * ROW_MM - shift)
    scene, settings = Scene((slab(hard, near, far),), BODY, "s"), replace(apart, tgc_db_cm_mhz=0.4)
    echo = echo_db(Simulator(scene, pencil, settings).beam_maps(ahead).interfaces)
    lost_db = 2 * 0.5 * 3 * near / 10
    gain_db = 2 * 0.4 * 3 * (np.array([170.5, 239.5]) * ROW_MM) / 10
    expected = 20 * np.log10(R) - np.array([lost_db, lost_db + 2 * 1.0 * 3 * (far - near) / 10 - PASSED_DB]) + gain_db
    np.testing.assert_allclose(echo[[170, 239]], expected[:, None] * np.ones(128), atol=0.05)
    assert np.delete(echo, [170, 239], axis=0).max() == -80


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("cosine", [62 / 64, 58.25 / 64])
@pytest.mark.parametrize("roughness", [0.0, 0.03])
def test_a_tilted_face_returns_less(pencil, apart, slab, roughness, cosine, axis) -> None:
    """E[R_p cos^n 2i] by Snell and Fresnel, of normals about the face's own; in the image plane and out of it."""
    pose, scene = np.eye(4), Scene((slab(replace(HARD, roughness=roughness), 40.0, 200.0),), BODY, "s")
    pose[:3, :3] = Rotation.from_euler(axis, np.arccos(cosine)).as_matrix()
    beam = Simulator(scene, pencil, apart).beam_maps(pose)
    random = np.random.default_rng(0)
    tilt = np.arccos(random.random(200_000) ** (roughness / (1 + roughness)))
    azimuth = random.uniform(0, 2 * np.pi, len(tilt))
    cos_i = cosine * np.cos(tilt) + np.sqrt(1 - cosine**2) * np.sin(tilt) * np.cos(azimuth)
    cos_t = np.sqrt(1 - (1600 / 1540) ** 2 * (1 - cos_i**2))
    reflected = (2.0 * cos_i - 1.5 * cos_t) / (2.0 * cos_i + 1.5 * cos_t)
    received = (reflected * np.maximum(2 * cos_i**2 - 1, 0) ** 4).mean()
    expected = 20 * np.log10(received) - 2 * 0.5 * 3 * (40 / cosine) / 10
    amplitude = np.where(beam.interfaces > 0, 10 ** (echo_db(beam.interfaces) / 20), 0)  # shared by two rows
    np.testing.assert_allclose(20 * np.log10(amplitude.sum(axis=0)), expected, atol=0.15 if roughness == 0 else 0.35)
    middle_mm = (np.arange(512) + 0.5) @ amplitude * ROW_MM / amplitude.sum(axis=0)
    np.testing.assert_allclose(middle_mm, 40 / cosine, atol=0.02)


def test_behind_a_slab_is_what_it_lets_through(slab, gel, ahead) -> None:
    """Loss and faces in its shadow; nothing of it beside it, and between them more and more."""
    settings = replace(Simulator(Scene((), gel, "s"), LINEAR).settings, layers=1, axial_samples=1000, scanlines=121)
    scene = Scene((slab(HARD, 30.0, 45.0, wide_mm=30.0),), BODY, "s")
    light = light_db(Simulator(scene, LINEAR, settings).beam_maps(ahead).illumination)
    depth = (np.arange(500) + 0.5) / 5
    free = (2 * 0.4 * 3 - 2 * 0.5 * 3) * depth / 10
    within = np.clip(depth - 30, 0, 15)
    behind = free - 2 * (1.0 - 0.5) * 3 * within / 10 + PASSED_DB * ((depth > 30).astype(float) + (depth > 45))
    sure = (np.abs(depth - 30) > 2) & (np.abs(depth - 45) > 2)  # the aperture is interpolated in depth
    np.testing.assert_allclose(light[sure, 60], behind[sure], atol=0.05)
    np.testing.assert_allclose(light[:, [2, 118]], free[:, None] * np.ones(2), atol=0.05)
    assert (np.diff(light[400, 60:]) >= -1e-3).all()
    assert light[400, 118] - light[400, 60] > 4


@KINDS
def test_where_nothing_is_in_the_way_only_the_gain_is_seen(gel, probe, ahead) -> None:
    simulator = Simulator(Scene((), gel, "s"), probe)
    beam = simulator.beam_maps(ahead)
    gain_db = 2 * 0.4 * 3 * (np.arange(1536) + 0.5) * (probe.depth_mm / 1536) / 10
    np.testing.assert_allclose(light_db(beam.illumination), np.minimum(gain_db, 24)[:, None] * np.ones(192), atol=1e-3)
    assert beam.interfaces.max() == 0


def test_haze_is_what_two_plates_reflect_to_one_another(pencil, apart, slab, gel, ahead) -> None:
    """(1 - R_a^2) R_b^2 R_a, once more as deep as their gap; over its depths the amplitude adds up to that."""
    plates = [replace(gel, name=name, impedance_mrayl=z) for name, z in (("a", 4.5), ("b", 1.5))]
    scene = Scene((slab(plates[0], 40.0, 400.0), slab(plates[1], 70.0, 400.0)), gel, "s")
    settings = replace(apart, reference_level=3e-3)  # so that hardly a ray is too faint to be followed
    echo = echo_db(Simulator(scene, pencil, settings).beam_maps(ahead).interfaces)
    around = slice(round(88 / ROW_MM), round(112 / ROW_MM))  # 100 mm, and six standard deviations of the spreading
    amplitude = 3e-3 / 0.1 * 10 ** (echo[around] / 20)
    total = amplitude.mean(axis=1).sum() * settings.samples_per_row / axial_kernel(pencil, settings).sum()
    assert total == pytest.approx((1 - 0.5**2) * 0.5**3, rel=0.2)  # one ray a scanline, every second one reflected
    assert echo[round(85 / ROW_MM)].max() == -80


def test_what_is_not_a_number_stays_so_and_is_no_grey_level() -> None:
    haze, pencils_db = np.zeros((4, 8)), np.full((1, 4, 8), -10.0)
    haze[1, 2], all_db = np.nan, pencils_db.copy()
    all_db[0, 3, 5] = np.nan
    interfaces, illumination = np.empty((2, 4, 8), np.float32)
    levels = pencils_db, all_db
    _show(np.zeros((1, 4, 8), np.float32), levels, haze, np.zeros((2, 8)), (interfaces, illumination), 0, 4)
    assert np.argwhere(np.isnan(interfaces)).tolist() == [[1, 2]]
    assert [3, 5] in np.argwhere(np.isnan(illumination)).tolist()
