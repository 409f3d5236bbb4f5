"""What must hold of every kind of probe, against closed forms of its own geometry."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import LinearProbe, Probe, Simulator, SimulatorSettings
from ablate.ultrasound.probe import face_points, fan_of, fan_outline, square_pixels
from ablate.ultrasound.settings import probe_from
from support.fans import CONVEX, KINDS, LINEAR, PHASED, across_and_depth, pixels, place

TISSUE = Tissue("t", 1540, 1.5, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
CLEAR = replace(TISSUE, attenuation_db_cm_mhz=0.0)
SPECKLE = SimulatorSettings(
    scanlines=161, axial_samples=1024, rays=1, layers=1, image_shape=(50, 50), axial_fwhm_mm=0.6, lateral_fwhm_mm=1.5,
    focus_mm=60.0, focal_range_mm=40.0, noise_level_db=-300.0, tgc_db_cm_mhz=0.0,
)  # fmt: skip


def level_db(envelope: np.ndarray) -> float:
    return float(10 * np.log10((envelope.astype(float) ** 2).mean()))


@KINDS
def test_the_mask_is_the_fan(probe) -> None:
    shape = square_pixels(probe, 240)
    mask = Simulator(Scene((), CLEAR, "s"), probe, replace(SPECKLE, image_shape=shape)).mask
    across, depth = across_and_depth(probe, *pixels(probe, shape))
    expected = (depth >= 0) & (depth <= probe.depth_mm) & (np.abs(across) <= 1)
    sure = np.minimum(np.abs(np.abs(across) - 1), np.minimum(np.abs(depth), np.abs(depth - probe.depth_mm))) > 1e-9
    np.testing.assert_array_equal(mask[sure], expected[sure])
    assert (fan_of(probe).size_mm[0] / shape[0]) == pytest.approx(fan_of(probe).size_mm[1] / shape[1], rel=0.003)
    assert mask.all() == isinstance(probe, LinearProbe)


@KINDS
def test_tissue_at_the_slope_of_the_tgc_is_flat(probe, ahead) -> None:
    """In depth from the face to the end, and from the first scanline to the last."""
    settings = replace(SPECKLE, tgc_db_cm_mhz=0.5, axial_samples=2048, axial_fwhm_mm=0.3)
    powers = []
    simulator = Simulator(Scene((), TISSUE, "s"), probe, settings)
    for seed in range(8):
        envelope = simulator.render(ahead, seed).envelope.astype(float)
        depth_cm = (np.arange(2048)[:, None] + 0.5) * probe.depth_mm / 2048 / 10
        powers.append((envelope * 10 ** (2 * 0.5 * 3.0 * depth_cm / 20)) ** 2)
    power = np.mean(powers, axis=0)
    bands_db = 10 * np.log10([part.mean() for part in np.array_split(power[20:], 10)])
    parts_db = 10 * np.log10([part.mean() for part in np.array_split(power, 7, axis=1)])
    assert np.ptp(bands_db) < 1.5
    assert np.ptp(parts_db) < 1.0
    expected = settings.scatterer_level_db + 10 * np.log10(0.6)  # of [u < 0.6] n: the variance is 0.6
    assert 10 * np.log10(power.mean()) == pytest.approx(expected, abs=0.5)


def test_lines_that_meet_do_not_count_their_common_scatterers_twice(ahead) -> None:
    """The first millimetres of a sector, where many scanlines lie in one cell of the scatterers' lattice."""
    simulator = Simulator(Scene((), CLEAR, "s"), PHASED, replace(SPECKLE, axial_samples=2048, axial_fwhm_mm=0.3))
    power = np.mean([simulator.render(ahead, seed).envelope.astype(float) ** 2 for seed in range(40)], axis=0)
    near = 10 * np.log10(power[20:160].mean() / power[600:].mean())  # 1 to 8 mm
    assert near == pytest.approx(0, abs=1.2)


