"""Pairs simulated from a scene as the data set of a study: its hash, its frames, and how they are made."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ablate import anatomy, dataset
from ablate.anatomy import ANATOMY_VERSION, LABELS_VERSION, Scene, SiteGrid
from ablate.config import SceneKind, StudySettings, json_ready
from ablate.dataset import Pairs, Placement, Recipe
from ablate.ultrasound import SIMULATOR_VERSION, fan_mask
from ablate.ultrasound.render_plan import plan_scene

_INCIDENTAL_SIMULATOR = ("device", "plan")


def about_simulated(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, JSON-ready."""
    chosen = json_ready(settings.dataset)
    return {
        "scene": _scene_identity(settings),
        "probe": json_ready(settings.probe),
        "simulator": {k: v for k, v in json_ready(settings.simulator).items() if k not in _INCIDENTAL_SIMULATOR},
        "simulator_version": SIMULATOR_VERSION,
        "dataset": {k: v for k, v in chosen.items() if k not in ("workers", "shard")},
    }


def _scene_identity(settings: StudySettings) -> dict[str, Any]:
    scene = settings.scene
    if scene.kind is SceneKind.fetal:
        shaped_by = {"triangles": scene.triangles, "seed": scene.anatomy_seed}
        return {"kind": "fetal_abdomen", **shaped_by, "version": ANATOMY_VERSION}
    folder = Path(scene.folder or "")
    files = hashlib.sha256()
    checked = anatomy.validate_scene_folder(folder)
    for path in (folder / "scene.yaml", *checked.files):
        with path.open("rb") as file:
            files.update(hashlib.file_digest(file, "sha256").digest())
    identity = {"kind": "folder", "files": files.hexdigest(), "version": ANATOMY_VERSION}
    return {**identity, "labels_version": LABELS_VERSION} if checked.labels else identity


def build_scene(settings: StudySettings) -> tuple[Scene, SiteGrid]:
    """The scene and its own grid of probe sites; a ValueError for pairs made elsewhere, or a mesh that is unusable."""
    scene = settings.scene
    if scene.kind is SceneKind.pairs:
        raise ValueError("scene=pairs: pairs made elsewhere have no scene; allowed are scene=fetal and scene=folder")
    if scene.kind is SceneKind.fetal:
        kept = settings.runs / "data" / "anatomy"
        made = anatomy.fetal_abdomen(triangles=scene.triangles, seed=scene.anatomy_seed, cache_dir=kept)
        return made, anatomy.fetal_sites()
    folder = Path(scene.folder or "")
    return anatomy.load_scene(folder, settings.runs / "data" / "anatomy"), anatomy.load_sites(folder)


@dataclass(frozen=True)
class Layout:
    """The frames of a data set before any is simulated."""

    poses: np.ndarray  # (n, 4, 4) float64, probe to world, mm
    sites: np.ndarray  # (n,) int64
    split: np.ndarray  # (n,) uint8 of `Part`
    placement: Placement  # what the frames were chosen from, and what was dropped

    def __len__(self) -> int:
        return len(self.sites)


def lay_out(settings: StudySettings, scene: Scene, grid: SiteGrid) -> Layout:
    """Place the probe, choose the frames and split them; where fewer poses can be used than asked for, all of them.

    No usable pose, or too few sites to be split, is a ValueError.
    """
    chosen = settings.dataset
    placement = dataset.place_probe(scene, dataset.resample_grid(grid, chosen.grid), chosen.press_mm, settings.probe)
    poses = placement.poses
    picked = dataset.choose_frames([p.site for p in poses], min(chosen.frames, len(poses)), chosen.seed)
    sites = np.array([poses[i].site for i in picked])
    split = dataset.split_frames(sites, chosen.split, chosen.validation, chosen.test, chosen.seed)
    order = np.argsort(split, kind="stable")  # validation and test frames lie together: few shards hold both
    return Layout(np.stack([poses[picked[i]].probe_to_world for i in order]), sites[order], split[order], placement)


def simulate_data(settings: StudySettings, folder: Path, maps: frozenset[str], about: Mapping[str, object]) -> Pairs:
    """Make the data set in `folder`, or what is missing of it; `about` is kept beside it."""
    scene, grid = build_scene(settings)
    layout = lay_out(settings, scene, grid)
    left_out = plan_scene(scene, settings.probe, settings.simulator, layout.poses).left_out
    tqdm.write(f"Simulating pairs into {folder}")
    tqdm.write(f"{layout.placement}; {len(layout)} of {settings.dataset.frames} frames asked for")
    for line in left_out:
        tqdm.write(f"left out: {line}")
    pairs = dataset.create_pairs(
        folder,
        layout.poses,
        layout.sites,
        layout.split,
        fan_mask(settings.probe, settings.simulator.image_shape),
        settings.dataset.shard,
        [t.name for t in scene.tissues],
        {
            **about,
            "tissues": [json_ready(t) for t in scene.tissues],
            "left_out": left_out,
            "poses": {"usable": len(layout.placement.poses), "dropped": layout.placement.dropped},
        },
    )
    recipe = Recipe(scene, settings.probe, settings.simulator, settings.dataset.seed)
    todo = sum(len(pairs.frames_of_shard(s)) for s in pairs.missing(maps))
    with tqdm(total=todo, unit="frame", desc="simulate", mininterval=1.0) as bar:
        dataset.simulate_pairs(recipe, pairs, maps, settings.dataset.workers, bar.update)
    return pairs
