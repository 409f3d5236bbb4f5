"""Speckle: its first-order statistics, its level, that it belongs to the world; compiled as by torch."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter

from ablate.anatomy import Scene, Structure, Tissue
from ablate.ultrasound import ConvexProbe, LinearProbe, Simulator, SimulatorSettings
from ablate.ultrasound.imaging import scatterers
from ablate.ultrasound.imaging.speckle import Speckle
from ablate.ultrasound.settings import SimulatorPrecision

DENSE = Tissue("dense", attenuation_db_cm_mhz=0.0, scatterer_density=0.6, scatterer_sd=0.3)
TEXTURED = replace(DENSE, attenuation_db_cm_mhz=0.5, texture_contrast_db=3.0)
PAPER = SimulatorSettings(rays=1, image_shape=(50, 70))  # rays make no difference to tissue without surfaces


def intensity(envelope: np.ndarray) -> np.ndarray:
    """Squared envelope without its fall with depth."""
    power = envelope.astype(float) ** 2
    return power / power.mean(axis=1, keepdims=True)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def scatter_variance(p: float, mean: float, sd: float) -> float:
    """Var of [u <= p] (mean + sd n): E[s^2] - E[s]^2."""
    return p * (sd**2 + mean**2) - (p * mean) ** 2


def rayleigh_p_value(sample: np.ndarray) -> float:
    """Of a Kolmogorov-Smirnov test whose null distribution is drawn with the scale estimated as in the sample."""
    n = sample.size

    def distance(x: np.ndarray) -> np.ndarray:
        x = np.sort(x, axis=-1)
        expected = 1 - np.exp(-(x**2) / (x**2).mean(axis=-1, keepdims=True))
        rank = np.arange(n) / n
        return np.maximum(expected - rank, rank + 1 / n - expected).max(axis=-1)

    null = distance(np.random.default_rng(0).rayleigh(size=(499, n)))
    return float((1 + (null >= distance(sample)).sum()) / 500)


@pytest.fixture(scope="module")
def paper_envelope() -> np.ndarray:
    return Simulator(Scene((), DENSE, "s"), ConvexProbe(), PAPER).render(np.eye(4)).envelope


@pytest.mark.parametrize("range_mm", [(5, 50), (50, 100), (100, 145)])
def test_speckle_is_fully_developed(paper_envelope, depths, range_mm) -> None:
    probe = ConvexProbe()
    depth = depths(probe, PAPER)
    part = paper_envelope[(depth > range_mm[0]) & (depth < range_mm[1])].astype(float)
    assert part.mean() / part.std() == pytest.approx(1.91, abs=0.05)
    # Samples two widths of the pulse apart are as good as independent: their correlation is exp(-11).
    ends_mm = np.array(range_mm)
    width_mm = 0.8 * np.sqrt(1 + ((ends_mm - 70) / 40) ** 2)
    spacing_mm = (40 + ends_mm) * np.radians(70) / 191
    lines_apart = int(np.ceil((2 * width_mm / spacing_mm).max()))
    assert rayleigh_p_value(part[::26, ::lines_apart].ravel()) > 0.01


@pytest.mark.parametrize("axial_samples", [512, 1024, 3072])
def test_level_does_not_depend_on_sampling(probe, small, ahead, axial_samples) -> None:
    tissue = Tissue("t", attenuation_db_cm_mhz=0.0, scatterer_density=0.7, scatterer_mean=0.5, scatterer_sd=0.6)
    settings = replace(small, axial_samples=axial_samples, scatterer_level_db=-30.0)
    pose = ahead.copy()
    pose[:3, :3] = [[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]
    envelope = Simulator(Scene((), tissue, "s"), probe, settings).render(pose).envelope
    rms_db = 10 * np.log10((envelope.astype(float) ** 2).mean())
    assert rms_db == pytest.approx(-30 + 10 * np.log10(scatter_variance(0.7, 0.5, 0.6)), abs=0.35)


@pytest.mark.parametrize(
    ("near", "far"),
    [
        ((0.5, 0.4, 0.2), (0.9, 0.0, 0.9)),
        ((0.6, 0.0, 1.0), (0.6, 0.0, 0.3)),
        ((1.0, 0.19, 0.24), (0.6, 0.4, 0.3)),
        ((0.5, 0.8, 0.0), (1.0, 0.8, 0.1)),
        ((0.1, 0.0, 1.0), (0.9, 0.0, 1.0)),
    ],
)
def test_contrast_follows_the_scatterers(probe, small, ahead, slab, near, far) -> None:
    a, b = (
        Tissue(name, attenuation_db_cm_mhz=0.0, scatterer_density=p, scatterer_mean=mean, scatterer_sd=sd)
        for name, (p, mean, sd) in (("a", near), ("b", far))
    )
    envelope = Simulator(Scene((slab(b, 75.0, 300.0),), a, "s"), probe, small).render(ahead).envelope.astype(float)
    level_db = 10 * np.log10([(envelope[part] ** 2).mean() for part in (slice(50, 450), slice(720, 1000))])
    contrast_db = 10 * np.log10(scatter_variance(*far) / scatter_variance(*near))
    assert level_db[1] - level_db[0] == pytest.approx(contrast_db, abs=1.0)


@pytest.mark.parametrize(("contrast_db", "cell_mm"), [(4.0, 2.0), (6.0, 0.2)])
def test_texture_keeps_the_mean_power(probe, small, ahead, contrast_db, cell_mm) -> None:
    plain = Tissue("t", attenuation_db_cm_mhz=0.0)
    textured = replace(plain, texture_contrast_db=contrast_db, texture_mm=(cell_mm,) * 3)
    power = [
        (Simulator(Scene((), tissue, "s"), probe, small).render(ahead).envelope.astype(float) ** 2).mean()
        for tissue in (plain, textured)
    ]
    assert 10 * np.log10(power[1] / power[0]) == pytest.approx(0, abs=0.5)


def test_texture_leaves_the_illumination_of_a_shallow_image_as_it_is(ahead, slab) -> None:
    probe = LinearProbe(width_mm=10, depth_mm=2, frequency_mhz=15)
    settings = SimulatorSettings(scanlines=16, axial_samples=512, rays=2, layers=1, image_shape=(32, 32))
    plain = Tissue("t", attenuation_db_cm_mhz=0.0)
    loss = slab(replace(plain, name="loss", attenuation_db_cm_mhz=20.0), 0.5, 1.0, 20.0)
    envelopes = [
        Simulator(Scene((loss,), replace(plain, texture_contrast_db=contrast), "s"), probe, settings).render(ahead)
        for contrast in (0.0, 1e-6)
    ]
    np.testing.assert_allclose(envelopes[1].envelope, envelopes[0].envelope, rtol=1e-3)


def test_a_thin_target_is_as_bright_in_gel_as_in_what_hardly_scatters() -> None:
    """Rays beside it in the gel, out of its plane, light it as those do that cross it."""
    target = Tissue("target", attenuation_db_cm_mhz=0.0, roughness=0.0)
    gel = replace(target, name="gel", scatterer_density=0.0)
    along_x = trimesh.creation.cylinder(
        1.0, 200.0, transform=trimesh.transformations.rotation_matrix(np.pi / 2, (0, 1, 0))
    )
    scene = Scene((Structure(along_x.apply_translation((0, 0, 130)), target),), gel, "s")
    faint = replace(scene, background=replace(target, name="faint", scatterer_sd=1e-5, scatterer_mean=0.0))
    probe, settings = ConvexProbe(frequency_mhz=5.0), SimulatorSettings(axial_samples=1024, image_shape=(64, 64))
    inside = Simulator(scene, probe, settings).scanline_tissues(np.eye(4)).T == 1
    in_gel, expected = (
        np.mean([simulator.render(np.eye(4), seed).envelope[inside].astype(float) ** 2 for seed in range(2)])
        for simulator in (Simulator(s, probe, settings) for s in (scene, faint))
    )
    assert 10 * np.log10(in_gel / expected) == pytest.approx(0.0, abs=0.2)


def test_another_seed_has_another_texture(probe, small, ahead) -> None:
    """Nothing of it is in the maps of a frame: a re-simulation that kept it would know more than a network can."""
    tissue = replace(TEXTURED, texture_contrast_db=6.0, texture_mm=(3.0, 3.0, 3.0))
    simulator = Simulator(Scene((), tissue, "s"), probe, replace(small, tgc_db_cm_mhz=0.5))
    levels = [np.log(simulator.render(ahead, seed).envelope[100:900]) for seed in (0, 1, 2, 2**70)]
    slow = [gaussian_filter(level - level.mean(axis=1, keepdims=True), (24, 2)) for level in levels]
    assert max(abs(correlation(slow[0], other)) for other in slow[1:]) < 0.3


@pytest.mark.parametrize("layers", [1, 3])
def test_turned_by_180_degrees_the_speckle_is_mirrored(probe, small, layers) -> None:
    simulator = Simulator(Scene((), TEXTURED, "s"), probe, replace(small, layers=layers, tgc_db_cm_mhz=0.5))
    pose = np.eye(4)
    pose[:3, 3] = 13.0, -7.0, 22.0
    there, back = simulator.render(pose), simulator.render(pose @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert correlation(intensity(there.envelope), intensity(back.envelope)[:, ::-1]) > 0.999
    assert np.mean(np.abs(there.image.astype(int) - back.image[:, ::-1]) > 1) < 1e-3
    # Turned by 90 degrees it is another plane, which shares no more than its axis.
    quarter = pose @ np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    beside = np.r_[0:28, 36:64]
    other = simulator.render(quarter).envelope
    assert abs(correlation(intensity(there.envelope)[:, beside], intensity(other)[:, beside])) < 0.05


@pytest.mark.parametrize("range_mm", [(5, 40), (60, 80), (110, 145)])
def test_low_quality_shows_the_same_speckle(paper_envelope, depths, range_mm) -> None:
    """L sees the middle one of H's three layers; the correlation of intensities is that layer's share of the power."""
    low = SimulatorSettings.low_quality(image_shape=(50, 70))
    assert (low.rays, low.layers) == (1, 1)
    envelope = Simulator(Scene((), DENSE, "s"), ConvexProbe(), low).render(np.eye(4)).envelope
    depth = depths(ConvexProbe(), PAPER)
    rows = (depth > range_mm[0]) & (depth < range_mm[1])
    sigma_mm = 2.5 * np.sqrt(1 + ((depth[rows] - 70) / 40) ** 2) / np.sqrt(8 * np.log(2))
    share = 1 / (1 + 2 * np.exp(-((1.5 / sigma_mm) ** 2)))
    assert correlation(paper_envelope[rows] ** 2, envelope[rows] ** 2) == pytest.approx(share.mean(), abs=0.04)


def test_seeds_choose_scatterers_and_paths_apart(gel, slab, ball, probe, small, ahead) -> None:
    body = Tissue("body", 1540, 1.6, 0.5, 0.6, 0.0, 0.8)
    bone = Tissue("bone", 2600, 4.2, 5.0, 0.6, 0.0, 0.2)
    scene = Scene((slab(body, 3.0, 200.0), ball(bone, (0.0, 0.0, 60.0), 10.0)), gel, "s")
    window = (slice(50, 300), slice(20, 44))
    simulator = Simulator(scene, probe, small)
    first, *others = (intensity(simulator.render(ahead, seed).envelope[window]) for seed in (0, 1, 2**31, 2**40 + 1))
    paths = intensity(Simulator(scene, probe, replace(small, path_seed=1)).render(ahead).envelope[window])
    assert correlation(first, paths) > 0.95
    assert (first != paths).mean() > 0.5
    assert max(abs(correlation(first, other)) for other in others) < 0.1


@pytest.mark.parametrize("precision", list(SimulatorPrecision))
@pytest.mark.parametrize("anchor", [(0, 0, 0), (2**32 - 2**20, 3 * 2**20, 2**31)], ids=["near", "far"])
def test_equals_the_sum_of_hashed_cells(gel: Tissue, tissue: Tissue, precision, anchor) -> None:
    """Samples of random tissues, a fourth of them without any sound, hashed in whole numbers of any size."""
    settings = replace(SimulatorSettings(), scanlines=40, axial_samples=300, layers=3, precision=precision)
    random, dtype = np.random.default_rng(3), getattr(np, precision.value)
    shape = settings.layers, settings.scanlines, settings.axial_samples
    starts, directions = (random.normal(0, scale, (*shape[:2], 3)).astype(np.float32) for scale in (60, 1))
    along = np.broadcast_to(np.linspace(0.05, 150, shape[2], dtype=np.float32), shape)
    amplitude = (np.exp(random.normal(size=shape)) * (random.random(shape) > 0.25)).astype(dtype)
    held = random.integers(0, 3, shape).astype(np.uint8)
    tissues = gel, tissue, replace(tissue, name="sparse", scatterer_density=0.01)
    chain = Speckle(tissues, ConvexProbe(), settings, dtype)
    lines = scatterers.Samples(starts, directions, np.array(anchor, np.uint32), along, held, amplitude)
    received = chain(lines, seed=5)
    points = starts[:, :, None] + directions[:, :, None] * along[..., None]
    cells = np.floor(points * np.float32(1 / settings.scatterer_pitch_mm)).astype(np.int64) + anchor
    mixed = np.uint64(scatterers.mix_seed(5))
    for axis, factor in enumerate((0x1B873593, 0x2545F491, 0x27D4EB2F)):
        mixed = mixed ^ ((cells[..., axis] % 2**32 * factor) % 2**32).astype(np.uint64)
    for shift, factor in ((15, 0x2C1B3C6D), (12, 0x297A2D39)):
        mixed = (mixed ^ (mixed >> shift)) * np.uint64(factor) % 2**32
    chosen = (mixed ^ (mixed >> 15)) % scatterers.TABLE_SIZE
    tables = np.stack([scatterers.scatterer_table(tissue) for tissue in tissues])
    expected = (tables[held, chosen.astype(int)] * amplitude).sum(axis=0)
    assert received.dtype == dtype
    assert (np.abs(received).max(axis=(0, 2)) > 0).all()
    # A processor may round a product and a sum once, which takes some samples to the next cell.
    differs = np.abs(received[0] + 1j * received[1] - expected) > 1e-5 * np.abs(expected).max()
    assert differs.mean() < 1e-3
