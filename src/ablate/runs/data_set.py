"""One data set on disk: its pairs, what it was made from, the digest of its pixels, and how it comes to be there."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from tqdm import tqdm

from ablate import dataset
from ablate.anatomy import ANATOMY_VERSION, Tissue
from ablate.dataset import DERIVED, PAIRS_VERSION, Pairs, Part, PngFolder, SplitBy, open_pairs
from ablate.evaluation import describes_fan
from ablate.metrics import speckle_features
from ablate.networks import GeneratorSpec, Space, conditions
from ablate.networks.spec import OF_POSITION
from ablate.setting import plain
from ablate.settings.conf import build
from ablate.settings.study import SceneKind, StudySettings
from ablate.storage import known_json, read_json, write_json
from ablate.ultrasound import fan_mask
from ablate.ultrasound.settings import Sliders

#: The maps that say which data a run was scored on; all of their test frames are read for the digest.
_DIGESTED = ("segmentation", "attenuation", "target", "resimulation")


@dataclass(frozen=True)
class DataSet:
    """The folder of a data set, `data/<scene>-<hash>`; no scene is loaded to read it."""

    folder: Path

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def exists(self) -> bool:
        """Whether it has been laid out; some of its pairs may be missing."""
        return all((self.folder / name).exists() for name in ("about.json", "pairs.zarr"))

    @cached_property
    def about(self) -> dict[str, Any]:
        """What it was made from; a FileNotFoundError where it is not there, a ValueError where it is damaged."""
        return read_json(self.folder / "about.json")

    @cached_property
    def pairs(self) -> Pairs:
        """Its frames, with the time gain that they were simulated with."""
        pairs = open_pairs(self.folder)
        if simulator := self.about.get("simulator"):
            pairs = replace(pairs, tgc=self.time_gain_db or simulator["tgc_db_cm_mhz"])
        return pairs

    @property
    def tissues(self) -> tuple[Tissue, ...]:
        """The tissues behind the labels 1, 2, ..."""
        return tuple(build(Tissue, tissue) for tissue in self.about["tissues"])

    @property
    def time_gain_db(self) -> Sliders | None:
        """The curve of `simulator.time_gain_db` or of `tgc=patient` that its frames have; None where neither is set."""
        curve = self.about.get("time_gain_db")  # not of imported frames
        return None if curve is None else cast(Sliders, tuple(curve))

    @property
    def contact_sheet(self) -> Path:
        return self.folder / "contact_sheet.png"

    @property
    def kept_digest(self) -> Path:
        return self.folder / "pixels.json"

    def lacks(self, maps: frozenset[str]) -> bool:
        """Whether pairs of these maps are missing."""
        return not self.exists or bool(self.pairs.missing(maps))

    @cached_property
    def pixels(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of the test frames' labels, attenuation, targets, re-simulation.

        The hash in the folder's name is that of the recipe. Two processors round otherwise, so one recipe can give two
        data sets; this digest tells them apart. It is computed once and kept beside the pairs.
        """
        if known := known_json(self.kept_digest).get("test_frames"):
            return str(known)
        digest = hashlib.sha256()
        for frame in self.pairs.frames(Part.test):
            for name in (name for name in _DIGESTED if name in self.pairs.maps):
                digest.update(self.pairs.stored(name, int(frame), self.pairs.space).tobytes())
        write_json(self.kept_digest, {"test_frames": digest.hexdigest()[:16]})
        return digest.hexdigest()[:16]


def maps_needed(models: Iterable[GeneratorSpec]) -> frozenset[str]:
    """Arrays that a study reads: L only where a variant does; A always, the mechanism metrics need it."""
    read = {DERIVED.get(name, name) for spec in models for name in conditions(spec)} - OF_POSITION
    return frozenset(read | {"segmentation", "attenuation", "target", "resimulation"})


