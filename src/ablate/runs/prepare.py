"""The data set of a job: made where something of it is missing; its frames and time gain."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ablate.dataset import Pairs, write_contact_sheet
from ablate.runs.data_set import DataSet, about_data, checked_folder, import_data
from ablate.runs.job import Job
from ablate.settings.study import ConfigurationError, SceneKind
from ablate.ultrasound.settings import SimulatorSettings, TimeGain

if TYPE_CHECKING:
    from ablate.anatomy import Scene, SiteGrid
    from ablate.runs.simulated import Layout


def prepare_data(job: Job, maps: frozenset[str]) -> DataSet:
    """Simulate, or import, what is missing of the job's pairs; returns at once when nothing is."""
    settings, data = job.settings, job.data
    if data.lacks(wanted := offered(job, maps)):
        if about_data(settings) != job.semantic["data"]:
            raise ConfigurationError(f"{data.name}: its files were edited since the command began; repeat the command")
        for of_frames in (data.kept_digest, *(data.folder / "resimulation").glob("*.json")):
            of_frames.unlink(missing_ok=True)  # they are made again, perhaps on another kind of processor
        if settings.scene.kind is SceneKind.pairs:
            make = import_data
        else:  # only here: what needs a scene needs Embree and numba
            from ablate.runs.simulated import simulate_data as make
        make(settings, data.folder, wanted, job.semantic["data"])
        data = job.data
    if not data.contact_sheet.exists():
        write_contact_sheet(data.pairs, data.contact_sheet)
    return data


def offered(job: Job, maps: frozenset[str]) -> frozenset[str]:
    """Those of the maps that there can be: a folder of pairs made elsewhere may have fewer."""
    return maps & checked_folder(job.settings).maps if job.settings.scene.kind is SceneKind.pairs else maps


def frames_of(job: Job, scene: Scene, grid: SiteGrid) -> Layout | Pairs:
    """The frames of a job's data set, as they are made or, where none are, as they will be."""
    from ablate.runs.simulated import lay_out

    return job.data.pairs if job.data.exists else lay_out(job.settings, scene, grid)


def simulator_of(job: Job, scene: Scene, grid: SiteGrid, poses: np.ndarray) -> SimulatorSettings:
    """The simulator's settings with the time gain of the job's data set; without probe sites, that of these poses."""
    from ablate.runs.simulated import training_poses
    from ablate.ultrasound import with_patient_gain

    settings = job.settings
    if settings.simulator.tgc is TimeGain.fixed or settings.simulator.time_gain_db is not None:
        return settings.simulator
    if job.data.exists:
        return replace(settings.simulator, time_gain_db=job.data.time_gain_db)
    return with_patient_gain(scene, settings.probe, settings.simulator, training_poses(settings, scene, grid, poses))
