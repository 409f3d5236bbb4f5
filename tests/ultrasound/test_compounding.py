"""Frames averaged over steered scanlines: speckle, shadows, surfaces and places against closed forms."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.special import hyp2f1

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import (
    ConvexProbe,
    DepthMode,
    LinearProbe,
    PhasedProbe,
    PlanMode,
    Probe,
    Simulator,
    SimulatorSettings,
)
from ablate.ultrasound.probe import fan_of, scanline_positions, scanlines_in_plane

SPECKLE = Tissue("t", 1540, 1.5, 0.0, 0.6, 0.0, 1.0, roughness=0.0)
LINEAR = LinearProbe(width_mm=50.0, depth_mm=50.0, frequency_mhz=5.0)
SETTINGS = SimulatorSettings(
    scanlines=128, axial_samples=1024, rays=1, layers=1, image_shape=(64, 64), axial_fwhm_mm=0.3, lateral_fwhm_mm=0.9,
    focus_mm=30.0, noise_level_db=-300.0, tgc_db_cm_mhz=0.0, sidelobe_db=-300.0, aperture_mm=0.0,
    elevational_aperture_mm=0.0, active_aperture_mm=0.0,
)  # fmt: skip
PER_SIGMA = np.sqrt(8 * np.log(2))
RAYLEIGH_SNR = np.sqrt(np.pi / (4 - np.pi))  # 1.91


def depths(probe: Probe, settings: SimulatorSettings) -> np.ndarray:
    return (np.arange(settings.axial_samples) + 0.5) * probe.depth_mm / settings.axial_samples


def angles_of(settings: SimulatorSettings) -> np.ndarray:
    n = settings.compound_angles
    return np.radians(settings.compound_steer_deg) * np.linspace(-1, 1, n) if n > 1 else np.zeros(1)


def correlation_of_envelopes(probe: Probe, settings: SimulatorSettings) -> np.ndarray:
    """Of two angles at the depth of the focus, in closed form, (angles, angles).

    Two waves whose directions differ see the phases of scatterers across the beam turn by 2 k (sin a - sin b) a
    millimetre; the overlap of Gaussian beams that are turned to their directions is that of two normal distributions.
    Envelopes of circular normal fields of correlation r correlate as Rayleigh variables (Middleton, Introduction to
    Statistical Communication Theory, 9.1).
    """
    at_point = angles_of(settings)
    if isinstance(probe, ConvexProbe):  # law of sines
        at_point = np.arcsin(probe.radius_mm * np.sin(at_point) / (probe.radius_mm + settings.focus_mm))
    across, along = settings.lateral_fwhm_mm / PER_SIGMA, settings.axial_fwhm_mm / PER_SIGMA
    k = 2 * np.pi * probe.frequency_mhz / 1.54
    turn = np.array([[[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]] for a in at_point])
    inverse = turn @ np.diag([across**-2, along**-2]) @ turn.transpose(0, 2, 1)
    sums = inverse[:, None] + inverse
    overlap = 2 / np.sqrt(np.linalg.det(sums)) / (across * along)
    apart = 2 * k * (np.sin(at_point)[:, None] - np.sin(at_point))
    r = np.minimum(overlap * np.exp(-((apart * across) ** 2) / 4), 1)
    return (hyp2f1(-0.5, -0.5, 1, r**2) - 1) * np.pi / (4 - np.pi)


def middle(probe: Probe, settings: SimulatorSettings, near_mm: float, far_mm: float) -> tuple[slice, slice]:
    """Samples between two depths, on the third of the scanlines that all sets see."""
    rows = np.flatnonzero(np.abs(depths(probe, settings) - (near_mm + far_mm) / 2) < (far_mm - near_mm) / 2)
    return slice(rows[0], rows[-1] + 1), slice(settings.scanlines // 3, 2 * settings.scanlines // 3)


@pytest.mark.parametrize(
    ("probe", "angles", "steer_deg"),
    [
        (LINEAR, 1, 10.0), (LINEAR, 3, 10.0), (LINEAR, 5, 10.0), (LINEAR, 9, 10.0), (LINEAR, 5, 2.0), (LINEAR, 3, 1.0),
        (ConvexProbe(radius_mm=40.0, depth_mm=60.0, frequency_mhz=5.0), 5, 12.0),
    ],
)  # fmt: skip
def test_speckle_is_as_smooth_as_its_angles_are_apart(probe, angles, steer_deg) -> None:
    """Mean over standard deviation: 1.91 of one angle, at most 1.91 sqrt(n) of n, less where angles correlate."""
    settings = replace(SETTINGS, compound_angles=angles, compound_steer_deg=steer_deg)
    simulator = Simulator(Scene((), SPECKLE, "s"), probe, settings)
    some = middle(probe, settings, 10.0, 45.0)
    parts = np.array([simulator.render(np.eye(4), seed).envelope[some] for seed in range(6)], float)
    gain = 1 / np.sqrt(correlation_of_envelopes(probe, settings).mean())
    assert 1 <= gain < np.sqrt(angles) + 1e-9
    # the scatterers of an entry are as strong at every angle: distant ones correlate by some hundredths
    assert parts.mean() / parts.std() == pytest.approx(RAYLEIGH_SNR * gain, rel=0.05)


def test_each_two_angles_correlate_as_their_directions_say() -> None:
    settings = replace(SETTINGS, compound_angles=5)
    simulator = Simulator(Scene((), SPECKLE, "s"), LINEAR, settings)
    rows, lines = middle(LINEAR, settings, 10.0, 45.0)
    sets = []
    for seed in range(6):
        prepared = simulator._of(np.eye(4), Simulator._prepare)
        signals = (simulator._chain._signal(prepared, number, seed)[0] for number in range(5))
        sets.append([np.hypot(*signal)[lines, rows].ravel() for signal in signals])
    measured = np.corrcoef(np.concatenate(sets, axis=1))
    np.testing.assert_allclose(measured, correlation_of_envelopes(LINEAR, settings), atol=0.07)


@pytest.mark.parametrize("steer_deg", [10.0, 15.0])
def test_a_shadow_is_the_one_of_geometry(steer_deg) -> None:
    """An opaque cylinder hides a strip from each angle. Where all strips meet is the umbra, r / sin(a) long.

    What is seen by some of the angles is as bright as their share. Pencils of waves too short to bend are hard.
    """
    probe, radius, centre = LinearProbe(width_mm=80.0, depth_mm=70.0, frequency_mhz=1e3), 4.0, 20.0
    mesh = trimesh.creation.cylinder(radius, 60.0, sections=256)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    mesh.apply_translation((0, 0, centre))
    opaque = replace(SPECKLE, name="opaque", attenuation_db_cm_mhz=1.0)
    settings = replace(
        SETTINGS, scanlines=256, compound_angles=5, compound_steer_deg=steer_deg, lateral_fwhm_mm=0.35,
        axial_fwhm_mm=0.5,
    )  # fmt: skip
    bodies = Scene((), SPECKLE, "s"), Scene((Structure(mesh, opaque),), SPECKLE, "s")
    free, shadowed = (
        sum(simulator.render(np.eye(4), seed).envelope.astype(float) for seed in range(6))
        for simulator in (Simulator(body, probe, settings) for body in bodies)
    )
    x, z = np.linspace(-40, 40, 256), depths(probe, settings)[:, None]
    angles = angles_of(settings)[:, None, None]
    off = np.abs(x * np.cos(angles) - (z - centre) * np.sin(angles)) - radius  # from the border of each strip
    seen = (off > 0).mean(axis=0)
    sure = (np.abs(off) > 0.9).all(axis=0) & (z > centre + radius + 1) & (np.abs(x) < 12)
    sure &= z < 67  # deeper, the outer sets do not reach
    shares = np.unique(seen[sure])
    assert len(shares) == 6
    for share in shares:
        region = sure & (seen == share)
        assert shadowed[region].sum() / free[region].sum() == pytest.approx(share, abs=0.03)
    attenuation = Simulator(bodies[1], probe, settings).beam_maps(np.eye(4), of_surfaces=False, of_angles=True).compound
    each = settings.samples_per_row
    surely = np.logical_and.reduceat(sure, np.arange(0, len(z), each), axis=0)
    np.testing.assert_allclose(attenuation[surely], seen[::each][surely], atol=1e-3)
    axis = slice(126, 130)
    bins = np.arange(centre + radius, 68.0, 0.5)
    bright = [
        shadowed[near, axis].sum() / free[near, axis].sum()
        for near in (np.abs(z[:, 0] - depth) < 0.75 for depth in bins)
    ]
    ends = bins[np.flatnonzero(np.array(bright) > 0.2)[0]]  # half of the two outermost of five
    assert ends - centre == pytest.approx(radius / np.sin(np.radians(steer_deg)), abs=1.2)


def tilted_plane(tissue: Tissue, degrees: float, depth_mm: float) -> Structure:
    mesh = trimesh.creation.box((400.0, 400.0, 100.0))
    mesh.apply_translation((0, 0, 50.0))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), (0, 1, 0)))
    mesh.apply_translation((0, 0, depth_mm))
    return Structure(mesh, tissue)


def test_a_mirror_shines_for_the_angle_that_it_faces(gel) -> None:
    """A plane that is tilted by 10 degrees returns R cos(2 (10 - a))^n to the angle a."""
    mirror = replace(gel, name="mirror", impedance_mrayl=1.8, specularity=40.0)
    scene = Scene((tilted_plane(mirror, 10.0, 25.0),), gel, "s")
    settings = replace(SETTINGS, axial_samples=2048)
    peaks = {}
    for angles in (1, 3):
        envelope = Simulator(scene, LINEAR, replace(settings, compound_angles=angles)).render(np.eye(4)).envelope
        peaks[angles] = envelope[:, 50:78].max(axis=0).mean()
    tilt, reflected = np.radians(10.0), 0.3 / 3.3
    off = tilt - np.radians([-10.0, 0.0, 10.0])
    # a beam spreads along its wave front, and across it the plane's echo is lower and longer
    across, along = settings.lateral_fwhm_mm / PER_SIGMA, settings.axial_fwhm_mm / PER_SIGMA
    echo = reflected * np.maximum(np.cos(2 * off), 0) ** 40 / np.sqrt(1 + (np.tan(off) * across / along) ** 2)
    assert peaks[1] == pytest.approx(echo[1], rel=0.03)
    assert peaks[3] == pytest.approx(echo.mean(), rel=0.03)
    assert peaks[3] > 3 * peaks[1]


def test_a_cyst_is_drawn_farther_down_its_sides(gel) -> None:
    """The wall at the angle w from the top returns the mean of R cos(2 (w - a))^n over the angles a."""
    radius, depth, specularity = 8.0, 25.0, 8.0
    mesh = trimesh.creation.cylinder(radius, 60.0, sections=4096)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    mesh.apply_translation((0, 0, depth))
    cyst = replace(gel, name="cyst", impedance_mrayl=1.6, specularity=specularity)
    settings = replace(
        SETTINGS, scanlines=400, axial_samples=2048, axial_fwhm_mm=0.8, lateral_fwhm_mm=1e-6, compound_angles=3
    )
    x, z = np.linspace(-25, 25, 400), depths(LINEAR, settings)
    envelopes = {
        angles: Simulator(Scene((Structure(mesh, cyst),), gel, "s"), LINEAR, replace(settings, compound_angles=angles))
        .render(np.eye(4))
        .envelope
        for angles in (1, 3)
    }
    for wall_deg in (-25.0, -15.0, 5.0, 20.0, 25.0, 30.0):
        at = int(np.searchsorted(x, radius * np.sin(np.radians(wall_deg))))
        some = slice(at - 2, at + 2)
        wall = np.arcsin(x[some] / radius)
        near = np.abs(z - (depth - radius * np.cos(wall).mean())) < 0.8
        for angles, steered in ((1, [0.0]), (3, [-10.0, 0.0, 10.0])):
            echo = 0.1 / 3.1 * np.cos(2 * (wall - np.radians(steered)[:, None])) ** specularity
            assert envelopes[angles][near, some].max(axis=0).mean() == pytest.approx(echo.mean(), rel=0.06)


@pytest.mark.parametrize("probe", [LINEAR, ConvexProbe(radius_mm=40.0, depth_mm=150.0), ConvexProbe(radius_mm=3.0)])
@pytest.mark.parametrize("degrees", [-12.0, 5.0, 30.0])
def test_a_steered_scanline_meets_the_point_that_it_is_taken_for(probe, degrees) -> None:
    lines, steered = 65, np.radians(degrees)
    fan = fan_of(probe)
    starts, directions = (part[0] for part in scanlines_in_plane(probe, lines, np.zeros(1), steered))
    ahead = scanlines_in_plane(probe, lines, np.zeros(1))[1][0]
    np.testing.assert_allclose((directions * ahead).sum(axis=-1), np.cos(steered), atol=1e-12)
    assert (np.sign(directions[lines // 2, 0]) == np.sign(degrees)).all()
    positions, depth_mm = scanline_positions(probe, lines), np.array([1.0, 20.0, 50.0])
    range_mm, beside = fan.steered(steered, depth_mm)
    for depth, range_, aside in zip(depth_mm, range_mm, beside, strict=True):
        own = fan.lines(positions - aside)  # of the frame, through the points
        np.testing.assert_allclose(own[0] + depth * own[1], starts + range_ * directions, atol=1e-9)


def test_loss_and_gain_are_those_of_the_steered_way() -> None:
    """Twice 0.5 dB/cm/MHz, and as much gain: speckle is as bright at all depths, though steered ways are longer."""
    lossy = replace(SPECKLE, attenuation_db_cm_mhz=0.5)
    settings = replace(SETTINGS, compound_angles=3, compound_steer_deg=20.0, tgc_db_cm_mhz=0.5, reference_level=0.02)
    simulator = Simulator(Scene((), lossy, "s"), replace(LINEAR, frequency_mhz=8.0), settings)
    images = np.mean([simulator.beam_image(np.eye(4), seed) for seed in range(4)], axis=0)
    rows = settings.beam_shape[0]
    near, far = (images[some, 50:78].mean() for some in (slice(rows // 8, rows // 4), slice(-rows // 5, -rows // 10)))
    assert 60 < near < 200
    assert far == pytest.approx(near, abs=1.5)  # 64 dB of loss in 40 mm; 6 % of it are 4 dB, or 16 grey levels


def test_angles_of_zero_degrees_are_one() -> None:
    settings = replace(SETTINGS, compound_angles=3, compound_steer_deg=0.0)
    frames = [
        Simulator(Scene((), SPECKLE, "s"), LINEAR, each).render(np.eye(4), seed=4)
        for each in (settings, replace(settings, compound_angles=1))
    ]
    np.testing.assert_allclose(frames[0].envelope, frames[1].envelope, rtol=1e-5, atol=1e-9)


@pytest.fixture
def body(gel, ball) -> Scene:
    bone = Tissue("bone", 2600, 4.2, 5.0, 0.6, 0.0, 0.2, roughness=0.05, thickness_mm=0.1)
    flesh = Tissue("flesh", 1540, 1.6, 0.5, 0.6, 0.0, 0.8, texture_contrast_db=2.0)
    return Scene((ball(flesh, (0.0, 0.0, 60.0), 52.0), ball(bone, (0.0, 0.0, 60.0), 10.0)), gel, "s")


def test_a_frame_belongs_to_its_seeds_and_its_maps_to_the_scanlines_ahead(body, probe, small, ahead) -> None:
    """Also with other threads, another plan, and after another pose."""
    settings = replace(small, noise_level_db=-60.0, compound_angles=3)
    simulator, moved = Simulator(body, probe, settings), ahead.copy()
    moved[0, 3] = 3.0
    first = simulator.render(ahead, seed=3)
    simulator.render(moved)
    full = Simulator(body, probe, replace(settings, plan=PlanMode.full))
    try:
        torch.set_num_threads(3)
        again = [one.render(ahead, seed=3) for one in (simulator, full)]
    finally:
        torch.set_num_threads(1)
    for frame in again:
        assert (frame.image == first.image).all()
        assert (frame.envelope == first.envelope).all()
    one = Simulator(body, probe, replace(settings, compound_angles=1)).render(ahead, seed=3)
    assert (one.image != first.image).any()
    for name in ("segmentation", "attenuation", "mask"):
        assert (getattr(one, name) == getattr(first, name)).all()
    for name in {field.name for field in fields(one.beam)} - {"image", "compound"}:
        assert (getattr(one.beam, name) == getattr(first.beam, name)).all()
    asked = simulator.beam_maps(ahead, of_surfaces=False, of_angles=True)
    assert (asked.compound == first.beam.compound).all()
    assert one.beam.compound.size == asked.interfaces.size == 0


def test_the_set_in_the_middle_is_the_frame_of_one_angle(body, probe, small, ahead) -> None:
    one, five = (Simulator(body, probe, replace(small, compound_angles=angles)) for angles in (1, 5))
    alone, among = (
        simulator._chain._signal(simulator._of(ahead, Simulator._prepare), number, seed=3)
        for simulator, number in ((one, 0), (five, 2))
    )
    for a, b in zip(alone, among, strict=True):
        np.testing.assert_array_equal(a, b)
    assert one._chain.noise(ahead, 3)[1] == five._chain.noise(ahead, 3)[1][2:3]


def test_noise_is_averaged_where_nothing_comes_back(empty, probe, small, ahead) -> None:
    """The plan casts no ray there, but noise of several sets is smoother than that of one, by sqrt(n)."""
    settings = replace(small, noise_level_db=-50.0, samples_per_row=1)
    grey = {}
    for angles in (1, 9):
        auto, full = (
            Simulator(empty, probe, replace(settings, compound_angles=angles, plan=plan)).beam_image(ahead)
            for plan in PlanMode
        )
        assert (auto == full).all()
        amplitude = 10 ** (auto[100:-100, 20:-20].astype(float) / 255 * 60 / 20)
        grey[angles] = amplitude.mean() / amplitude.std()
    assert grey[1] == pytest.approx(RAYLEIGH_SNR, rel=0.03)
    assert grey[9] == pytest.approx(3 * RAYLEIGH_SNR, rel=0.05)


def test_what_cannot_be_compounded_is_refused(empty) -> None:
    with pytest.raises(ValueError, match="compound_angles=2: allowed are 1, 3, 5, 7, 9"):
        SimulatorSettings(compound_angles=2)
    with pytest.raises(ValueError, match="compound_angles=11: allowed are whole numbers from 1 to 9"):
        SimulatorSettings(compound_angles=11)
    with pytest.raises(ValueError, match="compound_angles=3: allowed with depth_mode=time_of_flight is 1"):
        SimulatorSettings(compound_angles=3, depth_mode=DepthMode.time_of_flight)
    with pytest.raises(ValueError, match="compound_angles=3: allowed with a phased probe is 1, because its scanlines"):
        Simulator(empty, PhasedProbe(), SimulatorSettings(compound_angles=3))
