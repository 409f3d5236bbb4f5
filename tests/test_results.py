"""Kept results: small copies that bring a study back, and a page written from them."""

import importlib
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from unittest import mock

import numpy as np
import pandas as pd
import pytest

from ablate import open_study
from ablate.metrics import METRICS
from ablate.settings.components import components
from ablate.storage import write_json
from ablate.study.job import Job, claim
from ablate.study.run import COMPARISON, Run, RunList, listed_runs, read_list, write_list
from ablate.study.scores import Score, wanted_scores, write_score
from ablate.study.training import Training
from ablate.training.settings import TRAINING_VERSION
from ablate.ultrasound.settings import SIMULATOR_VERSION
from support.studies import run, study_group

ROOT = Path(__file__).parents[1]
FRAMES, SITES = 8, 8
RUNS, OF_DESIGN = 61, 52
PER_IMAGE = [name for name, metric in METRICS.items() if metric.of_image or metric.of_draws]
EFFECT = 6.0  # on every metric of going without the attenuation map; twice the band
IMAGE = np.full((40, 60), 90, np.uint8)
PRINTED = "sa2h-printed.crop-0.reconstruction-l1"
WHEN = "2026-01-01T00:00:00+00:00"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    page = importlib.import_module("results_page")
    monkeypatch.setattr(page, "jobs_of", lambda words: study_group(words[0].removeprefix("+study=")))
    return importlib.import_module("results")


