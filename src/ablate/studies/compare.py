"""The comparison of a study: from what is on disk to tables, figures, a report and the parent run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ablate.analysis import (
    REFERENCE,
    Spread,
    cautions,
    comparison_table,
    effects_table,
    find_design,
    paired_table,
    resimulation_note,
    seed_claims,
    to_latex,
    to_markdown,
    to_text,
    wide_table,
    write_report,
)
from ablate.config import StudySettings
from ablate.studies.compare_figures import Numbers, draw_figures, stored_pictures
from ablate.studies.identity import write_json
from ablate.studies.results import Finished, appendix, data_of, provenance, scored_frames
from ablate.studies.sweep import ConfigurationError
from ablate.studies.tracked import describe_study, open_tracking, register_reference
from ablate.studies.usable_runs import UsableRuns, usable_runs
from ablate.tracking import RunLog, Status, default_uri

_SCREEN = ("psnr", "mae", "pchi2", "fd_speckle", "shadow_contrast", "mae_smooth", "noise_sd", "ms_per_frame")
_GLANCE = ("psnr", "mae", "pchi2", "fd_speckle")  # on the parent run's first page
_TABLE_II = ("psnr", "mae", "pchi2", "fd_speckle", "fid", "parameters")
COMPONENTS = ("attenuation", "concat", "upsampling", "noise", "depth", "encoding")


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
        When the study has no finished run that can be used.
    """
    folder, reference = settings.study_dir / "comparison", settings.reference
    usable = usable_runs(settings.study_dir, reference)
    if not usable.runs:
        raise ConfigurationError(" ".join([f"{settings.study_dir} holds no finished run to compare.", *usable.notes]))
    hashes = [run.result["hash"] for run in usable.runs]
    scored = [[run.result.get("metrics"), run.result.get("inception")] for run in usable.runs]
    made_from = {"runs": hashes, "scored": scored, "reference": reference, "notes": list(usable.notes)}
    marker = folder / "made_from.json"
    if rebuild or not marker.exists() or json.loads(marker.read_text()) != made_from:
        files, notes = write_comparison(usable, folder, settings.study, reference)
        _track(settings, usable.runs, files, notes)
        write_json(marker, made_from)
    per_image, scalars = scored_frames(usable.runs)
    table = comparison_table(per_image, scalars, reference)
    warnings = "\n".join(f"Note: {c}" for c in (*usable.notes, *cautions(per_image, reference)))
    uri = settings.tracking.uri or default_uri(settings.runs)
    pages = uri if uri.startswith("http") else f"make ui, or: mlflow ui --backend-store-uri {uri} --workers 1"
    where = (
        f"all metrics    {folder / 'table.csv'}\n"
        f"paired tests   {folder / 'paired.csv'}\n"
        f"report         {folder / 'report.html'}\n"
        f"MLflow         {pages}"
    )
    if settings.tracking.register:
        where += f"\nregistered     {register_reference(settings, list(usable.runs))}"
    return f"{to_text(table[table['metric'].isin(_SCREEN)])}\n{warnings}\n\n{where}"


def write_comparison(
    usable: UsableRuns, folder: Path, title: str, reference: str = REFERENCE
) -> tuple[list[Path], list[str]]:
    """Write tables, figures and the report of a study; what was there before is replaced when all is written.

    Parameters
    ----------
    usable : UsableRuns
        With at least one run.
    folder : Path
        Usually `comparison` in the study's folder.
    title : str
        Of the report.
    reference : str

    Returns
    -------
    files : list of Path
        The report first.
    notes : list of str
        What a reader must know, a sentence each.
    """
    partial = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    runs = usable.runs
    per_image, scalars = scored_frames(runs)
    table = comparison_table(per_image, scalars, reference)
    design = find_design({run.label: components_of(run) for run in runs}, COMPONENTS, reference)
    paired = paired_table(per_image, reference)
    effects = pd.DataFrame() if design is None else effects_table(per_image, design, scalars)
    claims = seed_claims(per_image, scalars, reference)
    frames, missing = stored_pictures(runs, reference)
    figures = draw_figures(Numbers(reference, per_image, scalars, table, paired, effects, design), frames, partial)
    notes = [*usable.notes, *([missing] if missing else [])]
    report = write_report(
        partial / "report.html",
        title,
        per_image,
        table,
        paired,
        claims=claims,
        figures=[(path, caption) for path, caption in figures if path.suffix == ".png"],
        left_out=_left_out(runs),
        provenance=provenance(runs),
        reference=reference,
        appendix=appendix(runs),
        notes=notes,
    )
    wide_table(table).to_csv(partial / "table.csv", index=False)
    (partial / "table.tex").write_text(to_latex(table[table["metric"].isin(_TABLE_II)], reference))
    (partial / "table.md").write_text(_markdown(table))
    for name, content in (("paired", paired), ("claims", claims), ("effects", effects)):
        if len(content) or name != "effects":
            content.to_csv(partial / f"{name}.csv", index=False)
    shutil.rmtree(folder, ignore_errors=True)
    partial.rename(folder)
    names = dict.fromkeys([report.name, *(p.name for p, _ in figures), *sorted(p.name for p in folder.iterdir())])
    return [folder / name for name in names], [*notes, *cautions(per_image, reference)]


def _track(settings: StudySettings, runs: Sequence[Finished], files: Sequence[Path], notes: Sequence[str]) -> None:
    """Put a comparison onto the parent run."""
    store, parent = open_tracking(settings)
    run = RunLog(store, parent)
    for path in files:
        run.artifact(path, "vector" if path.suffix == ".pdf" else None)
    run.tags(provenance(runs))
    per_image, scalars = scored_frames(runs)
    table = comparison_table(per_image, scalars, settings.reference)
    describe_study(run, runs, to_markdown(table[table["metric"].isin(_GLANCE)]), notes)
    run.end(Status.finished)


def components_of(run: Finished) -> dict[str, object]:
    """Everything that a run's network was made from."""
    content = run.spec["semantic"]
    return {**content["model"], "encoding": content["encoding"]["order"]}


def _markdown(table: pd.DataFrame) -> str:
    """The table of the paper, then every metric with the spread over seeds."""
    metrics = list(dict.fromkeys(table["metric"]))
    parts = [
        "Mean ± standard deviation over test frames (over seeds for figures that a run has one of); the best network "
        f"in bold.\n\n{to_markdown(table[table['metric'].isin(_TABLE_II)])}",
        f"{resimulation_note(metrics)}\n",
    ]
    if table["seed_sd"].notna().any():
        parts.append(f"Mean ± standard deviation of the seeds' means.\n\n{to_markdown(table, Spread.seeds)}")
    else:
        parts.append(f"All metrics.\n\n{to_markdown(table)}")
    return "\n".join(parts)


def _left_out(runs: Sequence[Finished]) -> list[str]:
    """What this study did without, and why."""
    try:
        said = list(data_of(runs).left_out)
    except (OSError, ValueError, KeyError):
        said = []  # the pairs are gone, and with them what their simulation left out
    said += dict.fromkeys(str(note) for run in runs for note in run.result.get("notes", ()))
    if not any(run.spec["settings"]["model"]["extra_input"] == "low" for run in runs):
        said.append("The low-quality image L: no variant of this study reads it, so it was not rendered.")
    return said