@pytest.mark.parametrize(
    "changes", [{"scanlines": 600}, {"scatterer_pitch_mm": 0.5}, {"layers": 3, "layer_extent_mm": 0.0},
                {"layers": 9, "layer_extent_mm": 0.2}], ids=str,
)  # fmt: skip
def test_the_level_does_not_depend_on_how_many_lines_share_a_scatterer(changes, ahead) -> None:
    """Scanlines and layers that are closer together than the cells of the scatterers."""
    levels = []
    for settings in (SPECKLE, replace(SPECKLE, **changes)):
        simulator = Simulator(Scene((), CLEAR, "s"), CONVEX, settings)
        levels.append([level_db(simulator.render(ahead, seed).envelope[20:400]) for seed in range(4)])
    assert np.mean(levels[1]) == pytest.approx(np.mean(levels[0]), abs=0.6)


@pytest.mark.parametrize("turn", [2, 5, 7, 9])
def test_a_flat_face_on_a_flat_wall_sends_all_sound_into_it(turn) -> None:
    """The elements lie in the wall to the last bit, up to rounding: nothing tells them inside from outside."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=turn).as_matrix()
    pose[:3, 3] = 10 * turn, 3, -7
    images = []
    for gap_mm in (0.0, 0.01):
        body = trimesh.creation.box(bounds=[[-80, -80, gap_mm], [80, 80, 200]]).apply_transform(pose)
        scene = Scene((Structure(body, replace(TISSUE, impedance_mrayl=1.65)),), replace(CLEAR, name="gel"), "s")
        shown = replace(SPECKLE, rays=16, aperture_mm=0.2, image_shape=(128, 100), noise_level_db=-75.0)
        images.append(Simulator(scene, LINEAR, shown).render(pose).image[10:].astype(int))
    assert np.abs(images[1] - images[0]).mean() < 0.5
    assert np.abs((images[1] - images[0]).mean(axis=0)).max() < 3


@KINDS
def test_a_plane_is_seen_where_it_is(probe, slab, gel, ahead) -> None:
    """The brightest pixel of every column that the plane crosses in the fan, and the first of its label."""
    hard = Tissue("hard", 1540, 3.0, 0.0, 0.0, 0.0, 0.0, roughness=0.5, specularity=0.0)
    shape = square_pixels(probe, 400)
    settings = replace(SPECKLE, image_shape=shape, rays=16, axial_fwhm_mm=0.6, dynamic_range_db=80.0)
    frame = Simulator(Scene((slab(hard, 62.0, 300.0),), gel, "s"), probe, settings).render(ahead)
    x, z = pixels(probe, shape)
    rows = np.abs(z[:, 0] - 62).argmin()
    crossed = frame.mask[rows - 6] & frame.mask[rows + 6]
    assert crossed.sum() > 150
    brightest = z[frame.image.argmax(axis=0), 0][crossed]
    # A beam that is oblique and wide spreads the echo along the arc of equal depth: half a pulse, half a pixel.
    assert np.median(np.abs(brightest - 62)) < 0.3
    middle = crossed & (np.abs(x) < 8)
    assert np.abs(z[frame.image.argmax(axis=0), 0][middle] - 62).max() < 0.5
    assert (frame.segmentation[: rows - 1][:, crossed] < 2).all()
    assert (frame.segmentation[rows + 1, crossed] == 2).all()


@KINDS
def test_speckle_is_fully_developed(probe, ahead) -> None:
    """Mean over standard deviation of a Rayleigh distribution: sqrt(pi / (4 - pi)) = 1.91."""
    settings = replace(SPECKLE, axial_samples=3072, axial_fwhm_mm=0.3, layers=3)
    envelope = Simulator(Scene((), CLEAR, "s"), probe, settings).render(ahead).envelope.astype(float)
    for rows in (slice(600, 1200), slice(1200, 2000), slice(2000, 3000)):
        part = envelope[rows]
        assert part.mean() / part.std() == pytest.approx(math.sqrt(math.pi / (4 - math.pi)), abs=0.08)


@KINDS
def test_attenuation_is_the_integral_along_the_scanline(probe, slab, ahead) -> None:
    layers = ((5.0, 20.0, 1.2, 1.0), (30.0, 55.0, 0.1, 1.0), (55.2, 80.0, 0.8, 1.3))  # mm, mm, alpha, b
    tissues = (Tissue(f"t{i}", 1540, 1.5, alpha, attenuation_power=b) for i, (_, _, alpha, b) in enumerate(layers))
    slabs = tuple(slab(tissue, near, far) for tissue, (near, far, _, _) in zip(tissues, layers, strict=True))
    settings = SimulatorSettings(image_shape=(200, 220))
    scene = Scene(slabs, Tissue("body", 1540, 1.5, 0.3), "s")
    labels, attenuation = Simulator(scene, probe, settings).maps(ahead)

    def left(across: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Amplitude after the straight way from the scanline's start to a point: loss grows evenly with z on it."""
        z0, z = place(probe, across, 0 * depth)[1], place(probe, across, depth)[1]
        slope = np.where(z == z0, 1.0, depth / np.where(z == z0, 1.0, z - z0))
        db = 0.3 * 3.0 / 10 * depth
        for near, far, alpha, b in layers:
            within = np.clip(np.minimum(z, far) - np.maximum(z0, near), 0, None) * slope
            db = db + within * (alpha * 3.0**b - 0.3 * 3.0) / 10
        return 10 ** (-db / 20)

    ends = np.arange(1, settings.axial_samples + 1) * probe.depth_mm / settings.axial_samples
    lines = np.linspace(-1, 1, settings.scanlines)
    percentile = np.percentile(left(*np.meshgrid(lines, ends)), 98)
    expected = np.minimum(1, left(*across_and_depth(probe, *pixels(probe, (200, 220)))) / percentile)
    fan = labels > 0
    np.testing.assert_allclose(attenuation[fan], expected[fan], rtol=6e-3)
    assert np.ptp(expected[fan]) > 0.8
    assert 0 < (expected[fan] == 1).mean() < 0.04
    assert attenuation[~fan].max(initial=0) == 0


