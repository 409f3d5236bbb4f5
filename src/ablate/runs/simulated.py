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
from ablate.dataset import Dropped, Part, Placement, Recipe
from ablate.networks import Space
from ablate.setting import identity, plain
from ablate.settings.study import SceneKind, StudySettings
from ablate.storage import digest_of_files
from ablate.ultrasound import SIMULATOR_VERSION, fan_mask, with_patient_gain
from ablate.ultrasound.media import plan_scene


def about_simulated(settings: StudySettings) -> dict[str, Any]:
    """What every pair of the data set is made from, JSON-ready."""
    chosen = identity(settings.dataset)
    if settings.dataset.poses:  # what they are counts, not where they lie; no grid is placed
        poses, sites = dataset.read_poses(Path(settings.dataset.poses))
        del chosen["grid"], chosen["press_mm"]
        chosen["poses"] = hashlib.sha256(poses.tobytes() + sites.tobytes()).hexdigest()[:16]
    scene: dict[str, Any] = {"kind": settings.scene.kind.name, "version": ANATOMY_VERSION}
    if settings.scene.kind is SceneKind.fetal:
        scene |= {"triangles": settings.scene.triangles, "anatomy_seed": settings.scene.anatomy_seed}
    else:
        folder = Path(settings.scene.folder or "")
        checked = anatomy.validate_scene_folder(folder)
        scene["files"] = digest_of_files([folder / "scene.yaml", *checked.files])
        if checked.labels:
            scene["labels_version"] = LABELS_VERSION
    simulator = {"simulator": identity(settings.simulator), "simulator_version": SIMULATOR_VERSION}
    return {"scene": scene, "probe": plain(settings.probe), **simulator, "dataset": chosen}


def build_scene(settings: StudySettings) -> tuple[Scene, SiteGrid]:
    """The scene and its own grid of probe sites; a ValueError for pairs made elsewhere, or a mesh that is unusable."""
    scene, kept = settings.scene, settings.results / "data" / "anatomy"
    if scene.kind is SceneKind.pairs:
        raise ValueError("scene=pairs: pairs made elsewhere have no scene; allowed are scene=fetal and scene=folder")
    if scene.kind is SceneKind.fetal:
        return anatomy.fetal_abdomen(scene.triangles, scene.anatomy_seed, cache_dir=kept), anatomy.fetal_sites()
    folder = Path(scene.folder or "")
    loaded = anatomy.load_scene(folder, kept)
    if settings.dataset.poses or settings.pose:  # then the folder may do without sites
        return loaded, anatomy.validate_scene_folder(folder).sites or SiteGrid()
    return loaded, anatomy.load_sites(folder)


@dataclass(frozen=True)
class Layout:
    """The frames of a data set before any is simulated."""

    poses: np.ndarray  # (n, 4, 4) float64, probe to world, mm
    sites: np.ndarray  # (n,) int64
    split: np.ndarray  # (n,) uint8 of `Part`
    placement: Placement  # what the frames were chosen from, and what was dropped


def lay_out(settings: StudySettings, scene: Scene, grid: SiteGrid) -> Layout:
    """Place the probe, choose the frames and split them; where fewer poses can be used than asked for, all of them.

    No usable pose, or too few sites to be split, is a ValueError.
    """
    chosen = settings.dataset
    if chosen.poses:
        placement = Placement(*dataset.read_poses(Path(chosen.poses)), dict.fromkeys(Dropped, 0))
    else:
        resampled = dataset.resample_grid(grid, chosen.grid)
        placement = dataset.place_probe(scene, resampled, chosen.press_mm, settings.probe)
    picked = dataset.choose_frames(placement.sites, chosen.frames, chosen.seed)
    sites = placement.sites[picked]
    split = dataset.split_frames(sites, chosen.split, chosen.validation, chosen.test, chosen.seed)
    order = np.argsort(split, kind="stable")  # validation and test frames lie together: few shards hold both
    return Layout(placement.poses[picked[order]], sites[order], split[order], placement)


def training_poses(settings: StudySettings, scene: Scene, grid: SiteGrid, poses: np.ndarray) -> np.ndarray:
    """Poses, (n, 4, 4), that an anatomy's time gain is set for; where a folder has no probe sites, those given."""
    if grid == SiteGrid() and not settings.dataset.poses:
        return poses
    layout = lay_out(settings, scene, grid)
    return layout.poses[layout.split == Part.train]


def simulate_data(settings: StudySettings, folder: Path, maps: frozenset[str], about: Mapping[str, object]) -> None:
    """Make the data set in `folder`, or what is missing of it; `about` is kept beside it."""
    scene, grid = build_scene(settings)
    layout = lay_out(settings, scene, grid)
    training = layout.poses[layout.split == Part.train]
    simulator = with_patient_gain(scene, settings.probe, settings.simulator, training)
    left_out = plan_scene(scene, settings.probe, simulator, layout.poses).left_out
    if (lacking := settings.dataset.frames - len(layout.poses)) and not settings.dataset.poses:
        left_out = (*left_out, f"{lacking} of {settings.dataset.frames} frames asked for: there are no more poses")
    tqdm.write(f"Simulating pairs into {folder}")
    tqdm.write(f"{layout.placement}; {len(layout.sites)} of {settings.dataset.frames} frames asked for")
    for line in left_out:
        tqdm.write(f"left out: {line}")
    poses = {"usable": len(layout.placement.poses), "dropped": layout.placement.dropped}
    about = {**about, "tissues": [plain(t) for t in scene.tissues], "left_out": left_out, "poses": poses}
    about |= {"time_gain_db": simulator.time_gain_db}
    mask = fan_mask(settings.probe, settings.simulator.image_shape)
    frames = dataset.PlacedFrames(layout.poses, layout.sites, layout.split, mask)
    names = [tissue.name for tissue in scene.tissues]
    stored_as = dataset.StoredAs(settings.dataset.shard, names, Space.beam, settings.probe, simulator.beam_shape)
    pairs = dataset.create_pairs(folder, frames, stored_as, about)
    recipe = Recipe(scene, settings.probe, simulator, settings.dataset.seed)
    dataset.simulate_pairs(recipe, pairs, maps, settings.dataset.workers)
