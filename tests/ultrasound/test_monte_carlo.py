"""Echoes of surfaces and what they let through, the mean of many paths, against closed forms and quadrature."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import Simulator
from support.traced_rays import tilted

SEEDS = range(4)
FACES_MM = (30.0, 60.0, 100.0)  # no path that is reflected thrice ends within 10 mm of the last
IMPEDANCES = (2.5, 1.5, 4.5)  # behind each face, after 1.5 before the first


def within_three_standard_errors(values: np.ndarray, truth: float) -> bool:
    error = values.std(ddof=1) / np.sqrt(values.size)
    return bool(abs(values.mean() - truth) <= 3 * error + 1e-4 * truth)


def fresnel(z1: float, z2: float, c1: float, c2: float, angle: float) -> float:
    """Reflection coefficient of pressure between two fluids; 1 where Snell's law has no solution."""
    sine = c2 / c1 * np.sin(angle)
    if sine >= 1:
        return 1.0
    cos_i, cos_t = np.cos(angle), np.sqrt(1 - sine**2)
    return (z2 * cos_i - z1 * cos_t) / (z2 * cos_i + z1 * cos_t)


def over_normals(value: Callable[[float], float], roughness: float, kinks: list[float]) -> float:
    """Mean of a function of the angle between ray and normal, the surface being met head on.

    Normals have the density (s + 1) cos(t)^s sin(t), s = 1 / roughness; one tilted by more than 45 degrees would send
    the reflection into the surface, and the surface's own takes its place.
    """
    s, most = 1 / roughness, np.pi / 4
    inside = [kink for kink in kinks if kink < most]
    mean, _ = integrate.quad(lambda t: value(t) * (s + 1) * np.cos(t) ** s * np.sin(t), 0, most, points=inside or None)
    return mean + value(0.0) * np.cos(most) ** (s + 1)


@pytest.fixture
def stack(gel, slab) -> Scene:
    """Three faces that echo, in a medium of 0.3 dB/cm/MHz."""
    tissues = [Tissue(f"t{i}", 1540, z, 0.3, 0.0, 0.0, 0.0, roughness=0.0) for i, z in enumerate(IMPEDANCES)]
    faces = tuple(slab(tissue, near, 400.0) for tissue, near in zip(tissues, FACES_MM, strict=True))
    return Scene(faces, replace(gel, attenuation_db_cm_mhz=0.3), "s")


@pytest.fixture
def rough(slab) -> Callable[[Tissue, float, float], tuple[Scene, Scene]]:
    """A rough face at 60 mm in front of tissue, and the same tissue with nothing to see in front of it."""

    def make(behind: Tissue, roughness: float, specularity: float) -> tuple[Scene, Scene]:
        front = Tissue("front", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=roughness, specularity=specularity)
        same = replace(front, speed_m_s=behind.speed_m_s, impedance_mrayl=behind.impedance_mrayl)
        with_face, without = (Scene((slab(tissue, -50.0, 60.0),), behind, "s") for tissue in (front, same))
        return with_face, without

    return make


@pytest.mark.parametrize("face", [0, 1, 2])
def test_mean_echo_behind_other_faces(stack, pencil, apart, amplitudes, face) -> None:
    """|R| of its own face, 1 - R^2 of each face before, and the loss of both ways."""
    z = (1.5, *IMPEDANCES)
    r = [(b - a) / (b + a) for a, b in pairwise(z)]
    loss_db = 2 * 0.3 * 3.0 * FACES_MM[face] / 10
    truth = abs(r[face]) * np.prod([1 - before**2 for before in r[:face]]) * 10 ** (-loss_db / 20)
    around = FACES_MM[face] - 3, FACES_MM[face] + 3
    echoes = amplitudes(stack, pencil, replace(apart, rays=30), around, path_seeds=SEEDS)
    assert within_three_standard_errors(echoes, truth)


