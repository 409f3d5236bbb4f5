"""A folder of runs from a stranger: comparing it writes nowhere else, and runs no code of his."""

import shutil
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch

from ablate import open_study
from ablate.anatomy import load_tissues
from ablate.command.compose import jobs_of
from ablate.setting import plain
from ablate.settings.study import ConfigurationError
from ablate.storage import digest, read_json, write_json
from ablate.study.job import claim
from ablate.study.run import COMPARISON, LIST, Run, listed_runs, read_list, write_list
from ablate.study.training import ABOUT, Training
from ablate.training import load_generator
from support.finished_runs import finish
from support.strangers import RunsCommand, lay_trap
from support.studies import run


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder of runs with a study of SA2H and SA2H-att that was compared."""
    folder = tmp_path / "runs"
    jobs = jobs_of(["-m", "preset=tiny", "variant=sa2h,sa2h-att", f"runs_dir={folder}", "metrics=[psnr]"])
    for job in jobs:
        finish(job)
    study = folder / "tiny-fetal"
    (study / COMPARISON).mkdir()
    write_list(study / COMPARISON, listed_runs(jobs))
    return folder


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A folder of the user's own."""
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "diary.txt").write_text("mine")
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def compare(runs: Path, *words: str) -> None:
    """What `task=compare` does, without the store, whose tests are in tests/publish."""
    with mock.patch("ablate.publish.publish_study", return_value=""):
        assert run("task=compare", "preset=tiny", f"runs_dir={runs}", "metrics=[psnr]", *words) == 0


def renamed(study: Path, training: str, **changes: object) -> None:
    """Let the list of a study name a folder, in place of the one of SA2H-att."""
    content = read_json(study / COMPARISON / LIST)
    content["jobs"][1] |= {"training": training, **changes}
    write_json(study / COMPARISON / LIST, content)


@pytest.mark.parametrize("kind", ["above", "absolute", "link", ".."])
def test_a_list_names_no_folder_elsewhere(runs: Path, outside: Path, kind: str) -> None:
    study = runs / "tiny-fetal"
    theirs = read_list(study).runs[1].training.folder
    moved = Path(shutil.move(theirs, outside / theirs.name))
    if kind == "link":
        theirs.symlink_to(moved)
    renamed(
        study, {"above": f"../../outside/{moved.name}", "absolute": str(moved), "link": theirs.name}.get(kind, kind)
    )
    before = contents(outside)
    assert [one.label for one in open_study(study).usable.runs] == ["sa2h"]
    compare(runs)
    assert contents(outside) == before
    assert (study / COMPARISON / "table.csv").exists()


@pytest.mark.parametrize("name", ["../../../outside/psnr@v1.parquet", "/etc/passwd", "..", "a\0b", "", 7, None])
def test_a_list_names_no_score_elsewhere(runs: Path, name: object) -> None:
    renamed(runs / "tiny-fetal", read_list(runs / "tiny-fetal").runs[1].training.folder.name, scores=[name])
    assert [one.label for one in read_list(runs / "tiny-fetal").runs] == ["sa2h"]


@pytest.mark.parametrize("name", [COMPARISON, f"{COMPARISON}.partial"])
def test_a_comparison_is_not_written_through_a_link(runs: Path, outside: Path, name: str) -> None:
    link = runs / "tiny-fetal" / name
    if link.exists():
        (outside / LIST).write_bytes((link / LIST).read_bytes())
        shutil.rmtree(link)
    link.symlink_to(outside, target_is_directory=True)
    before = contents(outside)
    compare(runs)
    assert contents(outside) == before
    assert not (runs / "tiny-fetal" / COMPARISON).is_symlink()
    assert (runs / "tiny-fetal" / COMPARISON / "table.csv").exists()


def test_a_study_that_is_a_link_is_read_and_not_written(runs: Path, outside: Path) -> None:
    moved = Path(shutil.move(runs / "tiny-fetal", outside / "tiny-fetal"))
    (runs / "tiny-fetal").symlink_to(moved, target_is_directory=True)
    before = contents(outside)
    assert len(open_study(runs / "tiny-fetal").usable.runs) == 2
    with pytest.raises(ConfigurationError, match=r"tiny-fetal is a link to .*outside"):
        compare(runs)
    assert contents(outside) == before


