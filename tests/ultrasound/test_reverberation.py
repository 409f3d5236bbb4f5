"""Reflected rays: their number, weight and length; the sum of their echoes is right and finite."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound.transport.lines import clutter_lines
from ablate.ultrasound.transport.rays import MAX_ROWS
from support.traced_rays import follow


@pytest.mark.parametrize("pressure", [0.06, 0.25, 0.6, 0.98])
def test_every_direct_ray_is_reflected_once(gel, slab, probe, one_line, pressure) -> None:
    """Every second or fourth one, by strata, with so much more of the weight |R_p|: all alike, whatever the seed.

    They meet a face from behind that is too weak to reflect them again, so each echoes once.
    """
    impedances = 1.6, 1.6 * (1 + pressure) / (1 - pressure)
    weak, hard = (Tissue("t", 1540, z, 0.0, roughness=0.0, specularity=0.0) for z in impedances)
    r = 0.1 / 3.1
    expected = (1 - r**2) * r * pressure
    for seed, (rays, each) in product(range(5), ((16, 2), (64, 4))):
        scene = Scene((slab(weak, 20.0, 400.0), slab(hard, 40.0, 400.0)), gel, "s")
        echoes, _ = follow(scene, probe, replace(one_line, path_seed=seed, rays=rays))
        np.testing.assert_allclose(echoes.amplitude[echoes.clutter], np.full(rays // each, each * expected), rtol=1e-5)


def test_weak_reverberation_has_no_error(gel, slab, probe, one_line) -> None:
    """Off faces of R_p = 0.08: at probability R, 8 of 200,000 rays would be reflected twice and make the echo.

    A surface splits a ray until its second reflection: a quarter of the rays make the echo, four times as strong.
    """
    tissues = (Tissue(name, 1540, z, 0.0, roughness=0.0) for name, z in (("a", 1.5 * 1.08 / 0.92), ("b", 1.5)))
    scene = Scene(tuple(slab(t, near, 400.0) for t, near in zip(tissues, (30.0, 60.0), strict=True)), gel, "s")
    echoes, _ = follow(scene, probe, one_line)
    thrice = echoes.amplitude[echoes.clutter & (np.abs(echoes.depth_mm - 90.0) < 1)]
    np.testing.assert_allclose(thrice, np.full(one_line.rays // 4, 4 * (1 - 0.08**2) * 0.08**3), rtol=1e-5)


def test_reverberation_between_two_plates(gel, slab, probe, one_line) -> None:
    """Echoes of reflected rays come at whole multiples of the gap, each with the amplitude its path has on average."""
    plate = Tissue("plate", 1540, 4.5, 0.0, roughness=0.0)
    settings = replace(one_line, rays=20_000)
    scene = Scene((slab(plate, 20.0, 30.0), slab(plate, 40.0, 400.0)), gel, "s")
    echoes, _ = follow(scene, probe, settings)
    at_50 = np.abs(echoes.depth_mm - 50.0) < 0.01  # 20 to 30, 40, back to 30, again to 40, or inside the plate
    mean = echoes.amplitude[at_50].sum() / settings.rays
    t, r = 0.75, 0.5  # two-way transmission; reflection of pressure
    # Face 20, face 30, face 40: paths of 100 mm that end with an echo of R_p at a face.
    gap = t * t * r * r * r  # off 40, off 30 from outside, echo at 40
    inside_first = t * r * r * t * r  # off 30, off 20 from within, through 30, echo at 40
    off_40_and_20 = t * t * r * t * r * r  # off 40, up through 30, off 20 from within, echo at 30
    within = t * r * r * r * r * r  # twice to and fro inside the plate, echo at 30
    assert echoes.clutter[at_50].all()
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
        totals.append(echoes.amplitude[echoes.clutter].sum(dtype=float) / settings.rays)
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
        settings = replace(one_line, rays=30_000, path_seed=seed)
        echoes, _ = follow(scene, probe, settings)
        near = [np.abs(echoes.depth_mm - (20 + 10 * k)) < 1 for k in range(1, 8)]
        means.append([echoes.amplitude[each & echoes.clutter].sum(dtype=float) / settings.rays for each in near])
    truth = (1 - 0.8**2) * 0.8 * 0.8 ** (2 * np.arange(1, 8))
    error = np.std(means, axis=0, ddof=1) / np.sqrt(10)
    assert (np.abs(np.mean(means, axis=0) - truth) < 4 * error + 1e-6 * truth).all()  # the first has no error
    assert (error < 0.15 * truth).all()


def test_draws_beyond_the_table_are_new_ones(gel, slab, probe, one_line) -> None:
    """Off 52 mm and 20 mm, twice; at the 192nd and the 256th interface at random, and not the same rays at both."""
    tissues = [Tissue(name, 1540, z, 0.0, roughness=0.0) for name, z in (("a", 4.5), ("b", 4.51), ("c", 13.53))]
    between = (slab(tissues[1 - i % 2], 20.5 + 0.5 * i, 400.0) for i in range(MAX_ROWS - 1))
    scene = Scene((slab(tissues[0], 20.0, 400.0), *between, slab(tissues[2], 52.0, 400.0)), gel, "s")
    means = []
    for seed in range(10):
        settings = replace(one_line, rays=2000, path_seed=seed)
        echoes, _ = follow(scene, probe, settings)
        again = echoes.clutter & (np.abs(echoes.depth_mm - 116.0) < 0.1)
        means.append(echoes.amplitude[again].sum(dtype=float) / settings.rays)
    assert abs(np.mean(means) - 0.75 * 0.5**5) < 4 * np.std(means, ddof=1) / np.sqrt(10)
    assert np.std(means, ddof=1) < 0.1 * np.mean(means)


def test_fewer_reflected_rays_of_many_bring_as_much(gel, slab, probe, one_line) -> None:
    """A quarter of 32 rays is followed, with four times the weight, half of 16 with twice the weight."""
    plate = Tissue("plate", 1540, 15.0, 0.0, roughness=0.0)
    scene = Scene((slab(plate, 20.0, 22.0), slab(plate, 40.0, 400.0)), gel, "s")
    amplitudes, counts = [], []
    for rays in (16, 32):
        many = [follow(scene, probe, replace(one_line, rays=rays, path_seed=seed))[0] for seed in range(400)]
        late = np.concatenate([echoes.amplitude[echoes.clutter & (echoes.depth_mm < 70)] for echoes in many])
        amplitudes.append(late.sum(dtype=float) / (400 * rays))
        counts.append(len(late))
    assert amplitudes[1] == pytest.approx(amplitudes[0], rel=0.05)
    assert counts[1] < 1.1 * counts[0]


def test_roulette_is_unbiased(gel, slab, probe, one_line) -> None:
    lossy = Tissue("lossy", 1540, 1.5, 1.0, roughness=0.0)
    plate = Tissue("plate", 1540, 15.0, 0.0, roughness=0.0)
    scene = Scene((slab(lossy, -10.0, 400.0), slab(plate, 20.0, 22.0), slab(plate, 40.0, 400.0)), gel, "s")
    means = []
    for roulette_db in (-300.0, 0.0):
        settings = replace(one_line, rays=50_000)
        echoes, _ = follow(scene, probe, settings, roulette_db)
        late = echoes.clutter & (echoes.depth_mm < 70)
        means.append((echoes.amplitude[late].sum() / settings.rays, late.sum()))
    assert means[1][1] < means[0][1]
    assert means[1][0] == pytest.approx(means[0][0], rel=0.1)


def test_one_heavy_path_is_no_haze() -> None:
    """What all lines bring back keeps its sum; the same sum on two lines is a band of few paths, and is left out."""
    even, few = np.full((256, 50), 0.01), np.zeros((256, 50))
    few[128:130] = [[2.0], [0.56]]
    haze, band = (clutter_lines(lines, 200, torch.float64) for lines in (even, few))
    np.testing.assert_allclose(haze[100:156, 60:140], 0.0025, rtol=0.01)
    assert band.max() == 0