def about_data(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, as JSON values."""
    if settings.scene.kind is SceneKind.pairs:
        checked = checked_folder(settings)
        scene: dict[str, Any] = {"kind": "pairs", "files": dataset.content_digest(checked)}
        scene |= {"version": ANATOMY_VERSION} if checked.tissues else {}  # whose values networks read
        drawn = ("split", "validation", "test", "seed") if checked.parts is None else ()
        chosen = {name: plain(settings.dataset)[name] for name in drawn}
        probe = checked.probe or settings.probe  # it tells depths
        about = {"scene": scene, "probe": plain(probe), "dataset": chosen}
    else:  # only here: what needs a scene needs Embree and numba
        from ablate.runs.simulated import about_simulated

        about = about_simulated(settings)
    return {**about, "pairs_version": PAIRS_VERSION}


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


def import_data(settings: StudySettings, folder: Path, maps: frozenset[str], about: Mapping[str, object]) -> None:
    """Make the data set in `folder`, or what is missing of it, from the PNGs; `about` is kept beside it.

    Errors name the file that is wrong.
    """
    checked = checked_folder(settings)
    tqdm.write(f"Importing {len(checked.names)} pairs from {checked.folder} into {folder}")
    mask, labels = dataset.read_fan(checked)
    if checked.probe and not describes_fan(checked.probe, mask):
        fan, first = checked.folder / "fan.yaml", checked.files["segmentation"][checked.names[0]]
        raise ValueError(f"{fan}: its fan is not that of the images, the pixels that are not 0 in {first}")
    speckle_features(np.zeros((1, *mask.shape), np.uint8), mask)  # raises where the fan is too small for metrics
    numbers = {site: number for number, site in enumerate(dict.fromkeys(checked.sites))}
    sites = np.array([numbers[site] for site in checked.sites])
    chosen, split = settings.dataset, checked.parts
    if split is None:
        split = dataset.split_frames(sites, chosen.split, chosen.validation, chosen.test, chosen.seed)
    order = np.argsort(split, kind="stable")
    tissues = checked.tissues or tuple(Tissue(f"label_{label}") for label in range(1, labels + 1))
    left_out = _left_out(settings, checked, mask)
    of_probe = fan_mask(checked.probe, (mask.shape[0], mask.shape[1])) if checked.probe else mask
    if (unlike := float((of_probe ^ mask).sum() / mask.sum())) > 0.005:
        left_out.append(
            f"nothing, but fan.yaml and the images differ in {unlike:.1%} of the fan: beam space is less exact"
        )
    tqdm.write(f"{len(numbers)} sites")
    for line in left_out:
        tqdm.write(f"left out: {line}")
    names = [checked.names[i] for i in order]
    frames = [{"name": checked.names[i], "site": checked.sites[i]} for i in order]
    about = {**about, "tissues": [plain(tissue) for tissue in tissues], "left_out": left_out, "frames": frames}
    poses = np.full((len(names), 4, 4), np.nan)  # where the probe was is not known
    placed = dataset.PlacedFrames(poses, sites[order], split[order], mask)
    names_of_tissues = [tissue.name for tissue in tissues]
    stored_as = dataset.StoredAs(chosen.shard, names_of_tissues, Space.image, checked.probe, checked.beam_shape)
    pairs = dataset.create_pairs(folder, placed, stored_as, about)
    dataset.import_pairs(checked, names, pairs, maps)


def _left_out(settings: StudySettings, checked: PngFolder, mask: np.ndarray) -> list[str]:
    """What a study of these pairs has to do without, and why."""
    left_out = ["re-simulation: pairs made elsewhere cannot be simulated again, so metrics have no floor"]
    if "attenuation" not in checked.maps:
        left_out.append("shadow_contrast and variants that read A: there is no folder attenuation")
    if not checked.probe and describes_fan(settings.probe, mask):
        left_out.append("fan.yaml: there is none, so depths and sizes in mm are those of probe.* of the settings")
    elif not checked.probe:
        probe = ", ".join(f"{k}={v:g}" for k, v in asdict(settings.probe).items() if k != "frequency_mhz")
        left_out.append(
            f"shadow_contrast and thin_contrast: the fan of the images is not that of probe.{probe}, so depths are not "
            "known and the Gaussian of mae_smooth is in px"
        )
    same_rest = len({name.removeprefix(site) for name, site in zip(checked.names, checked.sites, strict=True)}) == 1
    if same_rest and not (checked.folder / "frames.csv").exists():
        left_out.append("sites: none are named, so each frame has its own; those alike may lie in training and in test")
    left_out.append(f"dataset.frames: all {len(checked.names)} pairs of the folder are used")
    if checked.parts is not None:
        left_out.append("dataset.validation, test and seed: frames.csv says in which part each frame is")
    if checked.tissues is None:
        left_out.append("tissues: without labels.csv the labels are ordered by number, and all count as solid tissue")
    return left_out
