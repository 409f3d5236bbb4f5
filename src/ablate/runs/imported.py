"""Pairs made elsewhere as the data set of a study: what it is known by, and how it is made."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ablate import dataset
from ablate.anatomy import Tissue
from ablate.dataset import PngFolder, SplitBy
from ablate.evaluation import describes_fan
from ablate.metrics import speckle_features
from ablate.setting import plain
from ablate.settings.study import StudySettings


def checked_folder(settings: StudySettings) -> PngFolder:
    """The folder that `scene.folder` names, once it fits together.

    It is refused as `validate_png_folder` does, and with a ValueError when a split by site would cut a site in two.
    """
    if not settings.scene.folder:
        raise ValueError("scene=pairs needs scene.folder=path/to/folder")
    checked = dataset.validate_png_folder(Path(settings.scene.folder))
    if checked.parts is not None and settings.dataset.split is SplitBy.site:
        sides: dict[str, int] = {}
        for site, part in zip(checked.sites, checked.parts, strict=True):
            if sides.setdefault(site, part) != part:
                table = checked.folder / "frames.csv"
                raise ValueError(f"{table}: site '{site}' is in two parts; allowed with dataset.split=frame")
    return checked


def about_imported(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, fit for JSON; the probe tells how deep a pixel lies."""
    chosen = plain(settings.dataset)
    return {
        "scene": {"kind": "pairs", "files": dataset.content_digest(checked_folder(settings))},
        "probe": plain(settings.probe),
        "dataset": {name: chosen[name] for name in ("split", "validation", "test", "seed")},
    }


def import_data(settings: StudySettings, folder: Path, maps: frozenset[str], about: Mapping[str, object]) -> None:
    """Make the data set in `folder`, or what is missing of it, from the PNGs; `about` is kept beside it.

    Errors name the file that is wrong.
    """
    checked = checked_folder(settings)
    tqdm.write(f"Importing {len(checked.names)} pairs from {checked.folder} into {folder}")
    mask, labels = dataset.read_fan(checked)
    speckle_features(np.zeros((1, *mask.shape), np.uint8), mask)  # raises where the fan is too small for metrics
    numbers = {site: number for number, site in enumerate(dict.fromkeys(checked.sites))}
    sites = np.array([numbers[site] for site in checked.sites])
    chosen, split = settings.dataset, checked.parts
    if split is None:
        split = dataset.split_frames(sites, chosen.split, chosen.validation, chosen.test, chosen.seed)
    order = np.argsort(split, kind="stable")
    tissues = checked.tissues or tuple(Tissue(f"label_{label}") for label in range(1, labels + 1))
    left_out = _left_out(settings, checked, mask)
    tqdm.write(f"{len(numbers)} sites")
    for line in left_out:
        tqdm.write(f"left out: {line}")
    names = [checked.names[i] for i in order]
    frames = [{"name": checked.names[i], "site": checked.sites[i]} for i in order]
    about = {**about, "tissues": [plain(tissue) for tissue in tissues], "left_out": left_out, "frames": frames}
    placed = np.full((len(names), 4, 4), np.nan), sites[order], split[order], mask  # where the probe was is not known
    pairs = dataset.create_pairs(folder, *placed, chosen.shard, [tissue.name for tissue in tissues], about)
    dataset.import_pairs(checked, names, pairs, maps)


def _left_out(settings: StudySettings, checked: PngFolder, mask: np.ndarray) -> list[str]:
    """What a study of these pairs has to do without, and why."""
    left_out = ["re-simulation: pairs made elsewhere cannot be simulated again, so metrics have no floor"]
    if "attenuation" not in checked.maps:
        left_out.append("shadow_contrast and variants that read A: there is no folder attenuation")
    elif not describes_fan(settings.probe, mask):
        probe = ", ".join(f"{k}={v:g}" for k, v in asdict(settings.probe).items() if k != "frequency_mhz")
        left_out.append(
            f"shadow_contrast and thin_contrast: the fan of the images is not that of probe.{probe}, so depths are not "
            "known and the Gaussian of mae_smooth is in px"
        )
    if checked.tissues is None:
        left_out.append("tissues: without labels.csv the labels are ordered by number, and all count as solid tissue")
    return left_out
