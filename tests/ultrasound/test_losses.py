"""How the envelope falls with depth, and behind what, against alpha f^b and the reflection of a slab's faces."""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import Scene, Tissue
from ablate.ultrasound import ConvexProbe, Simulator

BEHIND = slice(500, 1000)  # 73 to 146 mm
MIDDLE = slice(28, 36)


def power_db(envelope: np.ndarray) -> float:
    return 10 * np.log10((envelope.astype(float) ** 2).mean())


@pytest.mark.parametrize(
    ("alpha", "frequency", "power"),
    [(0.5, 3.0, 1.0), (1.1, 2.0, 1.0), (0.7, 8.0, 1.0), (0.3, 5.0, 1.5), (0.315, 8.0, 1.6), (4.0, 0.5, 2.0)],
)
def test_uniform_tissue_falls_by_twice_alpha_f(tissue, small, ahead, depths, alpha, frequency, power) -> None:
    tissue = replace(tissue, attenuation_db_cm_mhz=alpha, attenuation_power=power)
    probe = ConvexProbe(frequency_mhz=frequency)
    envelope = Simulator(Scene((), tissue, "s"), probe, small).render(ahead).envelope
    log_db = 20 * np.log10(envelope.astype(float)).mean(axis=1)
    slope = np.polyfit(depths(probe, small)[20:-20] / 10, log_db[20:-20], 1)[0]
    assert slope == pytest.approx(-2 * alpha * frequency**power, rel=0.02)


@pytest.mark.parametrize(
    ("thickness_mm", "alpha", "impedance"),
    [
        (5.0, 4.0, 1.5), (20.0, 2.0, 1.5), (35.0, 1.5, 1.5), (20.0, 0.5, 3.0), (10.0, 1.0, 6.0), (30.0, 1.2, 0.6),
        (20.0, 0.0, 1.5),
    ],
)  # fmt: skip
def test_a_shadow_is_as_deep_as_its_slab(tissue, slab, probe, small, ahead, thickness_mm, alpha, impedance) -> None:
    """What a slab takes more than the body it stands in for, both ways, and 1 - R^2 at each face.

    Sound crosses each face twice: t12 t21 = 1 - R^2, which goes with the amplitude.
    """
    stone = Tissue("stone", 1540, impedance, alpha, roughness=0.0)
    plain, shadowed = Scene((), tissue, "s"), Scene((slab(stone, 30.0, 30.0 + thickness_mm),), tissue, "s")
    settings = replace(small, rays=64)
    a, b = (Simulator(scene, probe, settings).render(ahead).envelope[BEHIND, MIDDLE] for scene in (plain, shadowed))
    loss_db = -2 * (alpha - 0.5) * 3.0 * thickness_mm / 10
    r = (impedance - 1.5) / (impedance + 1.5)
    faces_db = 2 * 20 * np.log10(1 - r**2)
    assert power_db(b) - power_db(a) == pytest.approx(loss_db + faces_db, abs=0.5)
