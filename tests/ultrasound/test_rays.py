"""Monte-Carlo transport against the energy that a slab lets through."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.stats import kstest

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, SimulatorSettings
from ablate.ultrasound.bundle import leave_probe, probe_rays
from ablate.ultrasound.draws import (
    CHOICE,
    COLUMNS,
    COS_AZIMUTH,
    LOG_U,
    MAX_ROWS,
    SIN_AZIMUTH,
    SURVIVAL,
    THICKNESS,
    Draws,
    stratified,
    unstratified,
)
from ablate.ultrasound.embree import Geometry
from ablate.ultrasound.illumination import SILENCE_DB, Nodes, mean_level_db
from ablate.ultrasound.plan import compile_scene
from ablate.ultrasound.point_spread import Across
from ablate.ultrasound.rays import Echoes, View
from ablate.ultrasound.transport import LOUDEST, trace


def follow(
    scene: Scene, probe: ConvexProbe, settings: SimulatorSettings, faintest_db: float = -200.0
) -> tuple[Echoes, Nodes]:
    compiled = compile_scene(scene, probe, settings, None)
    geometry = Geometry(compiled.structures, np.array([[-400.0] * 3, [400.0] * 3]), np.zeros(3), 200.0)
    draws = Draws(settings.path_seed, settings.scanlines * settings.layers, settings.rays)
    bundle = leave_probe(geometry, probe_rays(probe, settings, draws), np.eye(4))
    nodes = Nodes(0.0, 1.0, np.ones((len(bundle.starts), 151), bool), np.zeros((len(bundle.starts), 151)))
    lines, ways = (
        (bundle.starts, bundle.directions),
        (settings.rays, draws.seed, probe.depth_mm, faintest_db, geometry.step_mm),
    )
    view = View(compiled.media, compiled.tissue_of_owner, *lines, *ways)
    return trace(geometry, view, draws, bundle, nodes), nodes


def lit(nodes: Nodes, settings: SimulatorSettings) -> np.ndarray:
    """Linear illumination of each group at each millimetre."""
    return nodes.amplitude / settings.rays


@pytest.fixture
def one_line() -> SimulatorSettings:
    return SimulatorSettings(scanlines=1, layers=1, rays=64, aperture_mm=0.0, elevational_aperture_mm=0.0)


def test_slab_transmission(gel, slab, probe, one_line) -> None:
    """Behind both faces of a slab each ray keeps (1 - R)^2: reflections inside do not count as direct.

    The first node behind a face is as bright as what lies before it, to which it is interpolated.
    """
    scene = Scene((slab(Tissue("hard", 1540, 4.5, 0.0, roughness=0.0), 40.5, 60.5),), gel, "s")
    light = lit(follow(scene, probe, one_line)[1], one_line)[0]
    expected = [1, 1, 0.75, 0.75, 0.75, 0.75**2, 0.75**2]
    assert light[[40, 41, 42, 60, 61, 62, 100]] == pytest.approx(expected, rel=1e-6)


def test_direct_light_through_flat_faces_is_exact(gel, slab, probe, one_line) -> None:
    """However few the rays: a ray goes on behind a surface whether or not it is also turned there."""
    layers = tuple(
        slab(Tissue(f"t{i}", 1540, (2.5, 1.5)[i % 2], 0.0, roughness=0.0), 20.0 + 10 * i, 400.0) for i in range(6)
    )
    truth = (1 - (1 / 4) ** 2) ** np.arange(7)
    for rays in (1, 4, 64):
        settings = replace(one_line, rays=rays)
        light = lit(follow(Scene(layers, gel, "s"), probe, settings)[1], settings)[0, 15:80:10]
        np.testing.assert_allclose(light, truth, rtol=1e-6)


@pytest.mark.parametrize(("pressure", "rays", "turned"), [(0.25, 64, 8), (0.5, 64, 16), (0.6, 100, 36)])
def test_turns_are_stratified_and_weighed(gel, slab, probe, one_line, pressure, rays, turned) -> None:
    """Exactly max(|R_p| / 2, R) of the rays are also turned, and each weighs |R_p| over that, whatever the seed.

    A face too faint to turn rays, met from behind, lets each be heard once.
    """
    impedances = 1.6, 1.6 * (1 + pressure) / (1 - pressure)
    faint, hard = (Tissue("t", 1540, z, 0.0, roughness=0.0, specularity=0.0) for z in impedances)
    r = 0.1 / 3.1
    expected = (1 - r**2) * r * pressure * rays / turned
    for seed in range(5):
        scene = Scene((slab(faint, 20.0, 400.0), slab(hard, 40.0, 400.0)), gel, "s")
        echoes, _ = follow(scene, probe, replace(one_line, path_seed=seed, rays=rays))
        np.testing.assert_allclose(echoes.amplitude[echoes.reflected], np.full(turned, expected), rtol=1e-5)


def test_faint_reverberation_has_many_paths(gel, slab, probe, one_line) -> None:
    """Off faces of R_p = 0.08: physics turns eight of 200,000 rays twice, and they would be the whole echo."""
    tissues = (Tissue(name, 1540, z, 0.0, roughness=0.0) for name, z in (("a", 1.5 * 1.08 / 0.92), ("b", 1.5)))
    scene = Scene(tuple(slab(t, near, 400.0) for t, near in zip(tissues, (30.0, 60.0), strict=True)), gel, "s")
    means, paths = [], 0
    for seed in range(10):
        settings = replace(one_line, rays=20_000, path_seed=seed)
        echoes, _ = follow(scene, probe, settings)
        thrice = echoes.amplitude[echoes.reflected & (np.abs(echoes.depth_mm - 90.0) < 1)]
        means.append(thrice.sum(dtype=float) / settings.rays)
        paths += len(thrice)
    assert paths > 400
    assert abs(np.mean(means) - (1 - 0.08**2) * 0.08**3) < 3 * np.std(means, ddof=1) / np.sqrt(10)


def test_refraction_bends_the_path(gel, slab) -> None:
    """Depths of a second face seen through an oblique first one follow from Snell's law."""
    settings = SimulatorSettings(scanlines=3, layers=1, rays=1, aperture_mm=0.0, elevational_aperture_mm=0.0)
    fast = Tissue("fast", 2000, 2.0, 0.0, roughness=0.0, specularity=0.0)
    scene = Scene((slab(fast, 30.0, 60.0),), gel, "s")
    echoes, _ = follow(scene, ConvexProbe(fov_deg=60.0), settings)
    edge = np.sort(echoes.depth_mm[(echoes.group == 0) & ~echoes.reflected])
    assert len(edge) == 2
    theta = np.radians(30.0)
    first = (30 + 40 * (1 - np.cos(theta))) / np.cos(theta)
    second = first + 30 / np.cos(np.arcsin(2000 / 1540 * np.sin(theta)))
    assert edge[0] == pytest.approx(first, abs=1e-3)
    assert edge[1] == pytest.approx(second, abs=1e-3)


