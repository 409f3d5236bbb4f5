"""What is too small to matter, to look at: a frame, and beside it the frame changed by the band of each primary metric.

A change is scaled until its metric, of the changed frame against the frame itself, is the band of conf/component.

python scripts/bands.py    # docs/bands.png
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

from ablate.anatomy import TissueKind, fetal_abdomen, fetal_planes
from ablate.command.compose import jobs_of
from ablate.evaluation.scorer import tissue_labels
from ablate.metrics import METRICS, Metric, Pair
from ablate.metrics.structures import relative_attenuation, surface_band
from ablate.settings.conf import components
from ablate.ultrasound import Simulator, with_patient_gain
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

DOCS = Path(__file__).parents[1] / "docs"
PLANE = "spine"  # bones, and shadows behind them
SMOOTH_PX = 8.0
Change = Callable[[float], np.ndarray]


def simulated() -> Pair:
    """A frame of the study's size as a pair with itself; it is no frame of its data sets."""
    settings = jobs_of(["preset=traced"])[0].settings
    scene, planes = fetal_abdomen(triangles=settings.scene.triangles), fetal_planes()
    simulator = with_patient_gain(scene, settings.probe, settings.simulator, np.array(list(planes.values())))
    frame = Simulator(scene, settings.probe, simulator).render(planes[PLANE])
    shape = frame.image.shape
    solid, bone = (
        np.isin(frame.segmentation, tissue_labels(scene.tissues, kinds))
        for kinds in ([TissueKind.soft, TissueKind.bone], [TissueKind.bone])
    )
    return Pair(
        frame.image, frame.image, frame.segmentation > 0, solid, frame.attenuation,
        pixel_polar(settings.probe, shape)[0], frame.segmentation, bone, pixel_size_mm(settings.probe, shape),
    )  # fmt: skip


def changes(pair: Pair) -> dict[str, Change]:
    """By metric, what it is to see: the frame with so much of a change, (H, W) uint8."""
    assert pair.attenuation is not None
    assert pair.depth_mm is not None
    assert pair.bone_mask is not None
    assert pair.pixel_mm is not None
    image = pair.target.astype(np.float64)
    shadow = np.nan_to_num(relative_attenuation(pair.attenuation, pair.mask, pair.depth_mm), nan=1.0) < 1
    surface = surface_band(pair.bone_mask, pair.depth_mm, pair.pixel_mm)
    field = gaussian_filter(np.random.default_rng(0).standard_normal(image.shape), SMOOTH_PX)
    texture = image - gaussian_filter(image, SMOOTH_PX)
    stripes = (-1.0) ** np.arange(image.shape[1])
    dither = np.random.default_rng(1).random(image.shape)  # so that less than a grey level changes some of the pixels

    def added(what: np.ndarray) -> Change:
        return lambda much: np.where(pair.mask, np.clip(image + much * what + dither, 0, 255), 0).astype(np.uint8)

    return {
        "shadow_contrast": added(shadow),
        "thin_contrast": added(surface),
        "mae_smooth": added(field / np.abs(field).mean()),
        "pchi2_tissue": added(np.ones_like(image)),
        "octave_sd": added(texture),
        "nyquist_excess": added(np.broadcast_to(stripes, image.shape)),
    }


def by_band(pair: Pair, metric: Metric, change: Change, band: float) -> np.ndarray:
    """The frame with so much of a change that the metric is the band, within 1 %; a ValueError where none is."""

    def above(much: float) -> float:
        value = metric.of_image(replace(pair, prediction=change(much))) if metric.of_image else None
        if value is None:
            raise ValueError(f"{metric.name} is not known of this frame")
        return float(value) - band

    end = 1 / 64
    while above(end) < 0:
        end *= 2
    much = brentq(above, 0.0, end, xtol=1e-6)
    if abs(above(much)) > 0.01 * band:
        raise ValueError(f"{metric.name} is {above(much) + band:.3g}, not the band of {band:g}")
    return change(much)


def main() -> None:
    """Draw the pairs."""
    pair = simulated()
    bands = {c.metric: c.band for c in components() if c.metric and c.band}
    figure = Figure(figsize=(11, 6.4), layout="constrained")
    axes = figure.subplots(3, 4)
    for (left, right), (name, change) in zip(axes.reshape(-1, 2), changes(pair).items(), strict=True):
        metric = METRICS[name]
        left.imshow(pair.target, "gray", vmin=0, vmax=255)
        right.imshow(by_band(pair, metric, change, bands[name]), "gray", vmin=0, vmax=255)
        left.set_title("frame", fontsize=9)
        right.set_title(f"{metric.label} {bands[name]:g} {metric.unit}", fontsize=9)
    for ax in axes.flat:
        ax.set_axis_off()
    figure.savefig(DOCS / "bands.png", dpi=110)


if __name__ == "__main__":
    main()
