"""A data set written in other people's formats, with a card that says what it is and how it was made."""

import json
from collections.abc import Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from jinja2 import Template

from ablate.dataset import Part
from ablate.dataset.classes import Classes, by_structure, by_tissue
from ablate.dataset.export_formats import write_nnunet, write_png
from ablate.extras import installing
from ablate.settings.study import ClassesBy, ConfigurationError, ExportFormat, StudySettings, refusing
from ablate.sources.data_set import DataSet, maps_needed
from ablate.sources.prepare import prepare_data
from ablate.sources.source import source_of
from ablate.storage import write_text
from ablate.study.job import Job
from ablate.ultrasound.probe import pixel_size_mm


@refusing()  # a package that is missing, a full disk, ...
def export(jobs: Sequence[Job]) -> int:
    """Write the first job's data set, simulated first where it is missing, and print the folder of the files."""
    settings = jobs[0].settings
    chosen = settings.dataset.format
    check_dicom(chosen)
    imported = not source_of(settings).has_scene
    if (
        chosen is ExportFormat.dicom
        and imported
        and not (fan := Path(settings.scene.folder or "") / "fan.yaml").exists()
    ):
        missing = "which tells the mm of pairs made elsewhere; allowed without it: png, nnunet"
        raise ConfigurationError(f"dataset.format=dicom: needs {fan}, {missing}")
    maps = maps_needed(job.settings.model for job in jobs)
    data = prepare_data(settings, jobs[0].data, jobs[0].identity["data"], maps)
    pairs = data.pairs
    folder = settings.results / "export" / f"{data.name}-{chosen}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "README.md").unlink(missing_ok=True)  # written last: a folder without it is not finished
    is_by_structure = settings.dataset.classes is ClassesBy.structures and not imported
    classes = by_tissue(pairs)
    if is_by_structure and chosen is not ExportFormat.png:
        classes = by_structure(pairs, source_of(settings).scene()[0])
    if chosen is ExportFormat.png:
        write_png(pairs, folder, data.tissues)
    elif chosen is ExportFormat.nnunet:
        write_nnunet(pairs, folder / f"Dataset001_{settings.scene_name.replace(' ', '_')}", classes)
    else:
        from ablate.dataset.dicom_files import write_dicom

        write_dicom(pairs, folder, pixel_size_mm(pairs.probe or settings.probe, pairs.shape), classes, imported)
    write_text(folder / "README.md", _card(settings, data, classes))
    print(folder)
    return 0


def check_dicom(chosen: ExportFormat) -> None:
    """Refuse `dicom` where its packages are not installed."""
    missing = [name for name in ("pydicom", "highdicom") if not find_spec(name)]
    if chosen is ExportFormat.dicom and missing:
        needs = f"needs the package{'s' * (len(missing) > 1)} {' and '.join(missing)}: {installing('dicom')}"
        raise ConfigurationError(f"dataset.format=dicom: {needs}")


def _card(settings: StudySettings, data: DataSet, classes: Classes) -> str:
    """A data card in Markdown."""
    pairs, about = data.pairs, data.about
    parts = ", ".join(f"{int((pairs.split == part).sum())} for {part.name}" for part in Part)
    keys = ("scene", "probe", "simulator", "simulator_version", "dataset")
    recipe = {key: about[key] for key in keys if key in about}
    card = Template(files("ablate.tasks").joinpath("card.md.jinja").read_text("utf-8"), keep_trailing_newline=True)
    about_frames = {"parts": parts, "sites": len(np.unique(pairs.sites)), "made": json.dumps(recipe, indent=2)}
    about_frames |= {"names": classes.names}
    imported = not source_of(settings).has_scene
    probe = pairs.probe if imported else pairs.probe or settings.probe
    pixel = pixel_size_mm(probe, pairs.shape) if probe else None
    return card.render(settings=settings, pairs=pairs, imported=imported, pixel_mm=pixel, **about_frames)