def test_a_crossing_inside_a_structure_of_higher_priority_changes_nothing(gel, slab, probe, one_line) -> None:
    hard = Tissue("hard", 1540, 6.0, 1.0, roughness=0.0)
    soft = Tissue("soft", 1540, 1.6, 0.3, roughness=0.0)
    cover = slab(soft, 10.0, 200.0)
    alone = follow(Scene((cover,), gel, "s"), probe, one_line)
    hidden = follow(Scene((slab(hard, 40.0, 60.0), cover), gel, "s"), probe, one_line)
    np.testing.assert_allclose(lit(alone[1], one_line), lit(hidden[1], one_line), rtol=1e-5)
    assert len(alone[0].depth_mm) == len(hidden[0].depth_mm)


def test_echo_amplitude_is_reflection_times_loss(gel, slab, probe, one_line) -> None:
    """Defects 1 and 2 of other simulators: an echo carries |R_p| and the loss of both ways."""
    body = Tissue("body", 1540, 1.5, 0.7, roughness=0.0)
    bone = Tissue("bone", 1540, 6.0, 7.0, roughness=0.0)
    scene = Scene((slab(body, -10.0, 300.0), slab(bone, 50.0, 300.0)), gel, "s")
    echoes, _ = follow(scene, probe, one_line)
    direct = ~echoes.reflected
    np.testing.assert_allclose(echoes.depth_mm[direct], 50.0, atol=1e-3)
    db = 2 * 0.7 * 3.0 * 5.0
    np.testing.assert_allclose(echoes.amplitude[direct], 4.5 / 7.5 * 10 ** (-db / 20), rtol=1e-4)