@pytest.mark.parametrize(("impedance", "speed", "roughness"), [(1.5, 2600, 0.05), (3.0, 1200, 1.0)])
def test_mean_over_rough_normals(rough, pencil, apart, amplitudes, impedance, speed, roughness) -> None:
    """Echo and transmission of a rough face are integrals over the power-cosine lobe of its normals."""
    behind = Tissue("behind", speed, impedance, 0.0, 0.6, 0.0, 1.0)
    with_face, without = rough(behind, roughness, 6.0)
    critical = [np.arcsin(1540 / speed)] if speed > 1540 else []

    def r(angle: float) -> float:
        return fresnel(1.5, impedance, 1540, speed, angle)

    echo = over_normals(lambda t: abs(r(t)) * max(0.0, np.cos(2 * t)) ** 6, roughness, critical)
    anechoic = Scene(with_face.structures, replace(behind, scatterer_density=0.0), "s")
    assert within_three_standard_errors(amplitudes(anechoic, pencil, apart, (50, 70), path_seeds=SEEDS), echo)

    # Scatterers far stronger than the echo of the face: the speckle of each line follows what reaches it.
    strong = replace(apart, scatterer_level_db=60.0)
    behind_face = amplitudes(with_face, pencil, strong, (80, 140), path_seeds=SEEDS)
    through = behind_face / amplitudes(without, pencil, strong, (80, 140))
    transmitted = over_normals(lambda t: 1 - r(t) ** 2, roughness, critical)
    assert within_three_standard_errors(through, transmitted)


@pytest.mark.parametrize(
    ("degrees", "impedance", "speed"), [(15.0, 4.5, 2600), (45.0, 4.5, 2600), (30.0, 0.8, 1100), (45.0, 1.5, 1900)]
)
def test_oblique_faces_follow_fresnel(gel, slab, pencil, apart, amplitudes, degrees, impedance, speed) -> None:
    """Echo |R| cos(2 t)^n and transmission 1 - R^2, beyond the critical angle (36 degrees for 2600 m/s) too."""
    angle = np.radians(degrees)
    pose = tilted(degrees)
    behind = Tissue("behind", speed, impedance, 0.0, 0.6, 0.0, 1.0)
    front = replace(gel, specularity=2.0)
    same = replace(front, speed_m_s=speed, impedance_mrayl=impedance)
    r = fresnel(1.5, impedance, 1540, speed, angle)

    anechoic = Scene((slab(front, -400.0, 40.0),), replace(behind, scatterer_density=0.0), "s")
    echo = amplitudes(anechoic, pencil, apart, (35, 65), pose)
    np.testing.assert_allclose(echo, abs(r) * np.cos(2 * angle) ** 2, rtol=2e-3, atol=1e-6)

    strong = replace(apart, scatterer_level_db=60.0)
    scenes = (Scene((slab(tissue, -400.0, 40.0),), behind, "s") for tissue in (front, same))
    with_face, without = (amplitudes(scene, pencil, strong, (80, 140), pose) for scene in scenes)
    assert within_three_standard_errors(with_face / without, 1 - r**2)


def test_error_falls_with_the_number_of_rays(rough, pencil, apart, amplitudes) -> None:
    counts, errors = (1, 4, 16, 64, 256), []
    anechoic = Tissue("behind", 1200, 3.0, 0.0, 0.0, 0.0, 0.0)
    scene = rough(anechoic, 0.2, 6.0)[0]
    truth = over_normals(lambda t: abs(fresnel(1.5, 3.0, 1540, 1200, t)) * max(0.0, np.cos(2 * t)) ** 6, 0.2, [])
    for rays in counts:
        echoes = amplitudes(scene, pencil, replace(apart, rays=rays), (50.0, 70.0), path_seeds=range(2))
        errors.append(np.sqrt(np.mean((echoes - truth) ** 2)))
    assert np.polyfit(np.log(counts), np.log(errors), 1)[0] <= -0.45


def test_flat_perfect_reflector_is_0_db(gel, slab, probe, small, ahead) -> None:
    """With the rays of a whole aperture, at the focus, seen by the probe's middle line."""
    gas = Tissue("gas", 1540, 1e-6, 0.0, roughness=0.0)
    settings = replace(small, scanlines=65)
    envelope = Simulator(Scene((slab(gas, 70.0, 300.0),), gel, "s"), probe, settings).render(ahead).envelope
    assert 20 * np.log10(envelope[:, 32].max()) == pytest.approx(0.0, abs=0.3)


def test_other_paths_have_other_clutter(gel, slab, pencil, apart) -> None:
    """Else the mean over path seeds does not converge to the mean over paths."""
    tissues = (Tissue(name, 1540, z, 0.0, 0.0, 0.0, 0.0, roughness=0.0) for name, z in (("a", 4.5), ("b", 13.5)))
    plates = Scene(tuple(slab(t, near, 400.0) for t, near in zip(tissues, (30.0, 60.0), strict=True)), gel, "s")
    settings = replace(apart, rays=256)
    first, second = (
        Simulator(plates, pencil, replace(settings, path_seed=seed)).render(np.eye(4)).envelope[600:630]
        for seed in (0, 1)
    )
    assert min(first.min(), second.min()) > 0
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.3
