"""`scene=pairs`: pairs made elsewhere, as PNGs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np
from tqdm import tqdm

from ablate import dataset
from ablate.anatomy import ANATOMY_VERSION, Tissue
from ablate.dataset import Part, PngFolder, SplitBy
from ablate.dataset.png_tables import odd_lengths
from ablate.evaluation import describes_fan
from ablate.metrics import speckle_features
from ablate.networks import Attenuation, GeneratorSpec, Position, Space, conditions
from ablate.networks.spec import COMPOUND, GRAIN, OF_POSITION, OF_SURFACES
from ablate.setting import plain
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.sources.data_set import PAIRS_RECIPE, training_frames
from ablate.ultrasound import fan_mask

_DRAWN = ("split", "validation", "test", "seed")  # settings that draw the parts where frames.csv names none
_OTHER_FAN = 0.005  # share of the fan's pixels that fan.yaml and the images may differ in without a note


class PairFolder:
    """The folder of PNGs that `scene.folder` names."""

    has_scene: ClassVar[bool] = False

    def __init__(self, settings: StudySettings) -> None:
        self.settings = settings

    def checked(self) -> PngFolder:
        """The folder, once it fits together.

        It is refused as `validate_png_folder` does, and with a ValueError when a split by site would cut a site in two.
        """
        settings = self.settings
        if not settings.scene.folder:
            raise ValueError("scene=pairs needs scene.folder=path/to/folder")
        checked = dataset.validate_png_folder(Path(settings.scene.folder))
        if checked.parts is not None and settings.dataset.split is SplitBy.site:
            part_of: dict[str, int] = {}
            for site, part in zip(checked.sites, checked.parts, strict=True):
                if part_of.setdefault(site, part) != part:
                    table = checked.folder / "frames.csv"
                    raise ValueError(f"{table}: site '{site}' is in two parts; allowed with dataset.split=frame")
        return checked

    def identity(self) -> dict[str, Any]:
        """See `Source.identity`."""
        checked = self.checked()
        scene: dict[str, Any] = {"kind": "pairs", "files": dataset.content_digest(checked)}
        if checked.tissues:  # networks read values of the tissue table
            scene["version"] = ANATOMY_VERSION
        drawn = plain(self.settings.dataset) if checked.parts is None else {}
        return {
            "scene": scene,
            "probe": plain(checked.probe or self.settings.probe),  # it tells depths
            "dataset": {name: value for name, value in drawn.items() if name in _DRAWN},
            **PAIRS_RECIPE,
        }

    def check(self, label: str) -> int:
        """See `Source.check`; every map that the variant reads must be there."""
        if target := self.settings.scene.target:
            only = "pairs made elsewhere are not simulated; allowed with scene=fetal and scene=folder"
            raise ConfigurationError(f"scene.target={target}: {only}")
        with refusing():
            checked = self.checked()
        _check_reads(self.settings.model, label, checked)
        if checked.parts is not None:
            return int((checked.parts == Part.train).sum())
        return training_frames(self.settings, len(checked.names))

    def offered(self, maps: frozenset[str]) -> frozenset[str]:
        """Those that have a folder."""
        return maps & self.checked().maps

    def scene(self) -> NoReturn:
        """There is none: a ValueError."""
        raise ValueError("scene=pairs: pairs made elsewhere have no scene; allowed are scene=fetal and scene=folder")

    def planes(self) -> Mapping[str, np.ndarray]:
        """None."""
        return {}

    def fill(self, folder: Path, maps: frozenset[str], recipe: Mapping[str, object]) -> None:
        """See `Source.fill`; errors name the file that is wrong."""
        checked = self.checked()
        tqdm.write(f"Importing {len(checked.names)} pairs from {checked.folder} into {folder}")
        mask, labels = dataset.read_fan(checked)
        if checked.probe and not describes_fan(checked.probe, mask):
            first = checked.files["segmentation"][checked.names[0]]
            fan = checked.folder / "fan.yaml"
            raise ValueError(f"{fan}: its fan is not that of the images, the pixels that are not 0 in {first}")
        speckle_features(np.zeros((1, *mask.shape), np.uint8), mask)  # raises where the fan is too small for metrics
        numbers = {site: number for number, site in enumerate(dict.fromkeys(checked.sites))}
        sites = np.array([numbers[site] for site in checked.sites])
        chosen, split = self.settings.dataset, checked.parts
        if split is None:
            split = dataset.split_frames(sites, chosen.split, chosen.validation, chosen.test, chosen.seed)
        order = np.argsort(split, kind="stable")
        tissues = checked.tissues or tuple(Tissue(f"label_{label}") for label in range(1, labels + 1))
        left_out = self._left_out(checked, mask)
        if twice := _in_two_parts(dataset.picture_digests(checked, mask), split, checked.names):
            left_out.append(f"nothing, but {twice}")
        tqdm.write(f"{len(numbers)} sites")
        for line in left_out:
            tqdm.write(f"left out: {line}")
        names = [checked.names[i] for i in order]
        about = {
            **recipe,
            "tissues": [plain(tissue) for tissue in tissues],
            "left_out": left_out,
            "frames": [{"name": checked.names[i], "site": checked.sites[i]} for i in order],
        }
        poses = np.full((len(names), 4, 4), np.nan)  # where the probe was is not known
        frames = dataset.PlacedFrames(poses, sites[order], split[order], mask)
        tissue_names = [tissue.name for tissue in tissues]
        stored_as = dataset.StoredAs(chosen.shard, tissue_names, Space.image, checked.probe, checked.beam_shape)
        pairs = dataset.create_pairs(folder, frames, stored_as, about)
        dataset.import_pairs(checked, names, pairs, maps)

    def _left_out(self, checked: PngFolder, mask: np.ndarray) -> list[str]:
        """What a study of these pairs has to do without, and why."""
        probe = self.settings.probe
        left_out = ["re-simulation: pairs made elsewhere cannot be simulated again, so metrics have no floor"]
        if "attenuation" not in checked.maps:
            left_out.append("shadow_contrast and variants that read A: there is no folder attenuation")
        if not checked.probe and describes_fan(probe, mask):
            left_out.append("fan.yaml: there is none, so depths and sizes in mm are those of probe.* of the settings")
        elif not checked.probe:
            named = ", ".join(f"{k}={v:g}" for k, v in asdict(probe).items() if k != "frequency_mhz")
            left_out.append(
                f"shadow_contrast and thin_contrast: the fan of the images is not that of probe.{named}, so depths are "
                "not known and the Gaussian of mae_smooth is in px"
            )
        rests = {name.removeprefix(site) for name, site in zip(checked.names, checked.sites, strict=True)}
        if len(rests) == 1 and not (checked.folder / "frames.csv").exists():
            alone = "each frame has its own; those alike may lie in training and in test"
            left_out.append(f"sites: none are named, so {alone}")
        left_out.append(f"dataset.frames: all {len(checked.names)} pairs of the folder are used")
        if checked.parts is not None:
            left_out.append("dataset.validation, test and seed: frames.csv says in which part each frame is")
        if checked.tissues is None:
            by_number = "the labels are ordered by number, and all count as solid tissue"
            left_out.append(f"tissues: without labels.csv {by_number}")
        if checked.probe and (odd := odd_lengths(checked.probe)):
            units = "all sizes follow it, so it must be in mm and degrees, not in cm"
            left_out.append(f"nothing, but fan.yaml has {odd}; {units}")
        if checked.probe:
            described = fan_mask(checked.probe, (mask.shape[0], mask.shape[1]))
            unlike = float((described ^ mask).sum() / mask.sum())
            if unlike > _OTHER_FAN:
                differ = f"fan.yaml and the images differ in {unlike:.1%} of the fan"
                left_out.append(f"nothing, but {differ}: beam space is less exact")
        return left_out


def _in_two_parts(digests: list[bytes], split: np.ndarray, names: tuple[str, ...]) -> str:
    """Which frames of validation and test are pictures of another part, pixel by pixel; empty where none is."""
    found = []
    earlier: dict[bytes, int] = {}
    for part in (Part.train, Part.validation, Part.test):
        part_frames = np.flatnonzero(split == part)
        same = [int(i) for i in part_frames if digests[i] in earlier]
        if same:
            example = f"{names[same[0]]} is {names[earlier[digests[same[0]]]]}"
            found.append(f"{len(same)} of {len(part_frames)} {part.name} frames, the first of which {example}")
        for i in part_frames:
            earlier.setdefault(digests[i], int(i))
    where = ", and ".join(found)
    return where and f"the same pictures are in two parts: {where}; scores tell nothing new about them"


def _check_reads(spec: GeneratorSpec, label: str, checked: PngFolder) -> None:
    """Refuse a variant that reads what the folder does not have."""
    if spec.attenuation is Attenuation.compensated:
        raise ConfigurationError(
            f"model.attenuation=compensated in variant {label}: pairs made elsewhere do not tell the time gain of "
            "their images; allowed are integral and none"
        )
    without_fan = {} if checked.probe else {"space": Space.image, "position": Position.none}
    for key, allowed in without_fan.items():
        value = getattr(spec, key)
        if value != allowed:
            raise ConfigurationError(
                f"model.{key}={value} in variant {label}: needs {checked.folder / 'fan.yaml'}, the geometry of the "
                f"fan; allowed without it is {allowed}"
            )
    if GRAIN in conditions(spec):
        raise ConfigurationError(
            f"model.noise=body in variant {label}: only a simulator knows where the scatterers lie; for pairs made "
            "elsewhere allowed are inject, input and none"
        )
    readable = checked.maps | OF_POSITION
    for name in conditions(spec):
        if name in OF_SURFACES | {COMPOUND}:
            setting = "interfaces=echo" if name == "interfaces" else f"attenuation={name}"
            others = "none" if name == "interfaces" else "integral and none"
            why = "only a simulator makes this map; for pairs made elsewhere allowed are"
            raise ConfigurationError(f"model.{setting} in variant {label}: {why} {others}")
        if name not in readable:
            raise ConfigurationError(
                f"variant {label} reads {name}, but {checked.folder} has no folder {name}; "
                f"allowed are variants that read {', '.join(sorted(checked.maps - {'target'}))} alone"
            )


SOURCE = PairFolder