def test_reverberation_between_two_plates(gel, slab, probe, one_line) -> None:
    """Echoes of turned rays come at whole multiples of the gap, each with the amplitude its path has on average."""
    plate = Tissue("plate", 1540, 4.5, 0.0, roughness=0.0)
    settings = replace(one_line, rays=20_000)
    scene = Scene((slab(plate, 20.0, 30.0), slab(plate, 40.0, 400.0)), gel, "s")
    echoes, _ = follow(scene, probe, settings)
    at_50 = np.abs(echoes.depth_mm - 50.0) < 0.01  # 20 to 30, 40, back to 30, again to 40, or inside the plate
    mean = echoes.amplitude[at_50].sum() / settings.rays
    t, r = 0.75, 0.5  # two-way transmission; reflection of pressure
    # Face 20, face 30, face 40: paths of 100 mm that end at a face, heard there with R_p.
    gap = t * t * r * r * r  # off 40, off 30 from outside, heard at 40
    inside_first = t * r * r * t * r  # off 30, off 20 from within, through 30, heard at 40
    off_40_and_20 = t * t * r * t * r * r  # off 40, up through 30, off 20 from within, heard at 30
    within = t * r * r * r * r * r  # twice to and fro inside the plate, heard at 30
    assert echoes.reflected[at_50].all()
    assert mean == pytest.approx(gap + inside_first + off_40_and_20 + within, rel=0.1)


@pytest.mark.parametrize("thickness_mm", [0.1, 1e-3])
@pytest.mark.parametrize("pressure", [0.2, 0.5, 0.8])
def test_reverberation_of_a_film(gel, slab, probe, one_line, pressure, thickness_mm) -> None:
    """To and fro within it k times: (1 - R) R_p (R_p^2)^k, which sum to R_p^3."""
    film = Tissue("film", 1540, 1.5 * (1 + pressure) / (1 - pressure), 0.0, roughness=0.0)
    scene, totals = Scene((slab(film, 50.0, 50.0 + thickness_mm),), gel, "s"), []
    for seed in range(10):
        settings = replace(one_line, rays=10_000, path_seed=seed)
        echoes, _ = follow(scene, probe, settings)
        totals.append(echoes.amplitude[echoes.reflected].sum(dtype=float) / settings.rays)
    error = np.std(totals, ddof=1) / np.sqrt(10)
    assert abs(np.mean(totals) - pressure**3) < 4 * error
    assert error < 0.05 * pressure**3


def test_echoes_of_many_reflections_keep_their_mean(gel, slab, probe, one_line) -> None:
    """To and fro between faces of R_p = 0.8, 10 mm apart: k times and back, (1 - R) R_p (R_p^2)^k, at 20 + 10 k mm.

    From eight reflections on, half of the rays end at each.
    """
    tissues = (Tissue(name, 1540, z, 0.0, roughness=0.0) for name, z in (("a", 13.5), ("b", 121.5)))
    scene = Scene(tuple(slab(t, near, 400.0) for t, near in zip(tissues, (10.0, 20.0), strict=True)), gel, "s")
    means = []
    for seed in range(10):
        settings = replace(one_line, rays=10_000, path_seed=seed)
        echoes, _ = follow(scene, probe, settings)
        at = [np.abs(echoes.depth_mm - (20 + 10 * k)) < 1 for k in range(1, 8)]
        means.append([echoes.amplitude[a & echoes.reflected].sum(dtype=float) / settings.rays for a in at])
    truth = (1 - 0.8**2) * 0.8 * 0.8 ** (2 * np.arange(1, 8))
    error = np.std(means, axis=0, ddof=1) / np.sqrt(10)
    assert (np.abs(np.mean(means, axis=0) - truth) < 4 * error).all()
    assert (error < 0.15 * truth).all()


def test_turned_rays_share_what_they_meet(gel, slab, probe, one_line) -> None:
    """In 200 faces of R_p = 0.1 the amplitudes of all paths would grow by 1 + |R_p| - R at each."""
    pair = [Tissue(name, 1540, z, 0.0, roughness=0.0) for name, z in (("a", 1.5 * 1.1 / 0.9), ("b", 1.5))]
    scene = Scene(tuple(slab(pair[i % 2], 20.0 + 0.5 * i, 400.0) for i in range(200)), gel, "s")
    settings = replace(one_line, rays=1000)
    echoes, _ = follow(scene, probe, settings)
    deep = echoes.reflected & (echoes.depth_mm > 110)
    a_face = echoes.amplitude[deep].sum(dtype=float) / settings.rays / (2 * (probe.depth_mm - 110))
    direct = 10.0  # 1 / |R_p|: what all of 1 - R, (1 - R)^2, ... send back together
    assert 0 < a_face < 0.1 * LOUDEST * direct