def jobs_in(runs: Path) -> list[Job]:
    """Every job of the study."""
    jobs = study_group("full_model")
    return [replace(job, settings=replace(job.settings, runs_dir=str(runs))) for job in jobs]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole study, as if trained and compared."""
    jobs = jobs_in(tmp_path_factory.mktemp("study") / "runs")
    with mock.patch("os.fsync"):  # of a thousand files
        for job in jobs:
            pretend(job)
    folder = jobs[0].settings.study_dir
    (folder / ".claim.lock").unlink()
    (folder / COMPARISON).mkdir()
    write_list(folder / COMPARISON, listed_runs(jobs))
    return folder


@pytest.fixture
def study(whole: Path, tmp_path: Path) -> Path:
    """A copy of it that a test may change."""
    return shutil.copytree(whole, tmp_path / "runs" / whole.name)


def pretend(job: Job) -> None:
    """Write the files of a finished training: chance about 20 in every metric, and 26 without the attenuation map.

    In the second anatomy both are 5 more.
    """
    s, rng = job.settings, np.random.default_rng(job.settings.seed)
    anatomy = s.scene.anatomy_seed
    mean = 5 + 5 * anatomy + rng.normal(scale=0.1) + EFFECT * (s.model.attenuation == "none")
    training = claim(job)
    pixels = f"{anatomy}" * 16
    for key in wanted_scores(s.metrics, s.evaluation, pixels):
        floor = 12.0 if METRICS[key.metric].better != "higher" else 32.0
        rows = [
            (300 + frame, frame % SITES, key.metric, value + rng.normal(scale=0.01), source, part)
            for source, value in (("model", mean), ("resimulation", floor))
            for part in ("test", "validation")
            for frame in range(FRAMES)
        ]
        values = pd.DataFrame(rows, columns=["frame", "site", "metric", "value", "source", "split"])
        scalars = {f"test/{key.metric}": mean, f"test/floor_{key.metric}": 12.0}
        if key.metric not in PER_IMAGE:
            values = values.iloc[:0]
            scalars = {f"test/{key.metric}": 0.5 + 0.01 * mean, f"test/floor_{key.metric}": 0.1}
        write_score(training.scores, key, Score(values, scalars, (), WHEN))
    np.savez(training.pictures_file, frames=[300, 310], images=[IMAGE, IMAGE // 2])
    training.provenance.mkdir()
    made_with = {"git_commit": "0123456789", "git_dirty": "false", "hardware": f"machine {anatomy}"}
    write_json(training.provenance / "made_with.json", made_with)
    training.checkpoint.write_text("weights")
    scalars = {"parameters_generator": 1e6, "parameters_discriminator": 2e6, "train/seconds": 30.0}
    training.write_result({"pixels": pixels, "scalars": scalars, "notes": [], "started": WHEN, "ended": WHEN})


def runs_by_name(study: Path) -> dict[str, Run]:
    return {run.name: run for run in read_list(study).runs}


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


def test_what_is_kept_is_whole_and_without_the_machine(study: Path, script: ModuleType, tmp_path: Path) -> None:
    lines = script.keep(study, tmp_path / "kept")
    assert lines.count("kept sa2h/seed0") == 1
    assert sum(line.startswith("kept ") for line in lines) == RUNS
    assert any(line.startswith("no picture of the target is kept") for line in lines), "its pairs are not on disk"
    folder = tmp_path / "kept" / study.name
    original = runs_by_name(study)["sa2h.attenuation-none/seed1"]
    kept = runs_by_name(folder)[original.name]
    assert set(contents(kept.training.folder)) == {
        "training.json",
        "trained.json",
        "provenance/made_with.json",
        *(f"scores/{name}" for name in original.score_names),
    }
    assert str(study.parents[1]) not in (kept.training.folder / "training.json").read_text(), "no path of this machine"
    pd.testing.assert_frame_equal(kept.scores, original.scores)
    assert kept.scalars == original.scalars
    pictured = list(folder.glob("*/pictures.npz"))
    labels = {run.label for run in runs_by_name(study).values() if "anatomy" not in run.label}
    assert {Training(path.parent).label for path in pictured} == labels
    assert {Training(path.parent).seed for path in pictured} == {0}
    with np.load(pictured[0]) as shown:
        assert shown["frames"].tolist() == [300]
    before = contents(tmp_path / "kept")
    assert not any(line.startswith("kept ") for line in script.keep(study, tmp_path / "kept")), "a second time"
    assert contents(tmp_path / "kept") == before
    again = runs_by_name(study)["sa2h/seed1"].training
    again.write_result({**again.result, "ended": "2031-01-01T00:00:00+00:00"})
    lines = [line for line in script.keep(study, tmp_path / "kept") if line.startswith("kept ")]
    assert lines == ["kept sa2h/seed1"], "trained again"


def compared(folder: Path, runs: Sequence[Run]) -> None:
    write_list(folder / COMPARISON, RunList(folder, tuple(runs), (), "sa2h"))


def test_a_study_is_kept_in_pieces_from_several_machines(study: Path, script: ModuleType, tmp_path: Path) -> None:
    runs = read_list(study).runs
    for part in (runs[:30], runs[20:]):
        compared(study, part)
        script.keep(study, tmp_path / "kept")
    kept = tmp_path / "kept" / study.name
    assert runs_by_name(kept).keys() == {run.name for run in runs}
    assert len(list(kept.glob("*/trained.json"))) == RUNS


def test_a_run_of_another_configuration_replaces_the_one_of_its_name(
    study: Path, script: ModuleType, tmp_path: Path
) -> None:
    script.keep(study, tmp_path / "kept")
    kept = tmp_path / "kept" / study.name
    before = runs_by_name(kept)["sa2h/seed1"].training
    job = next(job for job in jobs_in(tmp_path / "runs") if job.name == "sa2h/seed1")
    training = replace(job.settings.training, steps=job.settings.training.steps + 1)
    longer = replace(job, settings=replace(job.settings, training=training))
    pretend(longer)
    compared(study, listed_runs([longer]).runs)
    assert "kept sa2h/seed1" in script.keep(study, tmp_path / "kept")
    assert runs_by_name(kept)["sa2h/seed1"].training.hash == longer.hash != before.hash
    assert len(runs_by_name(kept)) == RUNS
    assert not before.folder.exists()


def test_a_restored_study_has_nothing_left_to_do(study: Path, script: ModuleType, tmp_path: Path) -> None:
    script.keep(study, tmp_path / "kept")
    folders = {name: run.training.folder for name, run in runs_by_name(study).items()}
    (folders["sa2h/seed1"] / "trained.json").unlink()
    for file in ("training.json", "trained.json", "last.ckpt"):
        (folders["nsa2h/seed0"] / file).unlink()
    for seed in range(3):
        shutil.rmtree(folders[f"{PRINTED}/seed{seed}"])
    shutil.rmtree(study / COMPARISON)
    lines = script.restore(tmp_path / "kept", tmp_path / "runs")
    back = {line.split()[-1] for line in lines if line.startswith("restored")}
    anew = ("nsa2h/seed0", "sa2h/seed1", *(f"{PRINTED}/seed{k}" for k in range(3)))
    assert back == {f"full_model/{folders[name].name}" for name in anew}, "also what was started and has not finished"
    assert f"there already: full_model/{folders['sa2h/seed2'].name}" in lines, "what is there is not touched"
    assert [job.name for job in jobs_in(tmp_path / "runs") if not job.finished] == []
    assert len(read_list(study).runs) == RUNS


def test_make_answer_shows_the_kept_results_where_nothing_was_run(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recipe = (ROOT / "Makefile").read_text().split("\nanswer:", 1)[1].split("\n\n", 1)[0].splitlines()[1:]
    restoring, *comparing, _ = [line.split("$(BIN)/python ")[1] for line in recipe]
    assert restoring == "scripts/results.py restore"
    studies = ("full_model", "extension", "components")
    assert comparing == [f"-m ablate task=compare study_name={name}" for name in studies]
    monkeypatch.chdir(tmp_path)
    script.restore()
    with (
        mock.patch("ablate.study.compare.draw_figures", return_value=[]),
        mock.patch("ablate.publish.publish_study", return_value=""),
    ):
        run(*comparing[1].removeprefix("-m ablate ").split())
    folder = Path("runs") / "extension"
    assert "These results are of version 8 of the simulator" in capsys.readouterr().out
    assert "version 8 of the simulator" in (folder / COMPARISON / "report.html").read_text()
    assert not list(folder.glob("*/last.ckpt")), "nothing was trained"
    made, kept = (pd.read_csv(path / "verdicts.csv") for path in (folder / COMPARISON, ROOT / "docs/results/extension"))
    pd.testing.assert_frame_equal(made, kept, rtol=1e-9)


def test_the_page_of_a_whole_study(study: Path, script: ModuleType, tmp_path: Path) -> None:
    kept, page = tmp_path / "results", tmp_path / "results.md"
    script.keep(study, kept)
    keep_frame(kept)
    markers = importlib.import_module("results_page")
    page.write_text(f"Before.\n{markers.BEGIN}\nold\n{markers.END}\nAfter.\n")
    script.write_results(kept, page)
    text = page.read_text()
    assert text.startswith(f"Before.\n{markers.BEGIN}")
    assert text.endswith(f"{markers.END}\nAfter.\n")
    assert "\nold\n" not in text
    assert text.count("## full_model\n") == 1
    assert f"{RUNS} of {RUNS} runs are finished." in text
    assert "preliminary" not in text
    assert "machine 3 (35 runs); machine 4 (26 runs)" in text
    assert f"of version {SIMULATOR_VERSION} of the simulator and version {TRAINING_VERSION} of the training." in text
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
    assert set(shown) - {"component", "---"} == {component.name for component in components("full_model")}
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
    for result in sorted(study.glob("*.concat-input-seed*/trained.json")):
        result.unlink()
    script.keep(study, kept)
    script.write_results(kept, page)
    text = page.read_text()
    assert "57 of 61 runs are finished: 48 of the 52 runs of the design. **All verdicts are preliminary.**" in text
    words = [row[2] for row in rows_of(text, "verdicts.png)").values()][2:]
    assert len(words) == len(components("full_model")) - 1, "nothing is said of the missing one"
    assert all(word.endswith("(preliminary)") for word in words)
    assert "nan" not in text.lower()


@pytest.mark.parametrize("labels", [("sa2h",), ("sa2h", PRINTED), ("nsa2h",)])
def test_a_page_is_made_of_whatever_has_finished(
    study: Path, script: ModuleType, tmp_path: Path, labels: Sequence[str]
) -> None:
    compared(study, [run for run in read_list(study).runs if run.label in labels])
    script.keep(study, tmp_path / "results")
    script.write_results(tmp_path / "results", tmp_path / "page.md")
    text = (tmp_path / "page.md").read_text()
    assert f"{4 * ('sa2h' in labels) + 3 * (labels[-1] != 'sa2h')} of {RUNS} runs are finished" in text
    assert "earns**" not in text
    assert "nan" not in text.lower().replace("nsa2h", "")


def test_what_cannot_be_kept_or_shown_is_refused(study: Path, script: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no comparison"):
        script.keep(tmp_path / "nowhere", tmp_path / "kept")
    with pytest.raises(ValueError, match="holds no study"):
        script.write_results(tmp_path / "kept", tmp_path / "page.md")
    script.keep(study, tmp_path / "kept")
    (tmp_path / "page.md").write_text("No markers.")
    with pytest.raises(ValueError, match="lacks the markers"):
        script.write_results(tmp_path / "kept", tmp_path / "page.md")


@pytest.mark.usefixtures("script")
def test_the_scale_of_a_network_is_that_of_its_own_maps() -> None:
    page = importlib.import_module("components_page")
    scalars = {"fd_speckle": (1.0, 2.0, 0.0), "octave_sd": (0.5, 2.0, 0.1), "psnr": (22.0, 20.0, 24.0)}
    scalars |= {"mae_smooth": (10.0, 18.0, 8.0), "pchi2_tissue": (0.1, 2.0, -1.0)}

    def made(label: str, data: str, more: float) -> Run:
        values = {}
        for name, (model, formula, best) in scalars.items():
            values |= {f"test/{name}": model + more, f"test/formula_{name}": formula, f"test/floor_{name}": best}
        return mock.Mock(label=label, data=data, scalars=values)

    runs = [made("sa2h", "a", 0.0), made("sa2h", "a", 2.0), made("sa2h.anatomy_seed-13", "b", 3.0)]
    runs += [made("full", "a", -2.0), made("sa2h.noise-input", "a", 99.0)]
    means = page.run_means(mock.Mock(usable=mock.Mock(all=runs)))
    assert means.loc[("sa2h", "model"), "mae_smooth"] == 12.0, "of both anatomies alike: (10 + 12) / 2 and 13"
    assert means.loc[("sa2h", "model"), "runs"] == 3
    table = {row[0]: row[1:] for row in page.scale_rows(means)}
    assert table == {"sa2h": ["1.00", "0.60", "-0.03"], "full": ["0.00", "1.00", "1.30"]}
    assert page._share("psnr", model=25.0, formula=24.0, best=22.0) == "–", "the formula is past re-simulation"
