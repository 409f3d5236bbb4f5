"""The data set of a job: made where something of it is missing; its frames and its time gain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ablate.dataset import Pairs, write_contact_sheet
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.sources.data_set import DataSet
from ablate.sources.source import source_of
from ablate.ultrasound.settings import SimulatorSettings, TimeGain

if TYPE_CHECKING:
    from ablate.anatomy import Scene, SiteGrid
    from ablate.sources.simulated import Layout


def prepare_data(settings: StudySettings, data: DataSet, recipe: Mapping[str, Any], maps: frozenset[str]) -> DataSet:
    """Simulate, or import, what is missing of a data set; returns at once when nothing is.

    Parameters
    ----------
    settings : StudySettings
        Of a job that reads it.
    data : DataSet
        Its folder, whose name has the digest of the recipe.
    recipe : mapping
        `Source.identity` when the command began; files that were edited since are a ConfigurationError.
    maps : frozenset of str
        The maps that are wanted; see `maps_needed`.
    """
    source = source_of(settings)
    wanted = source.offered(maps)
    if data.lacks(wanted):
        if source.identity() != recipe:
            raise ConfigurationError(f"{data.name}: its files were edited since the command began; repeat the command")
        data.forget_digests()  # frames are made again, perhaps on another kind of processor
        source.fill(data.folder, wanted, recipe)
        data = DataSet(data.folder)
    if not data.contact_sheet.exists():
        write_contact_sheet(data.pairs, data.contact_sheet)
    return data


def frames_of(settings: StudySettings, data: DataSet, scene: Scene, grid: SiteGrid) -> Layout | Pairs:
    """The frames of a data set, as they are made or, where none are, as they will be.

    Parameters
    ----------
    settings : StudySettings
        Of a job that reads the data set.
    data : DataSet
        It need not be made yet.
    scene, grid : Scene, SiteGrid
        The anatomy, and its probe sites.
    """
    from ablate.sources.simulated import lay_out

    return data.pairs if data.exists else lay_out(settings, scene, grid)


def simulator_of(
    settings: StudySettings, data: DataSet, scene: Scene, grid: SiteGrid, poses: np.ndarray
) -> SimulatorSettings:
    """The simulator's settings with the time gain of a data set.

    Parameters
    ----------
    settings : StudySettings
        Of a job that reads the data set.
    data : DataSet
        It need not be made yet.
    scene, grid : Scene, SiteGrid
        The anatomy, and its probe sites, which the gain is set for.
    poses : (n, 4, 4) float64, mm
        What the gain is set for where a folder has no probe sites.
    """
    from ablate.sources.simulated import training_poses
    from ablate.ultrasound import with_patient_gain

    simulator = settings.simulator
    if simulator.tgc is TimeGain.fixed or simulator.time_gain_db is not None:
        return simulator
    if data.exists:
        return replace(simulator, time_gain_db=data.time_gain_db)
    return with_patient_gain(scene, settings.probe, simulator, training_poses(settings, scene, grid, poses))