def test_draws_beyond_the_table_are_new_ones(gel, slab, probe, one_line) -> None:
    """Off 52 mm, and off 20 mm on the 128th interface: were its draws those of the 64th, all that turned would turn."""
    tissues = [Tissue(name, 1540, z, 0.0, roughness=0.0) for name, z in (("a", 4.5), ("b", 4.51), ("c", 13.53))]
    between = (slab(tissues[1 - i % 2], 20.5 + 0.5 * i, 400.0) for i in range(MAX_ROWS - 1))
    scene = Scene((slab(tissues[0], 20.0, 400.0), *between, slab(tissues[2], 52.0, 400.0)), gel, "s")
    means = []
    for seed in range(10):
        settings = replace(one_line, rays=2000, path_seed=seed)
        echoes, _ = follow(scene, probe, settings)
        again = echoes.reflected & (np.abs(echoes.depth_mm - 84.0) < 0.1)
        means.append(echoes.amplitude[again].sum(dtype=float) / settings.rays)
    assert abs(np.mean(means) - 0.75 * 0.5**3) < 4 * np.std(means, ddof=1) / np.sqrt(10)
    assert np.std(means, ddof=1) < 0.1 * np.mean(means)


def test_unstratified_draws_are_uniform_and_unrelated() -> None:
    """Columns as in the table; neighbouring seeds, interfaces and rays have nothing in common."""
    row = np.empty(COLUMNS, np.float32)
    drawn = np.array([
        [[unstratified(np.uint64(seed), k, ray, row).copy() for ray in range(500)] for k in range(64, 74)]
        for seed in (0, 1, 2**64 - 1)
    ])  # fmt: skip
    flat = drawn.reshape(-1, COLUMNS)
    n = len(flat)
    for column in (flat[:, CHOICE], flat[:, SURVIVAL], np.exp(flat[:, LOG_U])):
        assert kstest(column, "uniform").pvalue > 1e-3
    assert kstest(flat[:, THICKNESS], "halfnorm").pvalue > 1e-3
    azimuth = np.arctan2(flat[:, SIN_AZIMUTH], flat[:, COS_AZIMUTH])
    assert kstest(azimuth, "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-3
    assert (np.abs(np.corrcoef(flat[:, [CHOICE, THICKNESS, LOG_U, SURVIVAL]].T) - np.eye(4)) < 4 / np.sqrt(n)).all()
    u = drawn[..., CHOICE]
    for one, other in ((u[0], u[1]), (u[:, 0], u[:, 1]), (u[..., 1:], u[..., :-1])):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 4 / np.sqrt(one.size)


def test_a_closed_cavity_ends(gel, slab, probe, one_line) -> None:
    gas = Tissue("gas", 330, 4e-4, 0.0, roughness=0.0)
    scene = Scene((slab(gas, -400.0, 300.0), slab(gel, -5.0, 5.0)), gel, "s")
    echoes, nodes = follow(scene, probe, replace(one_line, rays=256))
    assert np.isfinite(echoes.amplitude).all()
    assert len(echoes.depth_mm) < 256 * 15  # eight reflections, then half of the rays at each
    assert np.isfinite(nodes.amplitude).all()


def test_roulette_is_unbiased(gel, slab, probe, one_line) -> None:
    lossy = Tissue("lossy", 1540, 1.5, 1.0, roughness=0.0)
    plate = Tissue("plate", 1540, 15.0, 0.0, roughness=0.0)
    scene = Scene((slab(lossy, -10.0, 400.0), slab(plate, 20.0, 22.0), slab(plate, 40.0, 400.0)), gel, "s")
    means = []
    for faintest in (-300.0, 0.0):
        settings = replace(one_line, rays=200_000)
        echoes, _ = follow(scene, probe, settings, faintest)
        late = echoes.reflected & (echoes.depth_mm < 70)
        means.append((echoes.amplitude[late].sum() / settings.rays, late.sum()))
    assert means[1][1] < means[0][1]
    assert means[1][0] == pytest.approx(means[0][0], rel=0.1)


def test_illumination_of_thousands_of_decibels_is_silence(gel, slab, probe, one_line) -> None:
    stiff = Tissue("stiff", 1540, 1.5, 1e4, roughness=0.0)
    _, nodes = follow(Scene((slab(stiff, 50.0, 300.0),), gel, "s"), probe, one_line)
    level = mean_level_db(nodes, 64, Across(np.ones((1, 1, 1)), "cpu", torch.float64)).numpy()
    assert level[0, 49] == pytest.approx(0, abs=1e-4)
    assert level[0, -1] == SILENCE_DB
    assert np.isfinite(level).all()


def test_draws_are_stratified_and_repeat() -> None:
    u = stratified(np.random.default_rng(0), 5, 16, 2)
    assert (np.sort(np.floor(u * 16), axis=-1) == np.arange(16)).all()
    a, b, other = (Draws(seed, 5, 16).table(10)[:10] for seed in (3, 3, 4))
    assert (a == b).all()
    assert abs(np.corrcoef(a[0, :, CHOICE], a[1, :, CHOICE])[0, 1]) < 0.4
    assert (a[9] != other[9]).any()


def test_draws_made_one_by_one_are_those_made_at_once() -> None:
    step_by_step = Draws(3, 5, 16)
    for k in range(10):
        step_by_step.table(k)
    assert (step_by_step.table(10)[:10] == Draws(3, 5, 16).table(10)[:10]).all()


def test_a_flat_disc_of_needle_triangles_is_survived(gel, tissue, probe, one_line) -> None:
    mesh = trimesh.creation.cylinder(radius=200.0, height=10.0, sections=2000)
    mesh.apply_translation((0, 0, 70.0))
    _, nodes = follow(Scene((Structure(mesh, tissue),), gel, "s"), probe, one_line)
    expected = 10 ** (-2 * 0.5 * 3.0 * 1.0 / 20)
    assert lit(nodes, one_line)[0, 100] == pytest.approx(expected, rel=1e-4)


def test_a_ray_along_a_surface_takes_few_steps(gel, tissue, probe, one_line, monkeypatch) -> None:
    """It meets the same triangles again and again; steps of a fixed small length would take a million."""
    mesh = trimesh.creation.box((100.0, 100.0, 400.0))
    mesh.apply_translation((50.0, 0, 100.0))  # its side is the plane x = 0, which the line lies in
    casts = []
    closest = Geometry.closest

    def counted(self: Geometry, *rays: np.ndarray) -> object:
        casts.append(1)
        return closest(self, *rays)

    monkeypatch.setattr(Geometry, "closest", counted)
    follow(Scene((Structure(mesh, replace(tissue, impedance_mrayl=3.0)),), gel, "s"), probe, one_line)
    assert len(casts) < 500


def test_threads_change_nothing(gel, ball, probe) -> None:
    """Parts are the same for any number of threads, so the result is, bit for bit."""
    scene = Scene((ball(Tissue("bone", 2600, 4.2, 5.0, roughness=0.05), (0.0, 5.0, 60.0), 30.0),), gel, "s")
    settings = SimulatorSettings(scanlines=300, layers=1, rays=8)
    found = []
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            echoes, nodes = follow(scene, probe, settings)
            found.append((*vars(echoes).values(), nodes.amplitude))
    finally:
        torch.set_num_threads(1)
    for other in found[1:]:
        assert all((a == b).all() for a, b in zip(found[0], other, strict=True))


def test_echoes_behind_forty_structures(gel, slab, probe, one_line) -> None:
    """More structures than one word of a set holds."""
    layers = tuple(
        slab(Tissue(f"t{i}", 1540, (1.8, 1.5)[i % 2], 0.0, roughness=0.0), 20.0 + 3 * i, 400.0) for i in range(40)
    )
    echoes, _ = follow(Scene(layers, gel, "s"), probe, one_line)
    depth = np.unique(np.round(echoes.depth_mm[~echoes.reflected], 2))
    np.testing.assert_allclose(depth, 20.0 + 3 * np.arange(40), atol=0.01)
    amplitude = echoes.amplitude[~echoes.reflected & (echoes.depth_mm > 136)].sum() / one_line.rays
    r = 0.3 / 3.3
    assert amplitude == pytest.approx(r * (1 - r**2) ** 39, rel=1e-5)
