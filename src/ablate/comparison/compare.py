"""Compare the finished runs of a study: tables, figures and a report on disk and in the parent run."""

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from filelock import FileLock

from ablate import analysis, tracking
from ablate.analysis import StudyResults, draw_figures, listed
from ablate.analysis.tables import head
from ablate.comparison.frame_times import TIMES, time_networks, timed_on, untimed
from ablate.comparison.opened import Study
from ablate.comparison.reading import pictures, provenance
from ablate.comparison.usable_runs import levels_of, usable_runs
from ablate.metrics import Shown, shown_in
from ablate.metrics.metric import FRAME_TIME
from ablate.runs.job import COMPARISON
from ablate.runs.run import Run
from ablate.runs.store_copy import copy_study
from ablate.settings.conf import conf_folder
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.storage import digest, digest_of_files, known_json, write_json
from ablate.tracking import STATE, UNAVAILABLE, Status, StoredRun, default_uri, reason, within

_TRACKING_S = 120.0  # a server that answers slowly or not at all is not waited for longer


def compare_study(settings: StudySettings, rebuild: bool = False, time_here: bool = True) -> str:
    """Compare the finished runs of a study, on disk and on the parent run; returns what the screen shows of it.

    A comparison of the same runs that is there already is kept, unless `rebuild` asks for it anew. With `time_here`
    networks that this machine has not timed are timed first. Of several processes one compares and the others wait, and
    then keep what it made. No finished run that can be used is a ConfigurationError.
    """
    if not settings.study_dir.is_dir():
        raise ConfigurationError(f"{settings.study_dir} holds no finished run to compare.")
    with FileLock(settings.study_dir / ".comparison.lock"):
        return _compare_study(settings, rebuild, time_here)


def _compare_study(settings: StudySettings, rebuild: bool, time_here: bool) -> str:
    folder, reference = settings.study_dir / COMPARISON, settings.reference
    usable = usable_runs(settings.study_dir, reference)
    if not usable.runs:
        raise ConfigurationError(" ".join([f"{settings.study_dir} holds no finished run to compare.", *usable.notes]))
    failed = time_networks(settings.study_dir, usable.all) if time_here else ""
    usable = replace(usable, notes=(*usable.notes, *filter(None, [failed]), *untimed(usable.all)))
    study = Study(settings.study_dir, usable, reference)
    made_from, marker = _made_from(study), folder / "made_from.json"
    notes = None if rebuild else _kept(marker, made_from)
    if notes is None:
        notes = write_comparison(study, settings.study)
        written = sorted(path.name for path in folder.iterdir())
        write_json(marker, {**made_from, "for_readers": notes, "written": written})
    try:
        within(_TRACKING_S, lambda: _track(settings, study, notes))
        tracked = ""
    except UNAVAILABLE as error:
        tracked = f"\nNote: not all is in MLflow yet ({reason(error)}); the same command logs the rest."
    warnings = "\n".join(f"Note: {note}" for note in notes)
    uri = settings.tracking.uri or default_uri(settings.results)
    shown = study.table[study.table["metric"].isin(shown_in(Shown.screen))]
    pages = uri if uri.startswith("http") else f"make ui, or: mlflow ui --backend-store-uri {uri} --workers 1"
    where = (
        f"all metrics    {folder / 'table.csv'}\n"
        f"paired tests   {folder / 'paired.csv'}\n"
        f"verdicts       {folder / 'verdicts.csv'}{_verdicts_in_words(folder / 'verdicts.csv')}\n"
        f"report         {folder / 'report.html'}\n"
        f"MLflow         {pages}{tracked}"
    )
    return f"{analysis.to_text(shown)}\n{warnings}\n\n{where}"


def _made_from(study: Study) -> dict[str, Any]:
    """What decides a comparison: the files of its runs and of times, the reference, what was left aside, bands, code.

    A run that was deleted and trained again has the same configuration and other files.
    """
    runs = {f"{run.name} of {run.data}": run.compared_state() for run in study.usable.all}
    read = [study.folder / TIMES, *sorted((conf_folder() / "component").glob("*.yaml"))]
    chosen = {"study": study.folder.name, "reference": study.reference, "notes": list(study.usable.notes)}
    titles = [head(metric) for metric in sorted(set(study.table["metric"]))]  # as far as this command knows
    return {"runs": runs, "files": digest_of_files(read), "metrics": titles, "code": tracking.source_digest(), **chosen}


def _kept(marker: Path, made_from: Mapping[str, Any]) -> list[str] | None:
    """What a reader of the comparison on disk must know; None where a file lacks, or it is of something else."""
    there = known_json(marker)
    notes, written = there.pop("for_readers", None), there.pop("written", None)
    return notes if written and there == made_from and all((marker.parent / n).exists() for n in written) else None


