"""The comparison of a study: from what is on disk to tables, figures, a report and the parent run."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ablate.analysis import (
    RESIMULATION,
    FramePictures,
    cautions,
    chi2_maps_figure,
    comparison_table,
    error_vs_runtime,
    paired_boxplots,
    paired_table,
    qualitative_figure,
    seed_claims,
    to_latex,
    to_text,
    wide_table,
    write_report,
)
from ablate.config import StudySettings
from ablate.studies.data import open_data
from ablate.studies.identity import read_result, write_json
from ablate.studies.sweep import ConfigurationError
from ablate.studies.tracked import open_tracking
from ablate.tracking import RunLog, Status, default_uri, git_state, hardware

_SCREEN = ("psnr", "mae", "pchi2", "fd_speckle", "shadow_contrast", "mae_smooth", "noise_sd", "ms_per_frame")
_BOXPLOTS = ("psnr", "mae", "pchi2")  # Fig. 4 of the paper; every metric has its own picture
_TABLE_II = ("psnr", "mae", "pchi2", "fd_speckle", "fid", "parameters")
_TIMED = ("psnr", "mae", "pchi2", "fd_speckle")


@dataclass(frozen=True)
class Finished:
    """A finished run as it lies on disk."""

    folder: Path
    spec: dict[str, Any]
    result: dict[str, Any]

    @property
    def label(self) -> str:
        return str(self.result["label"])

    @property
    def seed(self) -> int:
        return int(self.result["seed"])


def finished_runs(study_dir: Path) -> list[Finished]:
    """Every run of a study whose result belongs to its configuration."""
    runs = []
    for path in sorted(study_dir.glob("*/seed*/spec.json")):
        spec = json.loads(path.read_text())
        result = read_result(path.parent, spec["hash"])
        if result is not None:
            runs.append(Finished(path.parent, spec, result))
    return runs


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
    per_image, scalars = _tables(runs)
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
    return f"{to_text(table[table['metric'].isin(_SCREEN)])}\n{warnings}\n\n{where}"


def _tables(runs: list[Finished]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Test values of every run, one row a frame and metric and one row a run and scalar; re-simulation once."""
    frames, scalars = [], []
    for i, run in enumerate(runs):
        table = pd.read_parquet(run.folder / "per_image.parquet")
        table = table[table["split"] == "test"]
        frames.append(table[table["source"] == "model"])
        floor = table[table["source"] == "floor"]
        if i == 0 and len(floor):
            frames.append(floor.assign(variant=RESIMULATION))
        per_image_metrics = set(table["metric"])
        values: dict[str, float] = run.result["scalars"]
        for name, value in values.items():
            part, _, metric = name.rpartition("/")
            is_floor = metric.startswith("floor_")
            metric = metric.removeprefix("floor_")
            if metric in per_image_metrics:
                continue
            if part == "test" and (i == 0 or not is_floor):
                variant = RESIMULATION if is_floor else run.label
                scalars.append({"variant": variant, "seed": run.seed, "metric": metric, "value": value})
            elif name == "ms_per_frame":
                scalars.append({"variant": run.label, "seed": run.seed, "metric": name, "value": value})
        parameters = values["parameters_generator"] + values["parameters_discriminator"]
        scalars.append({"variant": run.label, "seed": run.seed, "metric": "parameters", "value": parameters})
    return pd.concat(frames, ignore_index=True), pd.DataFrame(scalars)


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
    code = git_state(Path(__file__).parent)
    provenance = {
        "data": runs[0].result["data"],
        "git_commit": code.get("git_commit", "not a checkout"),
        "git_dirty": code.get("git_dirty", "unknown"),
        "hardware": hardware(),
    }
    report = write_report(
        folder / "report.html",
        settings.study,
        per_image,
        table,
        paired,
        claims=seed_claims(per_image, reference),
        figures=[(path, caption) for path, caption in figures if path.suffix == ".png"],
        left_out=[*open_data(_data_folder(settings, runs)).left_out, *_left_out(runs)],
        provenance=provenance,
        reference=reference,
    )
    store, parent = open_tracking(settings)
    run = RunLog(store, parent)
    for path in (report, folder / "table.csv", folder / "table.tex", folder / "paired.csv", *(f for f, _ in figures)):
        run.artifact(path, "vector" if path.suffix == ".pdf" else None)
    run.tags(provenance)
    shown = to_text(table[table["metric"].isin(_SCREEN)])
    run.describe(f"```\n{shown}\n```\nThe whole report: Artifacts, `report.html`.")
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
    frames = _pictures(settings, runs)
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
    points, floors = _runtime_points(table)
    if len(points):
        stem = folder / "error_vs_runtime"
        made += [(p, "Error against run time.") for p in error_vs_runtime(points, stem, floors, hardware())]
    return made


def _runtime_points(table: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, float]]:
    """Error of every variant against its milliseconds a frame, and the re-simulation's value by metric."""
    means = table.pivot(index="variant", columns="metric", values="mean")
    networks = means.drop(index=RESIMULATION, errors="ignore")
    metrics = [m for m in _TIMED if m in means.columns]
    rows = [
        {"series": v, "setting": "", "ms": networks.loc[v, "ms_per_frame"], "metric": m, "error": networks.loc[v, m]}
        for v in networks.index
        for m in metrics
    ]
    floors = {m: float(means[m].to_dict()[RESIMULATION]) for m in metrics} if RESIMULATION in means.index else {}
    return pd.DataFrame(rows), floors


def _pictures(settings: StudySettings, runs: list[Finished]) -> list[FramePictures]:
    """The frames every variant shows, with target, maps and, where it is, the re-simulation; the lowest seed speaks
    for a variant.
    """
    chosen: dict[str, Finished] = {}
    for run in sorted(runs, key=lambda r: (r.label != settings.reference, r.label, r.seed)):
        chosen.setdefault(run.label, run)
    stored = {label: _stored_pictures(run) for label, run in chosen.items()}
    numbers = sorted(set.intersection(*(set(images) for images in stored.values())))
    pairs = open_data(_data_folder(settings, runs)).pairs
    maps = {name: pairs.read(name, numbers) for name in pairs.maps - {"low"}}
    return [
        FramePictures(
            name=f"frame {number}",
            target=maps["high"][k],
            predictions={
                **({RESIMULATION: maps["high_again"][k]} if "high_again" in maps else {}),
                **{v: s[number] for v, s in stored.items()},
            },
            mask=pairs.mask(),
            segmentation=maps["segmentation"][k],
            attenuation=maps["attenuation"][k] if "attenuation" in maps else None,
        )
        for k, number in enumerate(numbers)
    ]


def _stored_pictures(run: Finished) -> dict[int, np.ndarray]:
    """The frames that a run kept, by their number in the data set."""
    with np.load(run.folder / "pictures.npz") as kept:
        return dict(zip(kept["frames"].tolist(), kept["images"], strict=True))


def _data_folder(settings: StudySettings, runs: list[Finished]) -> Path:
    return settings.runs / "data" / str(runs[0].result["data"])


def _left_out(runs: list[Finished]) -> list[str]:
    """What this study did without, and why."""
    said = [
        "FID and KID: no Inception weights were given; fd_speckle and kd_speckle are the same distances on a "
        "texture descriptor without weights, and do not compare with published FID values."
    ]
    if not any(run.spec["settings"]["model"]["extra_input"] == "low" for run in runs):
        said.append("The low-quality image L: no variant of this study reads it, so it was not rendered.")
    return said