def sigma_mm(probe: Probe, depth_mm: float, lines: slice, seeds: int = 6) -> float:
    """Lateral standard deviation of the beam from speckle: intensities a lines apart correlate as exp(-a^2/(2 s^2))."""
    simulator = Simulator(Scene((), CLEAR, "s"), probe, SPECKLE)
    row = round(depth_mm / probe.depth_mm * SPECKLE.axial_samples)
    near = slice(row - 40, row + 40)
    power = [simulator.render(np.eye(4), seed).envelope[near, lines].astype(float) ** 2 for seed in range(seeds)]
    power = np.concatenate(power)
    across = np.linspace(-1, 1, SPECKLE.scanlines)[lines]
    x, z = place(probe, across, np.full(len(across), depth_mm))
    spacing = np.hypot(np.diff(x), np.diff(z)).mean()
    for lag in range(1, 40):
        correlation = np.corrcoef(power[:, :-lag].ravel(), power[:, lag:].ravel())[0, 1]
        if correlation < 0.6:
            return float(lag * spacing / np.sqrt(-2 * np.log(correlation)))
    raise AssertionError("the beam is wider than 40 scanlines")


MIDDLE, SIDE = slice(55, 106), slice(8, 34)


def test_the_beam_of_a_linear_probe_is_as_wide_at_all_depths() -> None:
    sigmas = [sigma_mm(LINEAR, depth, slice(5, -5)) for depth in (12, 30, 60, 90)]
    assert sigmas == pytest.approx([1.5 / math.sqrt(8 * math.log(2))] * 4, rel=0.12)


def test_the_beam_of_a_phased_probe_widens_with_depth_and_angle() -> None:
    """As depth over the aperture seen from there: z / (D cos(angle)), and 1.5 mm at 60 mm straight ahead."""
    at_focus = 1.5 / math.sqrt(8 * math.log(2))
    ahead = [sigma_mm(PHASED, depth, MIDDLE, 12) for depth in (30, 60, 90)]
    assert ahead == pytest.approx([at_focus * depth / 60 for depth in (30, 60, 90)], rel=0.15)
    angle = np.radians(40 * np.abs(np.linspace(-1, 1, 161))[SIDE])
    aside = sigma_mm(PHASED, 60, SIDE, 12) / sigma_mm(PHASED, 60, MIDDLE, 12)
    assert aside == pytest.approx((1 / np.cos(angle)).mean(), rel=0.1)
    assert (1 / np.cos(angle)).mean() > 1.15


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = (x.astype(float) ** 2 / (x.astype(float) ** 2).mean(axis=1, keepdims=True) for x in (a, b))
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