def write_comparison(study: Study, title: str) -> list[str]:
    """Write tables, figures and the report of a study; what was in its folder of comparison goes when all is written.

    Returns what a reader must know, a sentence each.
    """
    folder, usable, reference, judged = study.folder / COMPARISON, study.usable, study.reference, study.answers
    partial = folder.with_name(f"{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        frames = pictures(usable.runs, reference)
        missing = [] if frames else ["There are no pictures: the runs kept no frame in common."]
    except (OSError, ValueError, KeyError) as error:  # pairs or pictures are missing or damaged
        frames, missing = [], [f"There are no pictures: {' '.join(str(error).split())}."]
    results = StudyResults(
        per_image=study.per_image,
        scalars=study.scalars,
        reference=reference,
        blocks=study.blocks,
        design=judged.design,
        means=judged.means,
        components=judged.components,
        spreads=judged.spreads,
        pictures=frames,
        machine=timed_on(usable.all),
    )
    figures = draw_figures(results, partial)
    notes = [*usable.notes, *missing, *analysis.partly_scored(study.runs, {*study.table["metric"]} - {FRAME_TIME})]
    analysis.write_report(
        partial / "report.html",
        results,
        title,
        figures=figures,
        notes=notes,
        left_out=_left_out(usable.all),
        provenance=provenance(usable.all),
    )
    analysis.wide_table(study.table).to_csv(partial / "table.csv", index=False)
    of_the_paper = study.table[study.table["metric"].isin(shown_in(Shown.table))]
    (partial / "table.tex").write_text(analysis.to_latex(of_the_paper, reference), "utf-8")
    tables = {"paired": results.paired, "claims": results.claims, "verdicts": judged.verdicts, "runs": judged.runs}
    more = {"effects": judged.effects} if len(judged.effects) else {}
    for name, content in (tables | more).items():
        content.to_csv(partial / f"{name}.csv", index=False)
    shutil.rmtree(folder, ignore_errors=True)
    partial.rename(folder)
    return [*notes, *analysis.cautions(study.per_image, reference, study.blocks)]


def _track(settings: StudySettings, study: Study, notes: Sequence[str]) -> None:
    """Bring the store up to date with the runs of a study and their comparison."""
    run, ids = copy_study(settings)
    runs, table = study.usable.runs, study.table
    files = [path for path in sorted((study.folder / COMPARISON).iterdir()) if path.is_file()]
    state = digest([ids, {path.name: path.stat().st_mtime_ns for path in files}])
    if run.tag(STATE) != state:
        for path in files:
            run.artifact(path, "vector" if path.suffix == ".pdf" else None)
        run.tags(provenance(study.usable.all))
        for row in study.runs.to_dict("records"):
            run_id = ids.get(f"{row['variant']}/seed{row['seed']}")
            if run_id is not None and FRAME_TIME in row:
                StoredRun(run.store, run_id).scores({FRAME_TIME: row[FRAME_TIME]})
        headline = table[table["metric"].isin(shown_in(Shown.headline))]
        if earlier := run.artifacts() - {path.name for path in files}:
            notes = [*notes, f"Files of earlier comparisons, which are not made any more: {listed(sorted(earlier))}."]
        _describe(run, runs, ids, headline, notes)
        run.tags({STATE: state})
    run.mark(Status.finished)


def _describe(
    run: StoredRun, runs: Sequence[Run], ids: Mapping[str, str], table: pd.DataFrame, cautions: Sequence[str]
) -> None:
    """Write the parent run's description (links, a `comparison_table` in Markdown, cautions) and the table's means.

    `ids` are those of the stored runs, by name.
    """
    first: dict[str, str] = {}
    for one in sorted(runs, key=lambda r: r.seed):
        if one.name in ids:
            first.setdefault(one.label, ids[one.name])
    report, compared = tracking.pages(run.store, run.run_id, list(first.values()))
    links = f"[The report]({report}) · [the variants side by side]({compared})"
    rows = analysis.to_markdown(table).splitlines()  # MLflow's pages show no space between the columns of a table
    spaced = [row if set(row) <= set("|-: ") else row.replace(" |", "\u00a0\u00a0|") for row in rows]
    run.describe("\n\n".join([links, "\n".join(spaced), *cautions]))
    means = table[["metric", "variant", "mean"]].dropna().itertuples(index=False)
    run.scores(
        {re.sub(r"[^\w/. -]", "_", f"test/{metric}/{variant}"): float(mean) for metric, variant, mean in means},
        whole=True,
    )


def _verdicts_in_words(verdicts: Path) -> str:
    """The verdicts of a file, for the screen; nothing where no run goes without a component."""
    table = pd.read_csv(verdicts)
    shown = table[table["effect"].notna()]
    words = [f"{c} {v.replace('_', ' ')}" for c, v in zip(shown["component"], shown["verdict"], strict=True)]
    return f" ({', '.join(words)})" if words else ""


def _left_out(runs: Sequence[Run]) -> list[str]:
    """What was left out of this study, and why."""
    try:
        notes = list(runs[0].data_set.about["left_out"])
    except (OSError, ValueError, KeyError):
        notes = []  # the pairs have been deleted
    told = [(str(note), run.name) for run in runs for note in run.result.get("notes", ())]
    for note in dict.fromkeys(note for note, _ in told):
        names = [name for other, name in told if other == note]
        notes.append(note if len(names) == len(runs) else f"{listed(names)}: {note}")
    if not any(levels_of(run.spec["semantic"]).get("model.extra_input") == "low" for run in runs):
        notes.append("The low-quality image L: no variant of this study reads it, so it was not rendered.")
    return notes
