"""Make what is missing of the pairs that a job reads: simulated from a scene, or imported.

What needs a scene, and with it Embree and numba, is imported where a scene is used.
"""

from tqdm import tqdm

from ablate.dataset import open_pairs, remove_damaged, write_contact_sheet
from ablate.runs.data_set import DataSet
from ablate.runs.imported import checked_folder, import_data
from ablate.runs.job import Job
from ablate.settings.study import SceneKind


def prepare_data(job: Job, maps: frozenset[str]) -> DataSet:
    """Simulate, or import, what is missing of the job's pairs; returns at once when nothing is."""
    settings, data = job.settings, job.data
    if data.lacks(wanted := _offered(job, maps)):
        data.forget_pixels()
        if settings.scene.kind is SceneKind.pairs:
            import_data(settings, data.folder, wanted)
        else:
            from ablate.runs.simulated import simulate_data

            simulate_data(settings, data.folder, wanted, job.semantic["data"])
        data = job.data
    if not data.contact_sheet.exists():
        write_contact_sheet(data.pairs, data.contact_sheet)
    return data


def made_data(job: Job, maps: frozenset[str]) -> DataSet | None:
    """The job's pairs, or None where something is missing of them."""
    data = job.data
    return None if data.lacks(_offered(job, maps)) else data


def drop_damaged(job: Job, maps: frozenset[str]) -> tuple[str, ...]:
    """Compare what is on disk of the job's pairs with its checksums; what is damaged is removed and named."""
    if not job.data.exists:
        return ()
    with tqdm(unit="shard", desc="check", mininterval=1.0, leave=False) as bar:
        return remove_damaged(open_pairs(job.data.folder), maps, bar.update)


def _offered(job: Job, maps: frozenset[str]) -> frozenset[str]:
    """Those of the maps that there can be: a folder of pairs made elsewhere may have fewer."""
    return maps & checked_folder(job.settings).maps if job.settings.scene.kind is SceneKind.pairs else maps