@pytest.mark.parametrize(("probe", "least"), [(CONVEX, 0.999), (LINEAR, 0.999), (PHASED, 0.98)])
def test_speckle_stays_when_the_probe_swings_or_slides(probe, least) -> None:
    """Moved by five scanlines, about the middle of curvature or along the face: each line lies where its fifth did."""
    simulator, pose = Simulator(Scene((), CLEAR, "s"), probe, SPECKLE), np.eye(4)
    if isinstance(probe, LinearProbe):
        pose[0, 3] = 5 * 60 / 160
    else:
        angle, radius = 5 * np.radians(probe.fov_deg) / 160, probe.radius_mm if probe is CONVEX else 0.0
        pose[:3, :3] = Rotation.from_euler("y", angle).as_matrix()
        pose[:3, 3] = radius * pose[:3, 2] - (0, 0, radius)
    before, after = (simulator.render(p).envelope for p in (np.eye(4), pose))
    clear = (slice(300, None), slice(40, -40))  # the beam itself depends on the angle to the face
    assert correlation(before[:, 5:][clear], after[:, :-5][clear]) > least


@KINDS
def test_a_shadow_lies_behind_bone_along_the_scanlines(probe, ball, ahead) -> None:
    """The middle of the shadow in S, A and the image, for a bone aside of the middle."""
    bone = Tissue("bone", 2800, 1.5, 12.0, 0.6, 0.0, 1.0, roughness=0.0)
    x0, z0 = (float(value) for value in place(probe, np.array(0.5), np.array(40.0)))
    shape = square_pixels(probe, 300)
    settings = replace(SPECKLE, image_shape=shape, rays=8)
    frame = Simulator(Scene((ball(bone, (x0, 0.0, z0), 4.0),), CLEAR, "s"), probe, settings).render(ahead)
    across, depth = across_and_depth(probe, *pixels(probe, shape))
    band = frame.mask & (depth > 70) & (depth < 90)
    on_line, elsewhere = band & (np.abs(across - 0.5) < 0.02), band & (np.abs(across - 0.5) > 0.35)
    assert frame.attenuation[on_line].mean() < 0.2 * frame.attenuation[elsewhere].mean()
    assert frame.image[on_line].mean() < frame.image[elsewhere].mean() - 60


def test_faces_and_fans_have_their_sizes() -> None:
    for probe, wide in ((CONVEX, 2 * 30 * math.sin(math.radians(30))), (LINEAR, 60.0), (PHASED, 20.0)):
        face = face_points(probe)
        assert np.ptp(face[:, 0]) == pytest.approx(wide)
        assert np.ptp(face[:, 2]) == pytest.approx(30 * (1 - math.cos(math.radians(30))) if probe is CONVEX else 0)
        assert tuple(np.ptp(fan_outline(probe), axis=0)[[2, 0]]) == pytest.approx(fan_of(probe).size_mm, rel=1e-3)
    assert fan_of(LINEAR).size_mm == (100.0, 60.0)
    assert fan_of(PHASED).size_mm == pytest.approx((100.0, 200 * math.sin(math.radians(40))))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "linear", "radius_mm": 40.0}, "radius_mm=40.0: a linear probe has width_mm, depth_mm"),
        ({"kind": "matrix"}, "kind='matrix': allowed are convex, linear, phased"),
        ({"width_mm": 3.0}, "width_mm=3.0: a convex probe has radius_mm, fov_deg"),
        ({"kind": "phased", "fov_deg": 175.0}, "fov_deg=175.0: allowed are numbers from 0.001 to 170"),
    ],
)
def test_what_a_probe_has_not_is_named(values, message) -> None:
    with pytest.raises(ValueError, match=message.replace(".", r"\.")):
        probe_from(values)
