"""The two ends of the scale that networks stand on: the formula, which is 0, and re-simulation, which is 1.

Both render the frames of a data set without a network, so their scores are the same for every run on it, and are kept
beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ablate.anatomy import Tissue
from ablate.dataset import Part, noise_seeds
from ablate.evaluation.scores import Scores, joined
from ablate.evaluation.settings import BASELINES_FOLDER
from ablate.metrics import METRICS, METRICS_VERSION, FeatureKind, Metric
from ablate.metrics.metric import FORMULA, RESIMULATED
from ablate.networks import Attenuation, GeneratorSpec, Interfaces, Noise, Space
from ablate.networks.spec import GRAIN
from ablate.storage import digest, held, known_json, write_json

if TYPE_CHECKING:
    from ablate.dataset import Pairs  # only here: frames that are read otherwise need no Zarr
    from ablate.evaluation.scorer import ImageSource, Scorer

_DRAWS = 2  # re-simulation has no more: its second draw is the target


@dataclass(frozen=True)
class Baseline:
    """A renderer without weights.

    Attributes
    ----------
    name : str
        The source of its scores, `resimulation` or `formula`.
    images : ImageSource
        Renders frames of the data set.
    moved_images : ImageSource, optional
        Renders those after motions.
    beam_images : ImageSource, optional
        Renders them in beam space.
    recipe : mapping
        What decides its images beside the data set, as JSON values.
    """

    name: str
    images: ImageSource
    moved_images: ImageSource | None
    beam_images: ImageSource | None
    recipe: Mapping[str, Any]


def baselines(scorer: Scorer, spec: GeneratorSpec) -> tuple[Baseline, ...]:
    """The baselines that a data set offers: pairs made elsewhere may have none.

    `spec` says which maps the formula reads: the illumination and the interface map where a network reads them, else S
    and A, and the lattice of scatterers where it is the network's noise.
    """
    from ablate.ultrasound.formula import FORMULA_VERSION

    pairs, moved = scorer.pairs, scorer.moved
    found, in_beam = [], spec.space is Space.beam
    if "resimulation" in pairs.maps:
        moved_images = None if moved is None else resimulation_images(moved.pairs)
        beam_images = resimulation_images(pairs, Space.beam) if in_beam else None
        found.append(
            Baseline(RESIMULATED, resimulation_images(pairs), moved_images, beam_images, {"space": spec.space})
        )
    if pairs.simulator is not None:
        images = formula_images(scorer.tissues, pairs, spec)
        beam_images = formula_images(scorer.tissues, pairs, spec, space=Space.beam) if in_beam else None
        moved_images = None if moved is None else formula_images(scorer.tissues, moved.pairs, spec, moved.before)
        recipe = {"space": spec.space, "maps": formula_maps(spec), "version": FORMULA_VERSION}
        found.append(Baseline(FORMULA, images, moved_images, beam_images, recipe))
    return tuple(found)


def resimulation_images(pairs: Pairs, space: Space = Space.image) -> ImageSource:
    """The re-simulated frames; an odd noise draw gives the target, which has other scatterers and paths again."""
    return lambda frames, draw: pairs.read("target" if draw % 2 else "resimulation", frames, space)


def formula_images(
    tissues: tuple[Tissue, ...],
    pairs: Pairs,
    spec: GeneratorSpec,
    noise_of: np.ndarray | None = None,
    space: Space = Space.image,
) -> Callable[..., np.ndarray]:
    """The frames as the formula renders them from the maps that a network of `spec` reads.

    What is returned is called as that of `training.generated_images`.

    Parameters
    ----------
    tissues : tuple of Tissue
        Behind the labels 1, 2, ...
    pairs : Pairs
        Simulated frames, which may be those after motions.
    spec : GeneratorSpec
        See `baselines`.
    noise_of : (frames,) int, optional
        For each frame the number whose noise it has, in place of its own.
    space : Space
        Of the frames that are returned.
    """
    from ablate.ultrasound.formula import Formula

    assert pairs.probe is not None
    assert pairs.simulator is not None
    formula = Formula(tissues, pairs.probe, pairs.simulator)
    names = formula_maps(spec)

    def render(frames: np.ndarray, draw: int, given: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
        seeds = noise_seeds(frames if noise_of is None else noise_of[frames], draw)
        maps = given or {name: pairs.read(name, frames, Space.beam) for name in names}
        rendered = [
            formula(formula.insonified({name: values[index] for name, values in maps.items()}), int(seed))
            for index, seed in enumerate(seeds)
        ]
        frames_in_beam = np.stack(rendered)
        return frames_in_beam if space is Space.beam else pairs.converter.to_image(frames_in_beam)

    return render


def formula_maps(spec: GeneratorSpec) -> tuple[str, ...]:
    """The maps that the formula reads in place of a network."""
    names = ["segmentation", "illumination" if spec.attenuation is Attenuation.illumination else "attenuation"]
    names += ["interfaces"] if spec.interfaces is Interfaces.echo else []
    names += [GRAIN] if spec.noise is Noise.body else []
    return tuple(names)


def baseline_scores(scorer: Scorer, baseline: Baseline, part: Part) -> Scores:
    """The scores of a baseline, which are the same for every run on a data set.

    The first of several jobs computes that of a metric and stores it beside the data set, and the others wait. A user's
    own metric is computed each time, because the function may change under its name.
    """
    scorer = replace(scorer, settings=replace(scorer.settings, noise_draws=_DRAWS))
    package = {name: metric for name, metric in scorer.metrics.items() if name in METRICS}
    user_metrics = {name: metric for name, metric in scorer.metrics.items() if name not in METRICS}
    scores = _kept_scores(replace(scorer, metrics=package), baseline, part)
    if user_metrics:
        scored = _score(replace(scorer, metrics=user_metrics), baseline, part)
        scores |= {name: scored.of_metric(name) for name in user_metrics}
    return joined([scores[name] for name in scorer.metrics])


def _score(scorer: Scorer, baseline: Baseline, part: Part) -> Scores:
    return scorer.score(
        part,
        baseline.images,
        draws_noise=True,
        moved_images=baseline.moved_images,
        beam_images=baseline.beam_images,
    )


def _kept_scores(scorer: Scorer, baseline: Baseline, part: Part) -> dict[str, Scores]:
    """Those of each metric from its file beside the data set; files that are missing or damaged are made."""
    folder = scorer.pairs.folder / BASELINES_FOLDER
    folder.mkdir(exist_ok=True)
    files = {name: folder / _file_name(scorer, baseline, part, metric) for name, metric in scorer.metrics.items()}
    with held(folder / f"{baseline.name}-{part.name}.lock", f"scores {baseline.name} on the {part.name} frames"):
        kept = {name: _read_kept(file) for name, file in files.items()}
        found = {name: scores for name, scores in kept.items() if scores is not None}
        lacking = {name: metric for name, metric in scorer.metrics.items() if name not in found}
        if lacking:
            scored = _score(replace(scorer, metrics=lacking), baseline, part)
            for name in lacking:
                found[name] = scored.of_metric(name)
                _write_kept(files[name], found[name])
    return found


def _file_name(scorer: Scorer, baseline: Baseline, part: Part, metric: Metric) -> str:
    """The names of all three, and a digest of what else decides the scores."""
    with_inception = metric.uses(FeatureKind.inception) and scorer.inception is not None
    decides = {"version": METRICS_VERSION, "inception": with_inception, "recipe": dict(baseline.recipe)}
    return f"{baseline.name}-{part.name}-{metric.name}-{digest(decides)}.json"


def _read_kept(file: Path) -> Scores | None:
    content = known_json(file)
    if not content:
        return None
    return Scores(pd.DataFrame(content["per_image"]), content["scalars"], content["missing"])


def _write_kept(file: Path, scores: Scores) -> None:
    per_image = scores.per_image.to_dict("list")
    write_json(file, {"per_image": per_image, "scalars": scores.scalars, "missing": scores.missing})
