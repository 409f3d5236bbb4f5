"""Echoes lie where geometry says, in the envelope and in the image, and where travel times say."""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, DepthMode, Simulator, SimulatorSettings
from support.traced_rays import tilted

HARD = Tissue("hard", 1540, 6.0, 0.0, 0.0, 0.0, 0.0, roughness=0.0, specularity=0.0)
GAS = Tissue("gas", 1540, 1e-6, 0.0, 0.0, 0.0, 0.0, roughness=0.0, specularity=0.0)
LINES = 65
ANGLES = np.linspace(-1, 1, LINES) * np.radians(35)


def scanline(line: int, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and direction of a scanline in the world."""
    direction = np.array([np.sin(ANGLES[line]), 0.0, np.cos(ANGLES[line])])
    return pose[:3, :3] @ (40 * direction - (0, 0, 40)), pose[:3, :3] @ direction


def echo_depth(envelope: np.ndarray, depth: np.ndarray, near: float, far: float) -> float:
    """Centre of gravity of what lies between two depths."""
    part = (depth > near) & (depth < far)
    return float((depth[part] * envelope[part]).sum() / envelope[part].sum())


@pytest.fixture
def settings() -> SimulatorSettings:
    """The paper's samples, layers and aperture; scanlines are kept apart, for each sees another depth."""
    return SimulatorSettings(scanlines=LINES, image_shape=(8, 8), lateral_fwhm_mm=0.05)


@pytest.mark.parametrize(("centre", "radius"), [((8.0, 0.0, 75.0), 25.0), ((-20.0, 1.0, 60.0), 10.0)])
def test_a_sphere_echoes_where_it_is_met(gel, ball, probe, settings, ahead, depths, centre, radius) -> None:
    scene = Scene((ball(HARD, centre, radius),), gel, "s")
    envelope = Simulator(scene, probe, settings).render(ahead).envelope
    checked = 0
    for line in range(LINES):
        start, direction = scanline(line, ahead)
        to_centre = np.array(centre) - start
        along = to_centre @ direction
        beside_2 = to_centre @ to_centre - along**2
        if beside_2 > (0.5 * radius) ** 2:  # beyond 30 degrees a beam of finite width meets many depths
            continue
        depth = along - np.sqrt(radius**2 - beside_2)
        # What lies in the planes of the outer layers, 1.5 mm off, is met a little deeper.
        deeper = along - np.sqrt(radius**2 - beside_2 - 1.5**2) - depth
        got = echo_depth(envelope[:, line], depths(probe, settings), depth - 5, depth + 5)
        assert -0.05 < got - depth < 0.05 + deeper
        checked += 1
    assert checked >= 5


@pytest.mark.parametrize("degrees", [0.0, -12.0, 25.0])
def test_a_plane_echoes_where_it_is_met(gel, slab, probe, settings, depths, degrees) -> None:
    pose = tilted(degrees)
    scene = Scene((slab(HARD, 55.0, 400.0),), gel, "s")
    envelope = Simulator(scene, probe, settings).render(pose).envelope
    for line in range(0, LINES, 4):
        start, direction = scanline(line, pose)
        if direction[2] > np.cos(np.radians(30)):
            depth = (55.0 - start[2]) / direction[2]
            got = echo_depth(envelope[:, line], depths(probe, settings), depth - 5, depth + 5)
            assert got == pytest.approx(depth, abs=0.05)


@pytest.mark.parametrize("mode", list(DepthMode))
def test_depth_behind_a_fast_layer(slab, probe, settings, depths, mode) -> None:
    """Snell's law gives the path to its far face; the travel time along it, shown at 1540 m/s, the displayed depth.

    Sound that is bent by 3 mm off its scanline has left its beam, and its echo is clutter.
    """
    water = Tissue("water", 1480, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0, specularity=0.0)
    fast = Tissue("fast", 1900, 1.6, 0.0, 0.0, 0.0, 0.0, roughness=0.0, specularity=0.0)
    scene = Scene((slab(fast, 20.0, 400.0), slab(replace(GAS, speed_m_s=330.0), 60.0, 400.0)), water, "s")
    axial = replace(settings, depth_mode=mode, aperture_mm=0.0, elevational_aperture_mm=0.0)
    envelope = Simulator(scene, probe, axial).render(np.eye(4)).envelope
    slower, faster = (1540 / 1480, 1540 / 1900) if mode is DepthMode.time_of_flight else (1.0, 1.0)
    bent = np.arcsin(1900 / 1480 * np.sin(np.abs(ANGLES)))
    off_mm = 40 / np.cos(bent) * np.sin(bent - np.abs(ANGLES))
    for line in range(0, LINES, 4):
        start, direction = scanline(line, np.eye(4))
        to_first, within = (20.0 - start[2]) / direction[2], 40.0 / np.cos(bent[line])
        depth = to_first * slower + within * faster
        if off_mm[line] < 3:
            got = echo_depth(envelope[:, line], depths(probe, settings), depth - 1, depth + 1)
            assert got == pytest.approx(depth, abs=0.05)
        assert envelope[:, line].max() > 0.9 if off_mm[line] < 3 else envelope[:, line].max() < 0.15


def test_time_of_flight_moves_speckle_with_its_tissue(tissue, gel, slab, probe, small, ahead, depths) -> None:
    fast = Tissue("fast", 1540 * 1.25, 1.5, 0.0, 0.0, roughness=0.0)
    scene = Scene((slab(fast, -50.0, 60.0), slab(tissue, 60.0, 300.0)), gel, "s")
    settings = replace(small, depth_mode=DepthMode.time_of_flight)
    envelope = Simulator(scene, probe, settings).render(ahead).envelope[:, 30:34]
    depth = depths(probe, settings)
    assert envelope[depth < 46].max() < 1e-4 < envelope[(depth > 52) & (depth < 60)].mean()


def test_dots_lie_on_their_pixels(gel, ball, ahead) -> None:
    """In S and H alike: the fan's bounding box, 217.96 x 157.23 mm, begins 7.23 mm above the middle of the face."""
    places_mm = [(0.0, 20.0), (-25.0, 45.0), (40.0, 90.0), (-70.0, 80.0), (20.0, 140.0)]
    tissue = Tissue("dot", 1540, 1.5, 0.0, 1.0, 0.0, 10.0, roughness=0.0)
    scene = Scene(tuple(ball(tissue, (x, 0.0, z), 1.0) for x, z in places_mm), gel, "s")
    settings = SimulatorSettings(rays=1, scanlines=384, noise_level_db=-300.0)
    frame = Simulator(scene, ConvexProbe(), settings).render(ahead)
    half = np.radians(35)
    x = ((np.arange(1386) + 0.5) / 1386 - 0.5) * 2 * 190 * np.sin(half)
    z = (np.arange(1000) + 0.5) / 1000 * (190 - 40 * np.cos(half)) - 40 * (1 - np.cos(half))
    assert (x[-1] - x[0], z[0]) == pytest.approx((217.96 * 1385 / 1386, -7.23 + 0.08), abs=0.01)
    for place in places_mm:
        near = np.hypot(x - place[0], z[:, None] - place[1]) < 5

        def middle(weight: np.ndarray, near: np.ndarray = near) -> tuple[float, float]:
            weight = np.where(near, weight, 0.0)
            return weight.sum(axis=0) @ x / weight.sum(), weight.sum(axis=1) @ z / weight.sum()

        assert middle(frame.segmentation == 2) == pytest.approx(place, abs=0.05)
        assert middle(frame.image.astype(float) ** 2) == pytest.approx(place, abs=0.3)
