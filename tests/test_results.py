"""Kept results: small copies that bring a study back, and a page written from them."""

import importlib
import json
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from ablate.config import json_ready
from ablate.metrics import METRICS_VERSION
from ablate.studies.identity import config_hash, finished, semantic
from ablate.studies.jobs.compose import jobs_of

FRAMES, SITES = 24, 8
SWEEP = ["-m", "variant=sa2h,sa2h-att", "seed=0,1,2"]
IMAGE = np.full((40, 60), 90, np.uint8)


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "scripts"))
    return importlib.import_module("results")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """Every run of a sweep, as if trained."""
    rng = np.random.default_rng(0)
    jobs = jobs_of([*SWEEP, f"runs_dir={tmp_path}/runs"])
    for job in jobs:
        job.folder.mkdir(parents=True)
        spec = {"label": job.label, "hash": config_hash(job.settings), "semantic": semantic(job.settings)}
        (job.folder / "spec.json").write_text(json.dumps({**spec, "settings": json_ready(job.settings)}))
        rows = [
            {"frame": 300 + f, "site": f % SITES, "metric": m, "value": 20 + k + rng.normal(), "source": s, "split": p}
            for k, m in enumerate(("psnr", "mae", "pchi2"))
            for s in ("model", "resimulation")
            for p in ("test", "validation")
            for f in range(FRAMES)
        ]
        table = pd.DataFrame(rows).assign(variant=job.label, seed=job.settings.seed)
        table.to_parquet(job.folder / "per_image.parquet")
        np.savez(job.folder / "pictures.npz", frames=[300, 310], images=[IMAGE, IMAGE // 2])
        scalars = {"parameters_generator": 1e6, "parameters_discriminator": 2e6, "ms_per_frame": 30.0}
        result = {"hash": spec["hash"], "label": job.label, "seed": job.settings.seed, "data": "fetal-0"}
        result |= {"metrics": ["all"], "metrics_version": METRICS_VERSION, "inception": None}
        (job.folder / "result.json").write_text(json.dumps({**result, "mlflow_run_id": "x", "scalars": scalars}))
    return jobs[0].settings.study_dir


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_kept_is_small_whole_and_without_the_machine(study: Path, script: ModuleType, tmp_path: Path) -> None:
    said = script.keep(study, tmp_path / "kept")
    assert said.count("kept sa2h/seed0") == 1
    assert sum(line.startswith("kept ") for line in said) == 6
    assert any(line.startswith("no picture of the target is kept") for line in said), "its pairs are not on disk"
    run = tmp_path / "kept" / study.name / "sa2h-att" / "seed1"
    assert {path.name for path in run.iterdir()} == {"spec.json", "result.json", "per_image.parquet"}
    assert str(tmp_path) not in (run / "spec.json").read_text(), "no path of this machine"
    original, kept = (pd.read_parquet(f / "per_image.parquet") for f in (study / "sa2h-att" / "seed1", run))
    pd.testing.assert_frame_equal(kept, original, check_dtype=False, rtol=1e-6)
    assert kept["value"].dtype == "float32"
    with np.load(run.parents[1] / "sa2h-att" / "seed0" / "pictures.npz") as shown:
        assert shown["frames"].tolist() == [300]
    before = contents(tmp_path / "kept")
    assert not any(line.startswith("kept ") for line in script.keep(study, tmp_path / "kept")), "a second time"
    assert contents(tmp_path / "kept") == before


def test_a_restored_study_has_nothing_left_to_do(study: Path, script: ModuleType, tmp_path: Path) -> None:
    script.keep(study, tmp_path / "kept")
    (study / "sa2h" / "seed2" / "result.json").write_text("{}")
    shutil.rmtree(study / "sa2h-att")
    said = script.restore(tmp_path / "kept", tmp_path / "runs")
    assert sum(line.startswith("restored") for line in said) == 3
    assert f"there already: {study.name}/sa2h/seed2" in said, "what is there is not touched"
    jobs = jobs_of([*SWEEP, f"runs_dir={tmp_path}/runs"])
    assert [job.name for job in jobs if finished(job) is None] == ["sa2h/seed2"]


def test_the_page_is_written_between_its_markers(study: Path, script: ModuleType, tmp_path: Path) -> None:
    kept, page = tmp_path / "results", tmp_path / "results.md"
    script.keep(study, kept)
    maps = {"target": IMAGE, "resimulation": IMAGE, "segmentation": IMAGE // 90, "mask": IMAGE > 0}
    np.savez(kept / study.name / "frame.npz", number=300, **maps)
    script.write_page(kept, page)
    page.write_text(f"Before.\n{page.read_text()}\nAfter.\n")
    script.write_page(kept, page)
    text = page.read_text()
    assert text.startswith("Before.\n# Results")
    assert text.endswith("\nAfter.\n")
    assert text.count("## quick-fetal") == 1
    for name in ("qualitative", "boxplots", "seeds"):
        assert f"![{name}](results/quick-fetal/{name}.png)" in text
        assert (kept / "quick-fetal" / f"{name}.png").stat().st_size > 5_000
    for line in text.splitlines():
        assert not line.startswith("|") or line.endswith("|")
    assert "| sa2h | 3 |" in text
    assert "nan" not in text.lower()
    page.write_text("No markers.")
    with pytest.raises(ValueError, match="lacks the markers"):
        script.write_page(kept, page)


@pytest.mark.usefixtures("script")
def test_networks_with_the_same_change_are_also_compared_with_each_other() -> None:
    families = importlib.import_module("results_page").families
    labels = ["re-simulation", "sa2h", "nsa2h", "sa2h.encoding-arbitrary", "nsa2h.encoding-arbitrary", "sa2h.depth-2"]
    assert families(labels) == {"sa2h": labels, "sa2h.encoding-arbitrary": labels[3:5]}


def test_what_cannot_be_kept_or_shown_is_refused(study: Path, script: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no finished run"):
        script.keep(tmp_path / "nowhere", tmp_path / "kept")
    with pytest.raises(ValueError, match="holds no study"):
        script.write_page(tmp_path / "kept", tmp_path / "page.md")
    script.keep(study, tmp_path / "kept")
    for name in ("spec.json", "result.json"):
        path = study / "sa2h" / "seed0" / name
        path.write_text(json.dumps(json.loads(path.read_text()) | {"hash": "another"}))
    with pytest.raises(ValueError, match=r"another configuration of sa2h/seed0"):
        script.keep(study, tmp_path / "kept")
