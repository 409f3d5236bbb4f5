"""The data set behind a study: where it lies, how it is made, what a job reads of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ablate.anatomy import (
    ANATOMY_VERSION,
    Scene,
    SiteGrid,
    Tissue,
    fetal_abdomen,
    fetal_sites,
    load_scene,
    load_sites,
    validate_scene_folder,
)
from ablate.config import SceneKind, StudySettings, build, plain
from ablate.dataset import (
    PAIRS_VERSION,
    Pairs,
    Recipe,
    create_pairs,
    open_pairs,
    remove_damaged,
    simulate_pairs,
    write_contact_sheet,
)
from ablate.networks import GeneratorSpec, conditions
from ablate.studies.imported import about_imported, checked_folder, import_data
from ablate.studies.layout import lay_out
from ablate.ultrasound import SIMULATOR_VERSION, fan_mask
from ablate.ultrasound.plan import compile_scene

_INCIDENTAL_SIMULATOR = ("device", "plan")


@dataclass(frozen=True)
class Data:
    """A data set on disk, the tissues behind its labels and what its plan left out; no scene is loaded for it."""

    pairs: Pairs
    tissues: tuple[Tissue, ...]
    left_out: tuple[str, ...]


def maps_needed(models: Iterable[GeneratorSpec]) -> frozenset[str]:
    """Arrays that a study reads: L only where a variant does; A always, the mechanism metrics need it."""
    read = {name for spec in models for name in conditions(spec)}
    return frozenset(read | {"segmentation", "attenuation", "high", "high_again"})


def dataset_hash(settings: StudySettings) -> str:
    """Hash over scene, probe, simulator settings and version, sites, split and seed."""
    return hashlib.sha256(json.dumps(about_data(settings), sort_keys=True).encode()).hexdigest()[:16]


def dataset_folder(settings: StudySettings) -> Path:
    return settings.runs / "data" / f"{settings.scene_name}-{dataset_hash(settings)}"


def about_data(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, fit for JSON."""
    if settings.scene.kind is SceneKind.pairs:
        return {**about_imported(settings), "pairs_version": PAIRS_VERSION}
    chosen = plain(settings.dataset)
    return {
        "scene": _scene_identity(settings),
        "probe": plain(settings.probe),
        "simulator": {k: v for k, v in plain(settings.simulator).items() if k not in _INCIDENTAL_SIMULATOR},
        "simulator_version": SIMULATOR_VERSION,
        "pairs_version": PAIRS_VERSION,
        "dataset": {k: v for k, v in chosen.items() if k not in ("workers", "shard")},
    }


def _scene_identity(settings: StudySettings) -> dict[str, Any]:
    scene = settings.scene
    if scene.kind is SceneKind.fetal:
        return {
            "kind": "fetal_abdomen",
            "triangles": scene.triangles,
            "seed": scene.anatomy_seed,
            "version": ANATOMY_VERSION,
        }
    folder = Path(scene.folder or "")
    digest = hashlib.sha256()
    for path in (folder / "scene.yaml", *(mesh for mesh, _ in validate_scene_folder(folder).meshes)):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return {"kind": "folder", "files": digest.hexdigest(), "version": ANATOMY_VERSION}


def build_scene(settings: StudySettings) -> tuple[Scene, SiteGrid]:
    """The scene and its own grid of probe sites.

    Raises
    ------
    ValueError
        When the settings name pairs made elsewhere, or a mesh cannot be used.
    """
    scene = settings.scene
    if scene.kind is SceneKind.pairs:
        raise ValueError("scene=pairs: pairs made elsewhere have no scene; allowed are scene=fetal and scene=folder")
    if scene.kind is SceneKind.fetal:
        kept = settings.runs / "data" / "anatomy"
        return fetal_abdomen(triangles=scene.triangles, seed=scene.anatomy_seed, cache_dir=kept), fetal_sites()
    folder = Path(scene.folder or "")
    return load_scene(folder), load_sites(folder)


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
        pairs = _simulate(settings, folder, maps)
    _show(pairs)
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


def _simulate(settings: StudySettings, folder: Path, maps: frozenset[str]) -> Pairs:
    scene, grid = build_scene(settings)
    layout = lay_out(settings, scene, grid)
    left_out = compile_scene(scene, settings.probe, settings.simulator, layout.poses).left_out
    tqdm.write(f"Simulating pairs into {folder}")
    tqdm.write(f"{layout.placement}; {len(layout)} of {settings.dataset.frames} frames asked for")
    for line in left_out:
        tqdm.write(f"left out: {line}")
    pairs = create_pairs(
        folder,
        layout.poses,
        layout.sites,
        layout.split,
        fan_mask(settings.probe, settings.simulator.image_shape),
        settings.dataset.shard,
        [t.name for t in scene.tissues],
        {
            **about_data(settings),
            "tissues": [plain(t) for t in scene.tissues],
            "left_out": left_out,
            "poses": {"usable": len(layout.placement.poses), "dropped": layout.placement.dropped},
        },
    )
    recipe = Recipe(scene, settings.probe, settings.simulator, settings.dataset.seed)
    todo = sum(len(pairs.frames_of_shard(s)) for s in pairs.missing(maps))
    with tqdm(total=todo, unit="frame", desc="simulate", mininterval=1.0) as bar:
        simulate_pairs(recipe, pairs, maps, settings.dataset.workers, bar.update)
    return pairs


def _show(pairs: Pairs) -> None:
    """The picture of a data set, where it is not there yet."""
    picture = pairs.folder / "contact_sheet.png"
    if not picture.exists():
        write_contact_sheet(pairs, picture)


def open_data(folder: Path) -> Data:
    """A data set as it lies on disk.

    Raises
    ------
    FileNotFoundError
        When it has not been simulated.
    """
    pairs = open_pairs(folder)
    about = json.loads((folder / "about.json").read_text())
    return Data(pairs, tuple(build(Tissue, t) for t in about["tissues"]), tuple(about["left_out"]))
