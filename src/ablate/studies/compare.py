"""The comparison of a study: from what is on disk to tables, figures, a report and the parent run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ablate.analysis import (
    RESIMULATION,
    Picture,
    comparison_table,
    console_table,
    paired_table,
    seed_claims,
    write_comparison,
)
from ablate.config import StudySettings
from ablate.dataset import open_pairs
from ablate.studies.identity import read_result
from ablate.studies.tracked import open_tracking
from ablate.tracking import RunLog, Status, git_state, hardware

_ONCE_A_STUDY = ("ms_per_frame",)


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


def compare_study(settings: StudySettings, rebuild: bool) -> str:
    """Compare the finished runs of a study, write everything beside them and onto the parent run.

    Parameters
    ----------
    settings : StudySettings
    rebuild : bool
        False takes the tables and figures of the last time when they are there.

    Returns
    -------
    str
        The comparison for the screen, with where to look next.
    """
    folder = settings.study_dir / "comparison"
    runs = finished_runs(settings.study_dir)
    if not runs:
        return f"{settings.study_dir}: no finished run to compare"
    per_image, scalars = _tables(runs)
    if rebuild or not (folder / "report.html").exists():
        _write(settings, runs, per_image, scalars, folder)
    where = f"report    {folder / 'report.html'}\nMLflow    {_ui_command(settings)}"
    return f"{console_table(comparison_table(per_image, scalars, settings.reference))}\n\n{where}"


def _tables(runs: list[Finished]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Test values of every run, one row a frame and metric and one row a run and scalar; re-simulation once."""
    frames, scalars = [], []
    for i, run in enumerate(runs):
        table = pd.read_parquet(run.folder / "per_image.parquet")
        table = table[table["split"] == "test"]
        frames.append(table[table["source"] == "model"])
        if i == 0:
            frames.append(table[table["source"] == "floor"].assign(variant=RESIMULATION))
        per_image_metrics = set(table["metric"])
        values: dict[str, float] = run.result["scalars"]
        for name, value in values.items():
            part, _, metric = name.rpartition("/")
            floor = metric.startswith("floor_")
            metric = metric.removeprefix("floor_")
            if metric in per_image_metrics or metric == "identical_frames":
                continue
            if part == "test" and (i == 0 or not floor):
                variant = RESIMULATION if floor else run.label
                scalars.append({"variant": variant, "seed": run.seed, "metric": metric, "value": value})
            elif name in _ONCE_A_STUDY:
                scalars.append({"variant": run.label, "seed": run.seed, "metric": name, "value": value})
        parameters = values["parameters_generator"] + values["parameters_discriminator"]
        scalars.append({"variant": run.label, "seed": run.seed, "metric": "parameters", "value": parameters})
    return pd.concat(frames, ignore_index=True), pd.DataFrame(scalars)


def _write(
    settings: StudySettings, runs: list[Finished], per_image: pd.DataFrame, scalars: pd.DataFrame, folder: Path
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    paired = paired_table(per_image, settings.reference)
    store, parent = open_tracking(settings)
    code = git_state(Path(__file__).parent)
    provenance = {
        "study": settings.study,
        "data": runs[0].result["data"],
        "commit": code.get("git_commit", "not a checkout"),
        "uncommitted changes": code.get("git_dirty", "unknown"),
        "hardware": hardware(),
    }
    written = write_comparison(
        folder,
        per_image=per_image,
        scalars=scalars,
        paired=paired,
        claims=seed_claims(per_image, settings.reference),
        pictures=_pictures(settings, runs),
        reference=settings.reference,
        provenance=provenance,
        left_out=_left_out(settings),
    )
    run = RunLog(store, parent)
    for path in written:
        run.artifact(path)
    run.tags({k: v for k, v in provenance.items() if k != "study"})
    run.end(Status.finished)


def _pictures(settings: StudySettings, runs: list[Finished]) -> list[Picture]:
    """The frames every variant shows, with target, maps and re-simulation; the lowest seed speaks for a variant."""
    chosen: dict[str, Finished] = {}
    for run in sorted(runs, key=lambda r: r.seed):
        chosen.setdefault(run.label, run)
    stored = {label: np.load(run.folder / "pictures.npz") for label, run in chosen.items()}
    frames = next(iter(stored.values()))["frames"]
    pairs = open_pairs(settings.runs / "data" / f"{settings.scene_name}-{runs[0].result['data']}")
    maps = {name: pairs.read(name, frames) for name in ("segmentation", "attenuation", "high", "high_again")}
    return [
        Picture(
            name=f"frame {frame}",
            segmentation=maps["segmentation"][k],
            attenuation=maps["attenuation"][k],
            target=maps["high"][k],
            resimulation=maps["high_again"][k],
            outputs={label: images["images"][k] for label, images in stored.items()},
        )
        for k, frame in enumerate(frames)
    ]


def _left_out(settings: StudySettings) -> list[str]:
    """What this study did without, and why."""
    return [
        "FID and KID: no Inception weights were given; fd_speckle and kd_speckle are the same distances on a "
        "texture descriptor without weights, and do not compare with published FID values.",
    ]


def _ui_command(settings: StudySettings) -> str:
    from ablate.tracking import default_uri

    uri = settings.tracking.uri or default_uri(settings.runs)
    return f"mlflow ui --backend-store-uri {uri}   (make ui)"
