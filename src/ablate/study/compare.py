"""Compare the runs of a study: tables, figures and a report on disk."""

import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from textwrap import wrap
from typing import Any

import pandas as pd

from ablate import analysis
from ablate.analysis import StudyResults, draw_figures, listed
from ablate.analysis.leaderboard import SCREEN_COLUMNS
from ablate.analysis.tables import head
from ablate.metrics import METRICS, FeatureKind, Shown, shown_in
from ablate.metrics.metric import FRAME_TIME
from ablate.settings.study import ConfigurationError
from ablate.storage import digest, digest_of_files, held, known_json, write_json
from ablate.study.comparable import ComparableRuns, comparable_runs, levels_of, with_earlier, with_scores_on_disk
from ablate.study.frame_times import TIMES, time_networks, untimed
from ablate.study.opened import Study
from ablate.study.reading import provenance
from ablate.study.run import COMPARISON, Run, RunList, write_list
from ablate.study.scores import metric_in
from ablate.study.source_code import loaded_digest
from ablate.study.training import refuse_link


@dataclass(frozen=True)
class Compared:
    """A comparison on disk, and what a reader must know of it, a sentence each."""

    study: Study
    notes: tuple[str, ...]


def compare_study(
    asked: RunList, title: str, rebuild: bool = False, time_here: bool = True, named: Collection[str] = ()
) -> Compared:
    """Compare runs of a study, on disk.

    Of several processes one compares and the others wait, and then keep what it made.

    Parameters
    ----------
    asked : RunList
        The runs; those that cannot be compared with the others are left aside and named. Unless it is rebuilt, runs
        that the comparison on disk has may join them; see `comparable.with_earlier`.
    title : str
        Of the report.
    rebuild : bool
        Whether a comparison of the same files is made again; otherwise it is kept.
    time_here : bool
        Whether networks that this machine has not timed are timed first.
    named : collection of str
        Dotted paths of the user's classes that this command names; other code that files name is not imported.

    Raises
    ------
    ConfigurationError
        Where no run is finished, or the folder is a link.
    """
    refuse_link(asked.folder)
    if not asked.runs:
        words = [f"{asked.folder} holds no finished run to compare.", *comparable_runs(asked).notes]
        raise ConfigurationError(" ".join(words))
    # The list on disk is read and written by one process.
    with held(asked.folder / ".comparison.lock", "compares this study"):
        if not rebuild:
            asked = with_earlier(asked)
        asked = with_scores_on_disk(asked)
        usable = comparable_runs(asked)
        failed = time_networks(asked.folder, usable.all, named, asked.reference) if time_here else ""
        return _compare(asked, usable, title, rebuild, failed)


def _compare(asked: RunList, usable: ComparableRuns, title: str, rebuild: bool, failed: str) -> Compared:
    notes = [*usable.notes, *filter(None, [failed]), *untimed(usable.all)]
    study = Study(asked, replace(usable, notes=tuple(notes)))
    made_from, marker = _made_from(study), asked.folder / COMPARISON / "made_from.json"
    for_readers = None if rebuild else _kept(marker, made_from)
    if for_readers is None:
        for_readers = write_comparison(study, title)
        written = sorted(path.name for path in marker.parent.iterdir())
        write_json(marker, {**made_from, "for_readers": for_readers, "written": written})
    return Compared(study, tuple(for_readers))


def on_screen(compared: Compared, look: str) -> str:
    """What the terminal shows of a comparison: its table, its notes, who is best, where the report is, how to look.

    All of it but long paths fits into `analysis.SCREEN_COLUMNS`. How to `look` at the study is the last line.
    """
    study, folder = compared.study, compared.study.folder / COMPARISON
    notes = [f"Note: {note}" for note in (*compared.notes, *_verdicts_in_words(folder / "verdicts.csv"))]
    best = analysis.best_in_words(study.table, study.results.claims, study.reference)
    for_screen = [*shown_in(Shown.screen), analysis.ranked_by(study.table)]
    report = folder / "report.html"
    if report.is_relative_to(Path.cwd()):
        report = report.relative_to(Path.cwd())
    return "\n".join(
        [
            analysis.to_text(study.table[study.table["metric"].isin(for_screen)]),
            *(line for note in notes for line in wrap(note, SCREEN_COLUMNS, break_long_words=False)),
            *([""] if notes else []),
            *wrap(f"Best    {best}", SCREEN_COLUMNS, subsequent_indent=" " * 8, break_long_words=False),
            f"Report  {report}",
            f"Look    {look}",
        ]
    )


