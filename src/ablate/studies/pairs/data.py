"""The data set behind a study: where it lies, how it is made, what a job reads of it.

What needs a scene, and with it Embree and numba, is imported where a scene is used.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ablate.anatomy import Tissue
from ablate.config import SceneKind, StudySettings, build
from ablate.dataset import DERIVED, PAIRS_VERSION, Pairs, open_pairs, remove_damaged, write_contact_sheet
from ablate.networks import GeneratorSpec, conditions
from ablate.storage import digest, read_json
from ablate.studies.pairs.imported import about_imported, checked_folder, import_data
from ablate.ultrasound.probe_kinds import probe_from


@dataclass(frozen=True)
class Data:
    """A data set on disk, the tissues behind its labels and what its plan left out; no scene is loaded for it."""

    pairs: Pairs
    tissues: tuple[Tissue, ...]
    left_out: tuple[str, ...]


def maps_needed(models: Iterable[GeneratorSpec]) -> frozenset[str]:
    """Arrays that a study reads: L only where a variant does; A always, the mechanism metrics need it."""
    read = {DERIVED.get(name, name) for spec in models for name in conditions(spec)}
    return frozenset(read | {"segmentation", "attenuation", "target", "resimulation"})


def dataset_hash(settings: StudySettings) -> str:
    """Hash over scene, probe, simulator settings and version, sites, split and seed."""
    return digest(about_data(settings))


def dataset_folder(settings: StudySettings) -> Path:
    return settings.results / "data" / f"{settings.scene_name}-{dataset_hash(settings)}"


def about_data(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, JSON-ready."""
    if settings.scene.kind is SceneKind.pairs:
        about = about_imported(settings)
    else:
        from ablate.studies.pairs.simulated import about_simulated

        about = about_simulated(settings)
    return {**about, "pairs_version": PAIRS_VERSION}


def drop_damaged(settings: StudySettings, maps: frozenset[str]) -> tuple[str, ...]:
    """Compare what is on disk of the study's pairs with its checksums; what is damaged is removed and named."""
    folder = dataset_folder(settings)
    if not (folder / "about.json").exists():
        return ()
    with tqdm(unit="shard", desc="check", mininterval=1.0, leave=False) as bar:
        return remove_damaged(open_pairs(folder), maps, bar.update)


def prepare_data(settings: StudySettings, maps: frozenset[str]) -> Data:
    """Simulate, or import, what is missing of the study's pairs; returns at once when nothing is."""
    folder = dataset_folder(settings)
    if made := made_data(settings, maps):
        pairs = made.pairs
    elif settings.scene.kind is SceneKind.pairs:
        pairs = import_data(settings, folder, maps & checked_folder(settings).maps)
    else:
        from ablate.studies.pairs.simulated import simulate_data

        pairs = simulate_data(settings, folder, maps, about_data(settings))
    if not (picture := folder / "contact_sheet.png").exists():
        write_contact_sheet(pairs, picture)
    return open_data(folder)


def made_data(settings: StudySettings, maps: frozenset[str]) -> Data | None:
    """The study's pairs, or None where something is missing of them."""
    folder = dataset_folder(settings)
    if not (folder / "about.json").exists():
        return None
    if settings.scene.kind is SceneKind.pairs:
        maps &= checked_folder(settings).maps
    data = open_data(folder)
    return None if data.pairs.missing(maps) else data


def open_data(folder: Path) -> Data:
    """A data set as it lies on disk; a FileNotFoundError when it has not been simulated."""
    pairs = open_pairs(folder)
    about = read_json(folder / "about.json")
    if simulator := about.get("simulator"):
        pairs = replace(pairs, probe=probe_from(about["probe"]), tgc_db_cm_mhz=simulator["tgc_db_cm_mhz"])
    return Data(pairs, tuple(build(Tissue, t) for t in about["tissues"]), tuple(about["left_out"]))
