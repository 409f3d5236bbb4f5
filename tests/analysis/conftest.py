"""A small study with known differences, and pictures that look like speckle in a fan."""

import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter

from ablate.analysis import RESIMULATION, FramePictures

SHIFTS = {RESIMULATION: 2.0, "sa2h": 0.0, "sa2h-att": -1.0, "nsa2h": -2.0}


def make_study(seeds=(0, 1, 2), variants=tuple(SHIFTS), frames=24, sites=8):
    rng = np.random.default_rng(0)
    easy = rng.normal(size=frames)
    rows = []
    for variant in variants:
        for seed in (0,) if variant == RESIMULATION else seeds:
            for frame in range(frames):
                value = 18 + easy[frame] + SHIFTS[variant] + 0.1 * rng.normal()
                site = f"site{frame % sites}"
                rows.append((variant, seed, frame, site, "psnr", value))
                rows.append((variant, seed, frame, site, "pchi2", 0.2 - 0.05 * SHIFTS[variant] + 0.01 * easy[frame]))
    return pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"])


@pytest.fixture(scope="session")
def study():
    return make_study()


@pytest.fixture(scope="session")
def study_of():
    return make_study


@pytest.fixture(scope="session")
def pictures():
    shape = (100, 138)
    y, x = np.mgrid[: shape[0], : shape[1]]
    radius, angle = np.hypot(y + 20, x - 69), np.arctan2(x - 69, y + 20)
    mask = (np.abs(angle) < 0.6) & (radius > 25) & (radius < 118)

    def speckle(seed):
        rng = np.random.default_rng(seed)
        real, imaginary = (gaussian_filter(rng.normal(size=shape), (0.8, 1.3)) for _ in range(2))
        return (np.clip(150 + 85 * np.log10(np.hypot(real, imaginary) + 0.01), 0, 255) * mask).astype(np.uint8)

    predictions = {RESIMULATION: speckle(1), "sa2h": speckle(2), "sa2h-att": speckle(3) // 2}
    labels = (1 + (radius > 70)).astype(np.uint8) * mask
    attenuation = (np.exp(-radius / 40) * mask).astype(np.float32)
    return FramePictures("frame 7", speckle(0), predictions, mask, labels, attenuation)


@pytest.fixture
def figures(monkeypatch):
    """Figures by the name of their file, as they are handed over to be saved."""
    drawn = {}

    def keep(figure, stem):
        drawn[stem.name] = figure
        return [stem]

    drawers = [f"{name}_figure" for name in ("boxplot", "forest", "qualitative", "chi2_maps")]
    for module in (*drawers, "point_names"):
        monkeypatch.setattr(f"ablate.analysis.figures.{module}.save_figure", keep)
    return drawn
