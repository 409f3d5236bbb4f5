"""The comparison of a study: from what is on disk to tables, figures, a report and the parent run."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pandas as pd

from ablate.analysis import (
    cautions,
    chi2_maps_figure,
    comparison_table,
    error_vs_runtime,
    paired_boxplots,
    paired_table,
    qualitative_figure,
    seed_claims,
    to_latex,
    to_markdown,
    to_text,
    wide_table,
    write_report,
)
from ablate.config import StudySettings
from ablate.studies.identity import write_json
from ablate.studies.results import (
    Finished,
    appendix,
    data_of,
    finished_runs,
    pictures,
    provenance,
    runtime_points,
    scored_frames,
)
from ablate.studies.sweep import ConfigurationError
from ablate.studies.tracked import describe_study, open_tracking, register_reference
from ablate.tracking import RunLog, Status, default_uri, hardware

_SCREEN = ("psnr", "mae", "pchi2", "fd_speckle", "shadow_contrast", "mae_smooth", "noise_sd", "ms_per_frame")
_GLANCE = ("psnr", "mae", "pchi2", "fd_speckle")  # on the parent run's first page
_BOXPLOTS = ("psnr", "mae", "pchi2")  # Fig. 4 of the paper; every metric has its own picture
_TABLE_II = ("psnr", "mae", "pchi2", "fd_speckle", "fid", "parameters")


def compare_study(settings: StudySettings, rebuild: bool = False) -> str:
    """Compare the finished runs of a study, write everything beside them and onto the parent run.

    What is there already is taken when it was made from the same runs, unless `rebuild` asks for it anew.

    Parameters
    ----------
    settings : StudySettings
    rebuild : bool

    Returns
    -------
    str
        The comparison for the screen, with where to look next.

    Raises
    ------
    ConfigurationError
        When the study has no finished run.
    """
    folder = settings.study_dir / "comparison"
    runs = finished_runs(settings.study_dir)
    if not runs:
        raise ConfigurationError(f"{settings.study_dir} holds no finished run to compare")
    per_image, scalars = scored_frames(runs)
    made_from = {"runs": [run.result["hash"] for run in runs], "reference": settings.reference}
    marker = folder / "made_from.json"
    if rebuild or not marker.exists() or json.loads(marker.read_text()) != made_from:
        shutil.rmtree(folder, ignore_errors=True)
        _write(settings, runs, per_image, scalars, folder)
        write_json(marker, made_from)
    table = comparison_table(per_image, scalars, settings.reference)
    warnings = "\n".join(f"Note: {c}" for c in cautions(per_image, settings.reference))
    uri = settings.tracking.uri or default_uri(settings.runs)
    pages = uri if uri.startswith("http") else f"make ui, or: mlflow ui --backend-store-uri {uri} --workers 1"
    where = (
        f"all metrics    {folder / 'table.csv'}\n"
        f"paired tests   {folder / 'paired.csv'}\n"
        f"report         {folder / 'report.html'}\n"
        f"MLflow         {pages}"
    )
    if settings.tracking.register:
        where += f"\nregistered     {register_reference(settings, runs)}"
    return f"{to_text(table[table['metric'].isin(_SCREEN)])}\n{warnings}\n\n{where}"


def _write(
    settings: StudySettings, runs: list[Finished], per_image: pd.DataFrame, scalars: pd.DataFrame, folder: Path
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    reference = settings.reference
    table, paired = comparison_table(per_image, scalars, reference), paired_table(per_image, reference)
    wide_table(table).to_csv(folder / "table.csv", index=False)
    paired.to_csv(folder / "paired.csv", index=False)
    (folder / "table.tex").write_text(to_latex(table[table["metric"].isin(_TABLE_II)]))
    figures = _figures(settings, runs, per_image, table, paired, folder)
    report = write_report(
        folder / "report.html",
        settings.study,
        per_image,
        table,
        paired,
        claims=seed_claims(per_image, scalars, reference),
        figures=[(path, caption) for path, caption in figures if path.suffix == ".png"],
        left_out=[*data_of(runs).left_out, *_left_out(runs)],
        provenance=provenance(runs),
        reference=reference,
        appendix=appendix(runs),
    )
    store, parent = open_tracking(settings)
    run = RunLog(store, parent)
    for path in (report, folder / "table.csv", folder / "table.tex", folder / "paired.csv", *(f for f, _ in figures)):
        run.artifact(path, "vector" if path.suffix == ".pdf" else None)
    run.tags(provenance(runs))
    describe_study(run, runs, to_markdown(table[table["metric"].isin(_GLANCE)]), cautions(per_image, reference))
    run.end(Status.finished)


def _figures(
    settings: StudySettings,
    runs: list[Finished],
    per_image: pd.DataFrame,
    table: pd.DataFrame,
    paired: pd.DataFrame,
    folder: Path,
) -> list[tuple[Path, str]]:
    """Every figure with its caption, in the order of the report."""
    frames = pictures(runs, settings.reference)
    made = [
        (p, "Target, re-simulation and every variant.") for p in qualitative_figure(frames, folder / "qualitative_0")
    ]
    boxes = paired_boxplots(per_image, folder, settings.reference, paired)
    for metric in sorted(boxes, key=lambda m: (m not in _BOXPLOTS, m)):
        made += [
            (p, f"Paired differences to {settings.reference} on the same frames: {metric}.") for p in boxes[metric]
        ]
    for k, frame in enumerate(frames):
        caption = f"Patch chi-square maps on [0, 1] above their images, {frame.name}."
        made += [(p, caption) for p in chi2_maps_figure(frame, folder / f"pchi2_maps_{k}")]
    points, floors = runtime_points(table)
    if len(points):
        stem = folder / "error_vs_runtime"
        made += [(p, "Error against run time.") for p in error_vs_runtime(points, stem, floors, hardware())]
    return made


def _left_out(runs: list[Finished]) -> list[str]:
    """What this study did without, and why."""
    said = [
        "FID and KID: no Inception weights were given; fd_speckle and kd_speckle are the same distances on a "
        "texture descriptor without weights, and do not compare with published FID values."
    ]
    if not any(run.spec["settings"]["model"]["extra_input"] == "low" for run in runs):
        said.append("The low-quality image L: no variant of this study reads it, so it was not rendered.")
    return said
