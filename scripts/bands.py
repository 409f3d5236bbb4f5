"""What is too small to matter, to look at: a frame of a network, and it with the changes that a band lets pass.

A change and its opposite are scaled until the mean score of the network over some test frames is worse by the band: the
share of conf/component of the way from the formula to re-simulation.

python scripts/bands.py    # docs/bands.png, and a table; two minutes
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

import ablate
from ablate.analysis import scale_length
from ablate.anatomy import TissueKind
from ablate.command.compose import jobs_of
from ablate.dataset import Part
from ablate.evaluation import ImageSource, Scorer, formula_images, resimulation_images
from ablate.evaluation.scorer import tissue_labels
from ablate.metrics import METRICS, choose_metrics
from ablate.metrics.structures import relative_attenuation, surface_band
from ablate.networks import GeneratorSpec
from ablate.pretrained.renderer import OUTSIDE, Renderer
from ablate.settings.components import components
from ablate.sources.data_set import DataSet, maps_needed
from ablate.sources.prepare import prepare_data
from ablate.training import TrainingPrecision, generated_images
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

DOCS = Path(__file__).parents[1] / "docs"
#: The body that the network was trained on, and poses that it was not: another body has another time gain.
FRAMES = ("preset=quick", "dataset.frames=32", "dataset.test=0.5")
SHOWN = 5  # which of the test frames
SMOOTH_PX = 8.0
MOST = {"octave_sd": 4.0}  # times the texture; of all others, grey levels
GREY_LEVELS = 160.0
WHAT = {
    "shadow_contrast": "shadows {:+.1f}",
    "thin_contrast": "bone surfaces {:+.1f}",
    "mae_smooth": "smooth field of {:+.1f}",
    "pchi2_tissue": "all grey levels {:+.1f}",
    "octave_sd": "texture {:+.0%}",
}
#: An image, its frame's number among those rendered, and how much of the change -> the changed image, (H, W) float.
Change = Callable[[np.ndarray, int, float], np.ndarray]


@dataclass(frozen=True, eq=False)
class Judged:
    """What a band lets pass: scores of the two ends of the scale and of the network, and the changes of either sign.

    `band` is in units of the metric. `less` and `more` are in grey levels or, of texture, shares; NaN where no change
    makes the score so much worse. `images`, (H, W) uint8, are of these.
    """

    metric: str
    formula: float
    resimulation: float
    network: float
    band: float
    less: float
    more: float
    images: tuple[np.ndarray, ...]


def made(folder: Path) -> DataSet:
    """Simulated frames with their re-simulation, in a folder."""
    (job,) = jobs_of([*FRAMES, f"runs_dir={folder}"])
    return prepare_data(job.settings, job.data, job.identity["data"], maps_needed([job.settings.model]))


def changes(data: DataSet, numbers: np.ndarray) -> dict[str, Change]:
    """By metric, the change that it is to see."""
    pairs = data.pairs
    assert pairs.probe is not None
    depth_mm, mask = pixel_polar(pairs.probe, pairs.shape)[0], pairs.mask()
    attenuation = pairs.read("attenuation", numbers)
    shadows = [np.nan_to_num(relative_attenuation(a, mask, depth_mm), nan=1.0) < 1 for a in attenuation]
    bones = np.isin(pairs.read("segmentation", numbers), tissue_labels(data.tissues, [TissueKind.bone]))
    pixel_mm = pixel_size_mm(pairs.probe, pairs.shape)
    surfaces = [surface_band(of_frame, depth_mm, pixel_mm) for of_frame in bones]
    field = gaussian_filter(np.random.default_rng(0).standard_normal(pairs.shape), SMOOTH_PX)
    field /= np.abs(field).mean()
    return {
        "shadow_contrast": lambda image, k, much: image + much * shadows[k],
        "thin_contrast": lambda image, k, much: image + much * surfaces[k],
        "mae_smooth": lambda image, _, much: image + much * field,
        "pchi2_tissue": lambda image, _, much: image + much,
        "octave_sd": lambda image, _, much: image + much * (image - gaussian_filter(image, SMOOTH_PX)),
    }


def grey(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Grey levels, dithered so that less than one level changes some of the pixels."""
    dither = np.random.default_rng(1).random(image.shape)
    return np.where(mask, np.clip(image + dither, 0, 255), 0).astype(np.uint8)


