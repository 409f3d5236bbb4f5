"""Pairs simulated from a scene: what decides them, which frames there are, and how they are made."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ablate import dataset
from ablate.anatomy import Scene, SiteGrid
from ablate.dataset import Dropped, Part, Placement, Recipe
from ablate.dataset.cut_frames import cut_frames
from ablate.dataset.motion import MOVED_FOLDER, Motion, moved_frames, moved_poses
from ablate.dataset.own_poses import near_training
from ablate.networks import Attenuation, Space
from ablate.setting import identity, plain
from ablate.settings.study import ConfigurationError, StudySettings, Task, refusing
from ablate.sources.data_set import PAIRS_RECIPE, training_frames
from ablate.ultrasound import SIMULATOR_VERSION, check_settings_of_own, fan_mask, load_form, with_patient_gain
from ablate.ultrasound.media import plan_scene
from ablate.ultrasound.pulse import pulse_in_words
from ablate.ultrasound.settings import SimulatorSettings, TimeGain
from ablate.user_code import code_digest


def identity_of(settings: StudySettings, scene: Mapping[str, object]) -> dict[str, Any]:
    """What every pair of a simulated data set is made from, as JSON values; `scene` is what decides the anatomy."""
    chosen = identity(settings.dataset)
    if settings.dataset.poses:  # what they are counts, not where they lie; no grid is placed
        poses, sites = dataset.read_poses(Path(settings.dataset.poses))
        del chosen["grid"], chosen["press_mm"]
        chosen["poses"] = hashlib.sha256(poses.tobytes() + sites.tobytes()).hexdigest()[:16]
    simulator = identity(settings.simulator)
    if settings.simulator.compound_angles == 1:  # nothing is steered
        del simulator["compound_angles"], simulator["compound_steer_deg"]
    target = settings.scene.target
    target_identity = {} if target is None else {"target": {"path": target, "source": code_digest(target)}}
    return {
        "scene": dict(scene),
        "probe": plain(settings.probe),
        "simulator": simulator,
        "simulator_version": SIMULATOR_VERSION,
        **target_identity,
        "dataset": chosen,
        **PAIRS_RECIPE,
    }


def anatomy_cache(settings: StudySettings) -> Path:
    """The folder of anatomies that take long to build."""
    return settings.results / "data" / "anatomy"


def check_frames(settings: StudySettings, sites: SiteGrid | None) -> int:
    """Refuse settings that do not fit together; returns how many training frames the scene's sites can give.

    `sites` are None where a folder has none, and may do without.
    """
    simulator = settings.simulator
    with refusing("simulator."):
        simulator.check_probe(settings.probe)
    if settings.scene.target is not None:
        with refusing("scene."):
            load_form(settings.scene.target)
            check_settings_of_own(settings.scene.target, simulator)
        if settings.task is Task.view:
            others = ", ".join(task for task in Task if task is not Task.view)
            raise ConfigurationError(
                f"task={settings.task}: shows ablate's own simulator alone; allowed with scene.target are {others}"
            )
    if settings.model.attenuation is Attenuation.compound and simulator.compound_angles == 1:
        what = "the mean over the angles of simulator.compound_angles, which is 1"
        raise ConfigurationError(f"model.attenuation=compound: {what}; allowed are integral, or 3, 5, 7 or 9 angles")
    sets_gain = simulator.tgc is TimeGain.patient or simulator.time_gain_db
    if sets_gain and simulator.tgc_db_cm_mhz != SimulatorSettings.tgc_db_cm_mhz:
        raise ConfigurationError("simulator.tgc_db_cm_mhz: allowed with simulator.tgc=fixed and no time_gain_db")
    if settings.pose or settings.plane or settings.task is Task.view:  # the grid and its frames do not matter
        return training_frames(settings, settings.dataset.frames)
    if settings.dataset.poses:
        with refusing():
            offered = len(dataset.read_poses(Path(settings.dataset.poses))[0])
    else:
        assert sites is not None
        grid = dataset.resample_grid(sites, settings.dataset.grid)
        offered = len(grid.heights_mm) * len(grid.angles_deg) * len(grid.tilts_deg) * len(grid.rolls_deg)
    return training_frames(settings, min(settings.dataset.frames, offered))


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
    """Poses, (n, 4, 4) float64, mm, that an anatomy's time gain is set for: those of the training frames.

    Parameters
    ----------
    settings : StudySettings
        Of a job.
    scene, grid : Scene, SiteGrid
        The anatomy, and its probe sites.
    poses : (n, 4, 4) float64, mm
        What is given where a folder has no probe sites.
    """
    if grid == SiteGrid() and not settings.dataset.poses:
        return poses
    layout = lay_out(settings, scene, grid)
    return layout.poses[layout.split == Part.train]


def simulate_data(
    settings: StudySettings,
    place: tuple[Scene, SiteGrid],
    folder: Path,
    maps: frozenset[str],
    recipe: Mapping[str, object],
) -> None:
    """Make the data set in `folder`, or what is missing of it.

    Parameters
    ----------
    settings : StudySettings
        Probe, simulator and data set.
    place : (Scene, SiteGrid)
        The anatomy and the probe sites on it.
    folder : Path
        Of the data set.
    maps : frozenset of str
        Which arrays are wanted.
    recipe : mapping
        What decides the pairs, kept in `about.json`.
    """
    scene, grid = place
    layout = lay_out(settings, scene, grid)
    simulator = with_patient_gain(scene, settings.probe, settings.simulator, layout.poses[layout.split == Part.train])
    left_out = list(plan_scene(scene, settings.probe, simulator, layout.poses).left_out)
    asked = settings.dataset.frames
    lacking = asked - len(layout.poses)
    if lacking and not settings.dataset.poses:
        left_out.append(f"{lacking} of {asked} frames asked for: there are no more poses")
    if near := near_training(layout.poses, layout.split, settings.probe):
        left_out.append(f"nothing, but {near}; frames that look alike need one site")
    if cut := cut_frames(scene, settings.probe, layout.poses):
        left_out.append(f"nothing, but {cut}")
    if scene.guessed:
        left_out.append(f"nothing, but tissues are guessed: {scene.guessed}")
    tqdm.write(f"Simulating pairs into {folder}")
    tqdm.write(f"{layout.placement}; {len(layout.sites)} of {asked} frames asked for")
    tqdm.write(pulse_in_words(settings.probe, simulator))
    for line in left_out:
        tqdm.write(f"left out: {line}")
    about = {
        **recipe,
        "tissues": [plain(tissue) for tissue in scene.tissues],
        "left_out": left_out,
        "poses": {"usable": len(layout.placement.poses), "dropped": layout.placement.dropped},
        "time_gain_db": simulator.time_gain_db,
    }
    mask = fan_mask(settings.probe, settings.simulator.image_shape)
    names = [tissue.name for tissue in scene.tissues]
    stored_as = dataset.StoredAs(settings.dataset.shard, names, Space.beam, settings.probe, simulator.beam_shape)
    own: Any = recipe.get("target", {"path": None, "source": None})
    made_with = Recipe(scene, settings.probe, simulator, settings.dataset.seed, own["path"], own["source"])
    before = moved_frames(np.flatnonzero(layout.split == Part.test))
    poses, motions = moved_poses(layout.poses[before], settings.probe, simulator.scanlines)
    about["moved"] = np.repeat(before, len(Motion)).tolist()
    about["motions"] = motions
    moved = dataset.PlacedFrames(
        poses, np.repeat(layout.sites[before], len(Motion)), np.full(len(poses), Part.test, np.uint8), mask
    )
    frames = dataset.PlacedFrames(layout.poses, layout.sites, layout.split, mask)
    # the frames after motions first: where the data set has been laid out, they have been too
    of_moved = "simulate test frames after a motion", moved, folder / MOVED_FOLDER
    for what, placed, place_of in (of_moved, ("simulate", frames, folder)):
        pairs = dataset.create_pairs(place_of, placed, stored_as, about)
        dataset.simulate_pairs(made_with, pairs, maps, settings.dataset.workers, what)
