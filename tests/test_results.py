"""Kept results: small copies that bring a study back, and a page written from them."""

import importlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest

from ablate.comparison.usable_runs import levels_of
from ablate.metrics import METRICS
from ablate.runs.job import Job
from ablate.runs.place import claim_place, finished_run
from ablate.settings.conf import components
from ablate.storage import digest
from support.finished_runs import result_of
from support.studies import study_group

FRAMES, SITES = 8, 8
PLAN = ("answer", "answer_beside")
PER_IMAGE = [name for name, metric in METRICS.items() if metric.of_image or metric.of_draws]
SCALARS = ("fd_speckle", "kd_speckle")
EFFECT = 6.0  # on every metric of going without the attenuation map; twice the band
IMAGE = np.full((40, 60), 90, np.uint8)
PICTURED = {"lsa2h", "nsa2h", "sa2h", "sa2h-att", "sa2h-compensated", "sa2h-gan"}


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "scripts"))
    page = importlib.import_module("results_page")
    monkeypatch.setattr(page, "jobs_of", lambda words: study_group(words[0].removeprefix("+study=")))
    return importlib.import_module("results")


def jobs_in(runs: Path) -> list[Job]:
    """Every job of the two halves of the plan, each once."""
    jobs = {job.name: job for part in PLAN for job in study_group(part)}.values()
    return [replace(job, settings=replace(job.settings, runs_dir=str(runs))) for job in jobs]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> list[Job]:
    return jobs_in(tmp_path_factory.mktemp("study") / "runs")


@pytest.fixture(scope="module")
def whole(planned: list[Job]) -> Path:
    """The whole study, as if trained."""
    for job in planned:
        pretend(job)
    (planned[0].settings.study_dir / ".claim.lock").unlink()
    return planned[0].settings.study_dir


@pytest.fixture(scope="module")
def numbers(whole: Path) -> Any:
    """What its page is written from."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[1] / "scripts"))
        return importlib.import_module("results_page").numbers_of(whole)


@pytest.fixture
def study(whole: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may change."""
    return shutil.copytree(whole, tmp_path / "runs" / whole.name)


