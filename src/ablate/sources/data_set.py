"""One data set on disk: its pairs, what it was made from, and the digest of its pixels."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from ablate.anatomy import Tissue
from ablate.dataset import DERIVED, PAIRS_VERSION, Pairs, Part, open_pairs
from ablate.dataset.motion import MOVED_FOLDER, Motion, Moved
from ablate.evaluation.settings import BASELINES_FOLDER
from ablate.networks import GeneratorSpec, conditions
from ablate.networks.spec import NOT_STORED
from ablate.settings.conf import build
from ablate.settings.study import StudySettings
from ablate.storage import known_json, read_json, write_json
from ablate.ultrasound.settings import SimulatorSettings, Sliders

#: What every recipe has beside what its source says.
PAIRS_RECIPE = {"pairs_version": PAIRS_VERSION}

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
        """Its frames, with what they were simulated with."""
        return self._simulated(open_pairs(self.folder))

    @cached_property
    def moved(self) -> Moved | None:
        """Some test frames after motions of the probe; None where there are none, as of pairs made elsewhere."""
        if not (self.folder / MOVED_FOLDER / "about.json").exists():
            return None
        pairs = self._simulated(open_pairs(self.folder / MOVED_FOLDER))
        motions = tuple(Motion(motion) for motion in self.about["motions"])
        return Moved(pairs, np.array(self.about["moved"]), motions)

    def _simulated(self, pairs: Pairs) -> Pairs:
        """Pairs with what they were simulated with, if they were."""
        if self.about.get("simulator") is None:
            return pairs
        simulator = build(SimulatorSettings, self.about["simulator"], stored=True)
        simulator = replace(simulator, time_gain_db=self.time_gain_db)
        return replace(pairs, simulator=simulator, seed=self.about["dataset"]["seed"])

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

    @property
    def known_pixels(self) -> str:
        """`pixels` where they have been computed; otherwise empty."""
        return str(known_json(self.kept_digest).get("test_frames", ""))

    def forget_digests(self) -> None:
        """Forget what was computed from frames that are about to be made again."""
        for computed in (self.kept_digest, *(self.folder / BASELINES_FOLDER).glob("*.json")):
            computed.unlink(missing_ok=True)

    @property
    def all_pairs(self) -> tuple[Pairs, ...]:
        """Its frames, and those after motions; none where it has not been laid out."""
        if not self.exists:
            return ()
        return (self.pairs,) if self.moved is None else (self.pairs, self.moved.pairs)

    def lacks(self, maps: frozenset[str]) -> bool:
        """Whether pairs of these maps are missing."""
        if not self.exists or (self.moved is None and "motions" in self.about):
            return True
        return any(pairs.missing(maps) for pairs in self.all_pairs)

    @cached_property
    def pixels(self) -> str:
        """First 16 hexadecimal digits of the SHA-256 of the test frames' labels, attenuation, targets, re-simulation.

        The hash in the folder's name is that of the recipe. Two processors round otherwise, so one recipe can give two
        data sets; this digest tells them apart. It is computed once and kept beside the pairs.
        """
        if self.known_pixels:
            return self.known_pixels
        total = hashlib.sha256()
        stored = [name for name in _DIGESTED if name in self.pairs.maps]
        for frame in self.pairs.frames(Part.test):
            for name in stored:
                total.update(self.pairs.stored(name, int(frame), self.pairs.space).tobytes())
        digest = total.hexdigest()[:16]
        write_json(self.kept_digest, {"test_frames": digest})
        return digest


def maps_needed(models: Iterable[GeneratorSpec]) -> frozenset[str]:
    """Arrays that a study reads: L only where a variant does; A always, the mechanism metrics need it."""
    read = {DERIVED.get(name, name) for spec in models for name in conditions(spec)} - NOT_STORED
    return frozenset(read | {"segmentation", "attenuation", "target", "resimulation"})


def training_frames(settings: StudySettings, frames: int) -> int:
    """How many of so many frames train, where shares draw the parts."""
    return round(frames * (1 - settings.dataset.validation - settings.dataset.test))