def _made_from(study: Study) -> dict[str, Any]:
    """What decides a comparison: the files of its runs and of times, the reference, what was left aside, bands, code.

    A run that was deleted and trained again has the same configuration and other files. Bands are those that it is
    judged by, whatever their files say meanwhile: the next command that reads others compares anew.
    """
    runs = {f"{run.name} of {run.data}": run.training.compared_state(run.score_names) for run in study.usable.all}
    titles = [head(metric) for metric in sorted(set(study.table["metric"]))]  # as far as this command knows
    return {
        "runs": runs,
        "times": digest_of_files([study.folder / TIMES]),
        "components": digest([repr(component) for component in study.results.components]),
        "metrics": titles,
        "code": loaded_digest(),
        "study": study.folder.name,
        "reference": study.reference,
        "notes": list(study.usable.notes),
    }


def _kept(marker: Path, made_from: Mapping[str, Any]) -> list[str] | None:
    """What a reader of the comparison on disk must know; None where a file lacks, or it is of something else."""
    content = known_json(marker)
    notes, written = content.pop("for_readers", None), content.pop("written", None)
    is_whole = written and content == made_from and all((marker.parent / name).exists() for name in written)
    return notes if is_whole else None


def _remove(folder: Path) -> None:
    """Remove a folder, or a link that somebody has put in its place."""
    if folder.is_symlink():
        folder.unlink()
    shutil.rmtree(folder, ignore_errors=True)


def write_comparison(study: Study, title: str) -> list[str]:
    """Write tables, figures and the report of a study; what was in its folder of comparison goes when all is written.

    Returns what a reader must know, a sentence each.
    """
    folder, usable = study.folder / COMPARISON, study.usable
    partial = folder.with_name(f"{folder.name}.partial")
    _remove(partial)
    partial.mkdir(parents=True)
    results, missing = _with_pictures(study)
    notes = [*usable.notes, *missing, *analysis.partly_scored(study.runs, {*results.table["metric"]} - {FRAME_TIME})]
    scale = analysis.scale_table(results.table)
    if len(scale):
        scale.rename_axis("variant").to_csv(partial / "scale.csv")
    analysis.write_report(
        partial / "report.html",
        results,
        title,
        figures=draw_figures(results, partial),
        notes=notes,
        left_out=_left_out(usable.all),
        provenance=provenance(usable.all),
    )
    analysis.wide_table(results.table).to_csv(partial / "table.csv", index=False)
    paper_rows = results.table[results.table["metric"].isin(shown_in(Shown.table))]
    (partial / "table.tex").write_text(analysis.to_latex(paper_rows, results.reference), "utf-8")
    tables = {
        "paired": results.paired,
        "claims": results.claims,
        "verdicts": results.verdicts,
        "runs": study.runs,
        "effects": results.effects,
    }
    for name, table in tables.items():
        if name != "effects" or len(table):
            table.to_csv(partial / f"{name}.csv", index=False)
    write_list(partial, study.listed)
    _remove(folder)
    partial.rename(folder)
    return [*notes, *analysis.cautions(results.per_image, results.reference, results.blocks)]


def _with_pictures(study: Study) -> tuple[StudyResults, list[str]]:
    """The results of a study with its pictures, or a sentence why there are none."""
    try:
        frames = study.pictures
    except (OSError, ValueError, LookupError) as error:  # pairs or pictures are missing or damaged
        return study.results, [f"There are no pictures: {' '.join(str(error).split())}."]
    missing = [] if frames else ["There are no pictures: the runs kept no frame in common."]
    return replace(study.results, pictures=frames), missing


def _verdicts_in_words(verdicts: Path) -> list[str]:
    """The verdicts of a file in a sentence; none where no run goes without a component."""
    table = pd.read_csv(verdicts)
    shown = table[table["effect"].notna()]
    words = [f"{c} {v.replace('_', ' ')}" for c, v in zip(shown["component"], shown["verdict"], strict=True)]
    return [f"Components: {', '.join(words)}."] if words else []


def _left_out(runs: Sequence[Run]) -> list[str]:
    """What was left out of this study, and why."""
    try:
        notes = list(runs[0].training.data_set.about["left_out"])
    except (OSError, ValueError, KeyError):
        notes = []  # the pairs have been deleted
    run_notes = [(str(note), run.name) for run in runs for note in run.notes]
    for note in dict.fromkeys(note for note, _ in run_notes):
        names = [name for other, name in run_notes if other == note]
        notes.append(note if len(names) == len(runs) else f"{listed(names)}: {note}")
    scored = {metric_in(name) for run in runs for name in run.score_names}
    unscored = [m.name for m in METRICS.values() if m.uses(FeatureKind.inception) and m.name not in scored]
    if unscored:
        how = "evaluation.inception=path/to/file or =download"
        notes.append(f"{listed(unscored)}: not computed, no Inception weights were given ({how}).")
    if not any(levels_of(run.identity).get("model.extra_input") == "low" for run in runs):
        notes.append("The low-quality image L: no variant of this study reads it, so it was not rendered.")
    return notes