def pretend(job: Job) -> None:
    """Write the files of a finished run: chance about 20 in every metric, and 26 without the attenuation map."""
    s, rng = job.settings, np.random.default_rng(job.settings.seed)
    anatomy = s.scene.anatomy_seed
    mean = 20 + 5 * anatomy + rng.normal(scale=0.1) + EFFECT * (s.model.attenuation == "none")
    claim_place(job)
    rows = [
        {"frame": 300 + f, "site": f % SITES, "metric": m, "value": v + rng.normal(scale=0.01), "source": o, "split": p}
        for m in PER_IMAGE
        for o, v in (("model", mean), ("resimulation", 12.0 if METRICS[m].better != "higher" else 32.0))
        for p in ("test", "validation")
        for f in range(FRAMES)
    ]
    pd.DataFrame(rows).assign(variant=job.label, seed=s.seed).to_parquet(job.folder / "per_image.parquet")
    np.savez(job.folder / "pictures.npz", frames=[300, 310], images=[IMAGE, IMAGE // 2])
    scalars = {"parameters_generator": 1e6, "parameters_discriminator": 2e6, "seconds": 30.0}
    scalars |= {f"test/{name}": 0.5 + 0.01 * mean for name in SCALARS}
    scalars |= {f"test/floor_{name}": 0.1 for name in SCALARS}
    result = result_of(job, data=f"fetal-{anatomy}", scalars=scalars)
    (job.folder / "result.json").write_text(json.dumps(result))
    (job.folder / "provenance").mkdir()
    made_with = {"git_commit": "0123456789", "git_dirty": "false", "hardware": f"machine {anatomy}"}
    (job.folder / "provenance" / "made_with.json").write_text(json.dumps(made_with))
    (job.folder / "last.ckpt").write_text("weights")


def keep_frame(kept: Path) -> None:
    maps = {"target": IMAGE, "resimulation": IMAGE, "segmentation": IMAGE // 90, "mask": IMAGE > 0}
    np.savez(kept / "answer" / "frame.npz", number=300, **maps)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def rows_of(text: str, heading: str) -> dict[str, list[str]]:
    """The first table below a heading: cells by the first cell, or by the first two where the first repeats."""
    lines = text.split(heading, 1)[1].split("\n")
    start = next(k for k, line in enumerate(lines) if line.startswith("|"))
    rows: dict[str, list[str]] = {}
    for line in lines[start:]:
        if not line.startswith("|"):
            break
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        rows[cells[0] if cells[0] not in rows else f"{cells[0]} {cells[1]}"] = cells
    return rows


def test_what_is_kept_is_small_whole_and_without_the_machine(study: Path, script: ModuleType, tmp_path: Path) -> None:
    lines = script.keep(study, tmp_path / "kept")
    assert lines.count("kept sa2h/seed0") == 1
    assert sum(line.startswith("kept ") for line in lines) == 49
    assert any(line.startswith("no picture of the target is kept") for line in lines), "its pairs are not on disk"
    folder = tmp_path / "kept" / study.name
    run = folder / "sa2h-att" / "seed1"
    assert set(contents(run)) == {"spec.json", "result.json", "per_image.parquet", "provenance/made_with.json"}
    assert str(study.parents[1]) not in (run / "spec.json").read_text(), "no path of this machine"
    original, kept = (pd.read_parquet(f / "per_image.parquet") for f in (study / "sa2h-att" / "seed1", run))
    pd.testing.assert_frame_equal(kept, original, check_dtype=False, rtol=1e-6)
    assert kept["value"].dtype == "float32"
    pictured = {path.parts[-3]: path for path in folder.glob("*/seed*/pictures.npz")}
    assert pictured.keys() == PICTURED, "cells of the factorial are in no picture"
    assert {path.parent.name for path in pictured.values()} == {"seed0"}
    with np.load(pictured["sa2h-att"]) as shown:
        assert shown["frames"].tolist() == [300]
    before = contents(tmp_path / "kept")
    assert not any(line.startswith("kept ") for line in script.keep(study, tmp_path / "kept")), "a second time"
    assert contents(tmp_path / "kept") == before


def test_a_study_is_kept_in_pieces_from_several_machines(study: Path, script: ModuleType, tmp_path: Path) -> None:
    other = shutil.copytree(study, tmp_path / "other" / study.name)
    labels = sorted(folder.name for folder in study.iterdir())
    for label in labels[:20]:
        shutil.rmtree(study / label)
    for label in labels[20:]:
        shutil.rmtree(other / label)
    script.keep(study, tmp_path / "kept")
    script.keep(other, tmp_path / "kept")
    assert len(list((tmp_path / "kept" / study.name).glob("*/seed*/result.json"))) == 49


def test_a_restored_study_has_nothing_left_to_do(study: Path, script: ModuleType, tmp_path: Path) -> None:
    script.keep(study, tmp_path / "kept")
    (study / "sa2h" / "seed2" / "result.json").write_text("{}")
    (study / "sa2h" / "seed1" / "result.json").unlink()
    for name in ("spec.json", "result.json"):
        (study / "nsa2h" / "seed0" / name).unlink()
        (study / "lsa2h" / "seed0" / name).unlink()
    (study / "lsa2h" / "seed0" / "spec.json").write_text('{"hash": "another"}')
    shutil.rmtree(study / "sa2h-att")
    lines = script.restore(tmp_path / "kept", tmp_path / "runs")
    back = {line.split()[-1] for line in lines if line.startswith("restored")}
    anew = ("nsa2h/seed0", "sa2h/seed1", *(f"sa2h-att/seed{k}" for k in range(3)))
    assert back == {f"answer/{name}" for name in anew}, "also what was started and has not finished"
    assert f"there already: {study.name}/sa2h/seed2" in lines, "what is there is not touched"
    assert f"there already: {study.name}/lsa2h/seed0" in lines, "another configuration is not touched"
    left = [job.name for job in jobs_in(tmp_path / "runs") if finished_run(job) is None]
    assert left == ["sa2h/seed2", "lsa2h/seed0"]
    assert (study / "sa2h-att" / "seed0" / "provenance" / "made_with.json").exists()


def test_the_page_of_a_whole_study(study: Path, script: ModuleType, tmp_path: Path) -> None:
    kept, page = tmp_path / "results", tmp_path / "results.md"
    script.keep(study, kept)
    keep_frame(kept)
    markers = importlib.import_module("results_page")
    page.write_text(f"Before.\n{markers.BEGIN}\nold\n{markers.END}\nAfter.\n")
    script.write_page(kept, page)
    text = page.read_text()
    assert text.startswith(f"Before.\n{markers.BEGIN}")
    assert text.endswith(f"{markers.END}\nAfter.\n")
    assert "\nold\n" not in text
    assert text.count("## answer\n") == 1
    assert "49 of 49 runs are finished." in text
    assert "preliminary" not in text
    assert "machine 0 (33 runs); machine 1 (16 runs)" in text
    assert "nan" not in text.lower()
    for name in ("qualitative", "verdicts"):
        assert f"![{name}](results/answer/{name}.png)" in text
        assert (kept / "answer" / f"{name}.png").stat().st_size > 5_000
    for line in text.splitlines():
        assert not line.startswith("|") or line.endswith("|")

    stored = pd.read_csv(kept / "answer" / "verdicts.csv").set_index("component")
    assert list(stored.reset_index().columns[:10]) == (
        ["component", "metric", "effect", "lower", "upper", "band", "runs_a", "runs_b", "p_holm", "verdict"]
    )
    assert stored.loc["att", "verdict"] == "earns"
    assert stored.loc["depth", "verdict"] == "does_not", "chance, far below the band"
    shown = rows_of(text, "verdicts.png)")
    assert set(shown) - {"component", "---"} == {component.name for component in components()}
    for name, row in stored.iterrows():
        assert shown[str(name)][2].strip("*") == row["verdict"].replace("_", " ")
    switched = ["att", "concat", "conv", "noise", "depth", "encoding"]
    assert stored.loc[switched, "p_holm"].notna().all()
    assert stored.loc["loss", "verdict"] == "does_not", "sa2h-gan stands beside the design: chance too"
    assert set(stored.drop([*switched, "loss"])["verdict"]) == {"undecided"}, "no run goes without them"

    runs = rows_of(text, "### The runs beside the design")
    assert set(runs) == PICTURED | {"variant", "---", "re-simulation"}
    assert {row[1] for name, row in runs.items() if name in PICTURED} == {"3"}


def test_bars_and_living_noise(numbers: Any, script: ModuleType) -> None:
    page, tables = importlib.import_module("results_page"), importlib.import_module("results_tables")
    assert script is not None
    rows = rows_of(f"x\n{tables.shortfalls(numbers.beside, ('sa2h', 'sa2h-compensated'))}", "x")
    means = numbers.beside.pivot(index="metric", columns="variant", values="mean")
    ratio = means.loc["mae_smooth", "sa2h"] / means.loc["mae_smooth", "re-simulation"]
    smooth = next(row for name, row in rows.items() if name.startswith("Smooth MAE"))
    assert smooth[5] == f"{ratio:.2f}"
    assert 1.5 < ratio < 2.5
    assert smooth[2] == "sa2h, sa2h-compensated"
    assert next(row for name, row in rows.items() if name.startswith("FD speckle"))[2] == "sa2h, sa2h-compensated"
    worse = numbers.beside.copy()
    worse.loc[(worse["metric"] == "mae_smooth") & (worse["variant"] == "sa2h"), "mean"] *= 2
    rows = rows_of(f"x\n{tables.shortfalls(worse, ('sa2h', 'sa2h-compensated'))}", "x")
    assert next(row for name, row in rows.items() if name.startswith("Smooth MAE"))[2] == "sa2h-compensated"
    text = "\n".join(page.beside_lines(numbers))
    differences = rows_of(text, "can exceed.")
    place = next(k for k, title in enumerate(differences["variant"]) if title.startswith("MAE"))
    shift = means.loc["mae", "sa2h-att"] - means.loc["mae", "sa2h"]
    assert differences["sa2h-att"][place] == f"**+{shift:.2f}**"
    assert differences["sa2h-gan"][place] == "0.00"
    injecting = [run for run in numbers.usable.all if levels_of(run.spec["semantic"])["model.noise"] == "inject"]
    assert f"{len(injecting)} runs inject noise." in text


def test_verdicts_of_an_unfinished_design_are_preliminary(study: Path, script: ModuleType, tmp_path: Path) -> None:
    kept, page = tmp_path / "results", tmp_path / "results.md"
    cells = sorted(study.glob("*.*/seed*"), key=lambda folder: int(folder.name.removeprefix("seed")))
    for cell in cells[-4:]:
        (cell / "result.json").unlink()
    script.keep(study, kept)
    script.write_page(kept, page)
    text = page.read_text()
    assert "45 of 49 runs are finished: 28 of the 32 runs of the design. **All verdicts are preliminary.**" in text
    words = [row[2] for row in rows_of(text, "verdicts.png)").values()][2:]
    assert all(word.endswith("(preliminary)") for word in words)
    assert "nan" not in text.lower()


@pytest.mark.parametrize("labels", [("sa2h",), ("sa2h", "nsa2h"), ("nsa2h",)])
def test_a_page_is_made_of_whatever_has_finished(
    study: Path, script: ModuleType, tmp_path: Path, labels: Sequence[str]
) -> None:
    for folder in study.iterdir():
        if folder.name not in labels:
            shutil.rmtree(folder)
    script.keep(study, tmp_path / "results")
    script.write_page(tmp_path / "results", tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text()
    assert f"{3 * len(labels)} of 49 runs are finished" in text
    assert "earns**" not in text
    assert "nan" not in text.lower().replace("nsa2h", "")


def test_what_cannot_be_kept_or_shown_is_refused(study: Path, script: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no finished run"):
        script.keep(tmp_path / "nowhere", tmp_path / "kept")
    with pytest.raises(ValueError, match="holds no study"):
        script.write_page(tmp_path / "kept", tmp_path / "page.md")
    script.keep(study, tmp_path / "kept")
    (tmp_path / "page.md").write_text("No markers.")
    with pytest.raises(ValueError, match="lacks the markers"):
        script.write_page(tmp_path / "kept", tmp_path / "page.md")
    folder = study / "sa2h" / "seed0"
    spec, result = (json.loads((folder / name).read_text()) for name in ("spec.json", "result.json"))
    spec["semantic"]["training"]["steps"] += 1
    spec["hash"] = result["hash"] = digest(spec["semantic"])
    (folder / "spec.json").write_text(json.dumps(spec))
    (folder / "result.json").write_text(json.dumps(result))
    with pytest.raises(ValueError, match=r"another configuration of sa2h/seed0"):
        script.keep(study, tmp_path / "kept")