def test_nothing_is_trained_in_a_folder_that_is_a_link(runs: Path, outside: Path) -> None:
    (job,) = jobs_of(["preset=tiny", "variant=nsa2h", f"runs_dir={runs}"])
    job.folder.symlink_to(outside, target_is_directory=True)
    with pytest.raises(ConfigurationError, match="is a link"):
        claim(job)
    assert contents(outside) == {"diary.txt": b"mine"}


@pytest.mark.parametrize("name", ["log.jsonl", "last.ckpt", "trained.json", "scores", "images", "provenance"])
@pytest.mark.parametrize("is_known", [True, False])
def test_nothing_is_written_through_a_link_in_the_folder_of_a_training(
    runs: Path, outside: Path, name: str, is_known: bool
) -> None:
    (job,) = jobs_of(["preset=tiny", "variant=nsa2h", f"runs_dir={runs}"])
    if is_known:
        claim(job)
    job.folder.mkdir(exist_ok=True)
    (job.folder / name).symlink_to(outside / "diary.txt" if "." in name else outside)
    with pytest.raises(ConfigurationError, match=rf"{name} is a link"):
        claim(job)
    assert contents(outside) == {"diary.txt": b"mine"}


def test_a_lock_that_is_a_link_does_not_empty_a_file(runs: Path, outside: Path) -> None:
    (runs / "tiny-fetal" / ".comparison.lock").symlink_to(outside / "diary.txt")
    with pytest.raises(OSError, match="symbolic links"):
        compare(runs)
    assert contents(outside) == {"diary.txt": b"mine"}


@pytest.mark.parametrize("data", ["../../outside", "/outside", "a/../../outside"])
def test_pairs_are_those_of_the_folder(runs: Path, data: str) -> None:
    folder = read_list(runs / "tiny-fetal").runs[0].training.folder
    write_json(folder / ABOUT, {**read_json(folder / ABOUT), "data": data})
    assert Training(folder).data_set.folder == runs / "data" / "outside"


def test_pictures_are_not_unpickled(runs: Path, tmp_path: Path) -> None:
    training = read_list(runs / "tiny-fetal").runs[0].training
    made = tmp_path / "it_ran"
    np.savez(training.pictures_file, frames=[0], images=np.array([RunsCommand(made)], object))
    assert training.pictures == {}
    compare(runs)
    assert not made.exists()
    with np.load(training.pictures_file, allow_pickle=True) as trusted:
        trusted["images"]
    assert made.exists(), "or nothing was tested"


def with_class(one: Run, parts: list[str], network: str) -> None:
    """Let some of the files of a training name the class of the stranger, and its pairs be there to be timed on."""
    training = one.training
    about = read_json(training.folder / ABOUT)
    spec = plain(jobs_of(["preset=tiny", "variant=custom", f"model.target={network}"])[0].settings.model)
    for part, model in (("identity", about["identity"]["model"]), ("settings", about["settings"]["model"])):
        if part in parts:
            model |= spec
    about["hash"] = digest(about["identity"])
    folder = training.folder.with_name(f"{about['label']}-seed{about['seed']}-{about['hash'][:8]}")
    training.folder.rename(folder)
    write_json(folder / ABOUT, about)
    if "checkpoint" in parts:
        parameters = {"spec": about["settings"]["model"] | spec, "settings": about["settings"]["training"]}
        content = {"steps_done": 6, "hyper_parameters": parameters, "state_dict": {}, "target_source": "0"}
        torch.save(content, folder / "last.ckpt")
    study = folder.parent
    write_json(
        Training(folder).data_set.folder / "about.json", {"tissues": [plain(t) for t in load_tissues().values()]}
    )
    renamed(study, folder.name)


@pytest.mark.parametrize(
    "parts", [["identity", "settings", "checkpoint"], ["identity", "settings"], ["settings"], ["checkpoint"]]
)
def test_a_network_that_a_folder_names_is_not_imported(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parts: list[str]
) -> None:
    trap = lay_trap(tmp_path, monkeypatch)
    one = read_list(runs / "tiny-fetal").runs[1]
    one.training.data_set.folder.mkdir(parents=True)
    with_class(one, parts, trap.network)
    trap.set_again()
    found = read_list(runs / "tiny-fetal").runs
    assert len(found) == 2, "it is a whole training"
    compare(runs)
    assert not trap.has_sprung
    assert (runs / "tiny-fetal" / COMPARISON / "table.csv").exists()
    if "checkpoint" in parts:
        with pytest.raises(ValueError, match="code of"):
            load_generator(found[1].training.checkpoint, custom=trap.network)
        assert trap.has_sprung, "or nothing was tested"
