"""Kept results: small copies that bring a study back, and a page written from them."""

import importlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from ablate.runs.place import claim_place, finished_run

from ablate import open_study
from ablate.metrics import METRICS
from ablate.settings.conf import components
from ablate.storage import digest, write_json
from ablate.study.job import Job
from support.finished_runs import result_of
from support.studies import study_group

FRAMES, SITES = 8, 8
PLAN = ("full_model", "full_model_beside")
RUNS, OF_DESIGN = 61, 52
PER_IMAGE = [name for name, metric in METRICS.items() if metric.of_image or metric.of_draws]
SCALARS = ("fd_speckle", "kd_speckle")
EFFECT = 6.0  # on every metric of going without the attenuation map; twice the band
IMAGE = np.full((40, 60), 90, np.uint8)
PRINTED = "sa2h-printed.crop-0.reconstruction-l1"


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


@pytest.fixture
def study(whole: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may change."""
    return shutil.copytree(whole, tmp_path / "runs" / whole.name)


def pretend(job: Job) -> None:
    """Write the files of a finished run: chance about 20 in every metric, and 26 without the attenuation map.

    In the second anatomy both are 5 more.
    """
    s, rng = job.settings, np.random.default_rng(job.settings.seed)
    anatomy = s.scene.anatomy_seed
    mean = 5 + 5 * anatomy + rng.normal(scale=0.1) + EFFECT * (s.model.attenuation == "none")
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
    scalars |= {f"test/{name}": mean for name in PER_IMAGE} | {f"test/floor_{name}": 12.0 for name in PER_IMAGE}
    scalars |= {f"test/floor_{name}": 0.1 for name in SCALARS}
    result = result_of(job, data=f"fetal-{anatomy}", scalars=scalars)
    (job.folder / "result.json").write_text(json.dumps(result))
    (job.folder / "provenance").mkdir()
    made_with = {"git_commit": "0123456789", "git_dirty": "false", "hardware": f"machine {anatomy}"}
    (job.folder / "provenance" / "made_with.json").write_text(json.dumps(made_with))
    (job.folder / "last.ckpt").write_text("weights")


def keep_frame(kept: Path) -> None:
    maps = {"target": IMAGE, "resimulation": IMAGE, "segmentation": IMAGE // 90, "mask": IMAGE > 0}
    np.savez(kept / "full_model" / "frame.npz", number=300, **maps)


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
    assert sum(line.startswith("kept ") for line in lines) == RUNS
    assert any(line.startswith("no picture of the target is kept") for line in lines), "its pairs are not on disk"
    folder = tmp_path / "kept" / study.name
    run = folder / "sa2h.attenuation-none" / "seed1"
    assert set(contents(run)) == {"spec.json", "result.json", "per_image.parquet", "provenance/made_with.json"}
    assert str(study.parents[1]) not in (run / "spec.json").read_text(), "no path of this machine"
    of_both = (study / "sa2h.attenuation-none" / "seed1", run)
    original, kept = (pd.read_parquet(f / "per_image.parquet") for f in of_both)
    pd.testing.assert_frame_equal(kept, original, check_dtype=False, rtol=1e-6)
    assert kept["value"].dtype == "float32"
    pictured = {path.parts[-3]: path for path in folder.glob("*/seed*/pictures.npz")}
    assert pictured.keys() == {path.name for path in study.iterdir() if "anatomy" not in path.name}
    assert {path.parent.name for path in pictured.values()} == {"seed0"}
    with np.load(pictured["sa2h.attenuation-none"]) as shown:
        assert shown["frames"].tolist() == [300]
    before = contents(tmp_path / "kept")
    assert not any(line.startswith("kept ") for line in script.keep(study, tmp_path / "kept")), "a second time"
    assert contents(tmp_path / "kept") == before
    result = json.loads((study / "sa2h" / "seed1" / "result.json").read_text())
    write_json(study / "sa2h" / "seed1" / "result.json", {**result, "ended": "2031-01-01T00:00:00+00:00"})
    again = [line for line in script.keep(study, tmp_path / "kept") if line.startswith("kept ")]
    assert again == ["kept sa2h/seed1"], "trained or scored again"


def test_a_study_is_kept_in_pieces_from_several_machines(study: Path, script: ModuleType, tmp_path: Path) -> None:
    other = shutil.copytree(study, tmp_path / "other" / study.name)
    labels = sorted(folder.name for folder in study.iterdir())
    for label in labels[:12]:
        shutil.rmtree(study / label)
    for label in labels[12:]:
        shutil.rmtree(other / label)
    script.keep(study, tmp_path / "kept")
    script.keep(other, tmp_path / "kept")
    assert len(list((tmp_path / "kept" / study.name).glob("*/seed*/result.json"))) == RUNS


def test_a_restored_study_has_nothing_left_to_do(study: Path, script: ModuleType, tmp_path: Path) -> None:
    script.keep(study, tmp_path / "kept")
    (study / "sa2h" / "seed2" / "result.json").write_text("{}")
    (study / "sa2h" / "seed1" / "result.json").unlink()
    for name in ("spec.json", "result.json"):
        (study / "nsa2h" / "seed0" / name).unlink()
        (study / "lsa2h" / "seed0" / name).unlink()
    (study / "lsa2h" / "seed0" / "spec.json").write_text('{"hash": "another"}')
    shutil.rmtree(study / PRINTED)
    lines = script.restore(tmp_path / "kept", tmp_path / "runs")
    back = {line.split()[-1] for line in lines if line.startswith("restored")}
    anew = ("nsa2h/seed0", "sa2h/seed1", *(f"{PRINTED}/seed{k}" for k in range(3)))
    assert back == {f"full_model/{name}" for name in anew}, "also what was started and has not finished"
    assert f"there already: {study.name}/sa2h/seed2" in lines, "what is there is not touched"
    assert f"there already: {study.name}/lsa2h/seed0" in lines, "another configuration is not touched"
    left = [job.name for job in jobs_in(tmp_path / "runs") if finished_run(job) is None]
    assert left == ["sa2h/seed2", "lsa2h/seed0"]
    assert (study / PRINTED / "seed0" / "provenance" / "made_with.json").exists()


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
    assert text.count("## full_model\n") == 1
    assert f"{RUNS} of {RUNS} runs are finished." in text
    assert "preliminary" not in text
    assert "machine 3 (35 runs); machine 4 (26 runs)" in text
    assert "nan" not in text.lower()
    for name in ("qualitative", "verdicts"):
        assert f"![{name}](results/full_model/{name}.png)" in text
        assert (kept / "full_model" / f"{name}.png").stat().st_size > 5_000
    for line in text.splitlines():
        assert not line.startswith("|") or line.endswith("|")

    stored = pd.read_csv(kept / "full_model" / "verdicts.csv").set_index("component")
    assert list(stored.reset_index().columns[:10]) == (
        ["component", "metric", "effect", "lower", "upper", "band", "runs_a", "runs_b", "p_holm", "verdict"]
    )
    assert stored.loc["att", "verdict"] == "earns"
    assert stored.loc["depth", "verdict"] == "does_not", "chance, far below the band"
    shown = rows_of(text, "verdicts.png)")
    assert set(shown) - {"component", "---"} == {component.name for component in components()}
    for name, row in stored[stored["effect"].notna()].iterrows():  # keys of the runs beside it have none
        assert shown[str(name)][2].strip("*") == row["verdict"].replace("_", " ")
    networks = rows_of(text, "### How far from re-simulation")
    assert set(networks) - {"network", "---", "*bar*"} >= {"lsa2h", "nsa2h", "sa2h-printed", "sa2h", "sa2h −att"}
    scores = {"sa2h": 20, "sa2h + anatomy_seed-4": 25, "sa2h −att": 26, "nsa2h": 20, "sa2h-printed": 20}
    for name, score in scores.items():
        assert float(networks[name][2]) == pytest.approx(score / 12, abs=0.03), "of the anatomy of the reference"
    assert [networks[name][1] for name in scores] == ["4", "4", "2", "3", "3"]
    beside = rows_of(text.split("### How far from re-simulation")[1], "no verdict depends on them.")
    assert set(beside) == {"network", "---", "lsa2h", "nsa2h", "sa2h-printed"}
    assert float(beside["nsa2h"][1]) == pytest.approx(1, abs=0.1)


def test_verdicts_are_those_of_a_script_that_uses_nothing_of_the_package(
    study: Path, script: ModuleType, tmp_path: Path
) -> None:
    script.keep(study, tmp_path / "kept")
    recompute = importlib.import_module("recompute_verdicts")
    runs = recompute.values(tmp_path / "kept" / "full_model")
    assert len(runs) == OF_DESIGN
    table = recompute.verdicts(runs)
    expected = open_study(study).verdicts.set_index("component").loc[table.index]
    assert table["verdict"].tolist() == expected["verdict"].tolist()
    names = {"effect": "effect", "lower": "lower", "upper": "upper", "p_zero": "p_holm", "p_band": "p_band_holm"}
    for here, there in names.items():
        np.testing.assert_allclose(table[here], expected[there], rtol=1e-4, atol=1e-6)


def test_verdicts_of_an_unfinished_design_are_preliminary(study: Path, script: ModuleType, tmp_path: Path) -> None:
    kept, page = tmp_path / "results", tmp_path / "results.md"
    for cell in sorted(study.glob("*.concat-input/seed*")):
        (cell / "result.json").unlink()
    script.keep(study, kept)
    script.write_page(kept, page)
    text = page.read_text()
    assert "57 of 61 runs are finished: 48 of the 52 runs of the design. **All verdicts are preliminary.**" in text
    words = [row[2] for row in rows_of(text, "verdicts.png)").values()][2:]
    assert len(words) == len(components()) - 1, "nothing is said of the missing one"
    assert all(word.endswith("(preliminary)") for word in words)
    assert "nan" not in text.lower()


@pytest.mark.parametrize("labels", [("sa2h",), ("sa2h", PRINTED), ("nsa2h",)])
def test_a_page_is_made_of_whatever_has_finished(
    study: Path, script: ModuleType, tmp_path: Path, labels: Sequence[str]
) -> None:
    for folder in study.iterdir():
        if folder.name not in labels:
            shutil.rmtree(folder)
    script.keep(study, tmp_path / "results")
    script.write_page(tmp_path / "results", tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text()
    assert f"{4 * ('sa2h' in labels) + 3 * (labels[-1] != 'sa2h')} of {RUNS} runs are finished" in text
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
    for folder in (study / "sa2h").iterdir():
        spec, result = (json.loads((folder / name).read_text()) for name in ("spec.json", "result.json"))
        spec["semantic"]["training"]["steps"] += 1
        spec["hash"] = result["hash"] = digest(spec["semantic"])
        (folder / "spec.json").write_text(json.dumps(spec))
        (folder / "result.json").write_text(json.dumps(result))
    with pytest.raises(ValueError, match=r"another configuration of sa2h/seed0"):
        script.keep(study, tmp_path / "kept")