def change_by(worse_by: Callable[[float], float], sign: float, most: float) -> float:
    """The smallest amount of a sign from which on a score is worse by more than the band; NaN where none is."""
    end = most / 256
    while end <= most and worse_by(sign * end) < 0:
        end *= 2
    if end > most:
        return np.nan
    return sign * float(brentq(lambda much: worse_by(sign * much), end / 2, end, xtol=1e-3 * end))


def network_images(renderer: Renderer, data: DataSet, numbers: np.ndarray) -> np.ndarray:
    """Frames as a network that comes with the package renders them, (k, H, W) uint8."""
    values = [renderer.values[OUTSIDE], *(renderer.values[tissue.name] for tissue in data.tissues)]
    render = generated_images(renderer.generator, data.pairs, np.float32(values), TrainingPrecision.fp32)
    return render(numbers, 0)


def judged(metric: str, share: float, images: np.ndarray, change: Change, data: DataSet, spec: GeneratorSpec) -> Judged:
    """The largest change of a network's images that a share of the scale lets pass, by a metric."""
    pairs = data.pairs
    numbers = pairs.frames(Part.test)
    scorer = Scorer(pairs, data.tissues, pairs.probe, metrics=choose_metrics([metric]))

    def score(source: ImageSource) -> float:
        return scorer.score(Part.test, source, draws_noise=False).scalars[metric]

    def changed(much: float) -> np.ndarray:
        frames = (change(image.astype(float), k, much) for k, image in enumerate(images))
        return np.stack([grey(frame, pairs.mask()) for frame in frames])

    def of_network(much: float) -> float:
        frames = changed(much)
        return score(lambda asked, _: frames[np.searchsorted(numbers, asked)])

    formula, best = score(formula_images(data.tissues, pairs, spec)), score(resimulation_images(pairs))
    band = share * scale_length(metric, formula, best)
    here = of_network(0.0)
    most = MOST.get(metric, GREY_LEVELS)
    amounts = [change_by(lambda amount: of_network(amount) - here - band, sign, most) for sign in (-1.0, 1.0)]
    return Judged(metric, formula, best, here, band, *amounts, tuple(changed(np.nan_to_num(m))[SHOWN] for m in amounts))


def draw(before: np.ndarray, target: np.ndarray, found: Sequence[Judged], path: Path) -> None:
    """A row a metric: a network's frame between the frames with a change of either sign; the target above."""
    figure = Figure(figsize=(10, 2.35 * (len(found) + 1)), layout="constrained")
    axes = figure.subplots(len(found) + 1, 3)
    rows = [(None, (target, before, None), ("target", "SA2H", ""))]
    for one in found:
        metric = METRICS[one.metric]
        worse = f"{metric.label} worse by {one.band:.2g} {metric.unit}".strip()
        told = [WHAT[one.metric].format(much) for much in (one.less, one.more)]
        rows.append((worse, (one.images[0], before, one.images[1]), (told[0], "SA2H; beside it", told[1])))
    for cells, (worse, images, titles) in zip(axes, rows, strict=True):
        for place, (ax, image, title) in enumerate(zip(cells, images, titles, strict=True)):
            ax.set_axis_off()
            if image is not None:
                ax.imshow(image, "gray", vmin=0, vmax=255)
                ax.set_title(f"{title}: {worse}" if worse and place == 1 else title, fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Draw the pairs and print what they are."""
    renderer = ablate.load("sa2h")
    shares = {str(component.metric): component.share for component in components() if component.share}
    with TemporaryDirectory() as folder:
        data = made(Path(folder))
        numbers = data.pairs.frames(Part.test)
        images = network_images(renderer, data, numbers)
        spec = renderer.generator.spec
        found = [
            judged(metric, shares[metric], images, change, data, spec)
            for metric, change in changes(data, numbers).items()
        ]
        target = data.pairs.read("target", numbers)[SHOWN]
    table = pd.DataFrame([{k: v for k, v in vars(one).items() if k != "images"} for one in found])
    print(table.to_string(index=False, float_format="{:.3g}".format))
    draw(images[SHOWN], target, found, DOCS / "bands.png")


if __name__ == "__main__":
    main()
