"""The data set of a job: made where something of it is missing.

What needs a scene, and with it Embree and numba, is imported where a scene is used.
"""

from ablate.dataset import write_contact_sheet
from ablate.runs.data_set import DataSet, checked_folder, import_data
from ablate.runs.job import Job
from ablate.settings.study import SceneKind


def prepare_data(job: Job, maps: frozenset[str]) -> DataSet:
    """Simulate, or import, what is missing of the job's pairs; returns at once when nothing is."""
    settings, data = job.settings, job.data
    if data.lacks(wanted := offered(job, maps)):
        data.kept_digest.unlink(missing_ok=True)  # frames are made again, perhaps on another kind of processor
        if settings.scene.kind is SceneKind.pairs:
            make = import_data
        else:
            from ablate.runs.simulated import simulate_data as make
        make(settings, data.folder, wanted, job.semantic["data"])
        data = job.data
    if not data.contact_sheet.exists():
        write_contact_sheet(data.pairs, data.contact_sheet)
    return data


def offered(job: Job, maps: frozenset[str]) -> frozenset[str]:
    """Those of the maps that there can be: a folder of pairs made elsewhere may have fewer."""
    return maps & checked_folder(job.settings).maps if job.settings.scene.kind is SceneKind.pairs else maps
