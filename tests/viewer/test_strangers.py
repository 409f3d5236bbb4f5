"""Reading what a stranger made runs no code of his: files that `ablate.load` opens, and a folder that is viewed."""

import logging
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import torch

import ablate
from ablate.networks import GeneratorSpec
from ablate.pretrained import NAMES
from ablate.setting import plain
from ablate.storage import read_json, write_json
from ablate.study.training import State, Training
from ablate.user_code import UnnamedCodeError
from ablate.viewer.generators import first_fitting, open_generator, pickable
from ablate.viewer.page.result_tabs import _distances
from ablate.viewer.scene_renderer import SceneRenderer
from ablate.viewer.session import Quality
from ablate.viewer.words import in_markdown
from support.strangers import (
    CUSTOM,
    RunsCommand,
    Trap,
    change_checkpoint,
    hyper_parameters,
    innocent_run,
    lay_trap,
    strangers_generator,
    strangers_run,
)
from support.viewed_body import BODY, STATE


@pytest.fixture
def trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Trap:
    return lay_trap(tmp_path, monkeypatch)


def test_a_file_that_names_a_class_is_loaded_only_with_its_name(tmp_path: Path, trap: Trap) -> None:
    path = tmp_path / "gift.pt"
    strangers_generator(path, trap)
    for named in (None, "os.path", "code_of_a_stranger.metric"):
        with pytest.raises(UnnamedCodeError) as refused:
            ablate.load(path, custom=named)
        assert str(refused.value) == (
            f"{path}: names code, which is imported only if you name it too; if you trust it, add "
            "custom='code_of_a_stranger.Network'"
        )
    assert not trap.has_sprung
    assert ablate.load(path, custom=trap.network).generator.spec.target == trap.network
    assert trap.has_sprung, "or nothing was tested"


@pytest.mark.parametrize(
    "target", ["code_of_a_stranger.Network\n", ["code_of_a_stranger.Network"], {"a": 1}, True, "", "x" * 10_000, 0]
)
def test_whatever_stands_in_place_of_the_name_is_refused_in_one_line(
    tmp_path: Path, trap: Trap, target: object
) -> None:
    path = tmp_path / "gift.pt"
    strangers_generator(path, trap)
    content = torch.load(path, weights_only=True)
    content["spec"]["target"] = target
    torch.save(content, path)
    with pytest.raises(UnnamedCodeError) as refused:
        ablate.load(path)
    assert len(str(refused.value).splitlines()) == 1
    assert len(str(refused.value)) < 500
    assert not trap.has_sprung


@pytest.mark.parametrize("write", [torch.save, lambda content, path: path.write_bytes(pickle.dumps(content))])
def test_what_runs_when_it_is_unpickled_is_not_unpickled(
    tmp_path: Path, trap: Trap, write: Callable[[object, Path], object]
) -> None:
    path = tmp_path / "gift.pt"
    write({"spec": RunsCommand(trap.mark)}, path)
    with pytest.raises(ValueError, match=r"gift\.pt: not a file of a trained generator"):
        ablate.load(path)
    run = innocent_run(tmp_path / "runs")
    write({"steps_done": 1, "hyper_parameters": RunsCommand(trap.mark)}, run.checkpoint)
    with pytest.raises(ValueError, match=r"last\.ckpt: not a readable checkpoint"):
        open_generator(run.folder, BODY.tissues)
    assert not trap.has_sprung
    torch.load(path, weights_only=False) if write is torch.save else pickle.loads(path.read_bytes())
    assert trap.has_sprung, "or nothing was tested"


@pytest.mark.parametrize(
    "content", [None, [], {}, {"spec": 3}, {"spec": {"target": None, "unknown": 1}}, {"spec": [("family", "local")]}]
)
def test_a_file_of_anything_else_is_one_line(tmp_path: Path, content: object) -> None:
    path = tmp_path / "gift.pt"
    torch.save(content, path)
    with pytest.raises(ValueError, match=r"gift\.pt: not a file of a trained generator") as refused:
        ablate.load(path)
    assert len(str(refused.value).splitlines()) == 1


def viewed(runs: Path, *, custom: str | None = None) -> tuple[dict[str, str], int]:
    """Look at a folder of runs as `task=view` does, and pick all; the notes by name, and how many are rendered."""
    offered = pickable(runs)
    first_fitting(offered, BODY.tissues, STATE, custom)
    picked = {name: run for name, run in offered.items() if not name.startswith("comes with ablate")}
    assert picked, "or nothing was tested"
    state = replace(STATE, runs=tuple(picked.values()))
    views = SceneRenderer(BODY, STATE.pose[None], custom).render(state, Quality.full)
    assert views.target is not None, "the simulated image goes on"
    notes = {name: views.notes.get(f"generated {number}", "") for number, name in enumerate(picked)}
    return notes, sum(image is not None for image in views.generated)


def test_a_run_of_a_network_of_its_own_is_left_out_with_how_to_allow_it(
    tmp_path: Path, trap: Trap, caplog: pytest.LogCaptureFixture
) -> None:
    run = strangers_run(tmp_path / "runs", trap)
    allowing = "if you trust it, add variant=custom model.target='code_of_a_stranger.Network'"
    with caplog.at_level(logging.WARNING):
        notes, rendered = viewed(tmp_path / "runs")
    assert rendered == 0
    assert not trap.has_sprung
    (note,) = notes.values()
    assert note.startswith(f"{run.checkpoint}: names code, which is imported only if you name it too; ")
    assert note.endswith(allowing)
    (line,) = {record.getMessage() for record in caplog.records}
    assert line == f"left out: {note}"
    notes, rendered = viewed(tmp_path / "runs", custom=trap.network)
    assert rendered == 1, notes
    assert trap.has_sprung, "or nothing was tested"


def test_only_the_checkpoint_names_it_and_the_rest_of_the_run_looks_innocent(tmp_path: Path, trap: Trap) -> None:
    run = innocent_run(tmp_path / "runs")
    spec = plain(GeneratorSpec(**CUSTOM, target=trap.network))
    change_checkpoint(run, {"hyper_parameters": hyper_parameters(spec), "target_source": "0" * 64})
    notes, rendered = viewed(tmp_path / "runs")
    assert rendered == 0
    assert "names code" in next(iter(notes.values()))
    assert not trap.has_sprung


def test_a_metric_that_a_run_names_is_not_imported(tmp_path: Path, trap: Trap) -> None:
    run = innocent_run(tmp_path / "runs", f"metrics=[psnr,{trap.metric}]")
    trap.set_again()
    content = read_json(run.folder / "trained.json")
    write_json(run.folder / "trained.json", content | {"metrics": [trap.metric]})
    assert trap.metric in (run.folder / "training.json").read_text()
    _, rendered = viewed(tmp_path / "runs")
    assert rendered == 1
    assert not trap.has_sprung


@pytest.mark.parametrize(
    "changes",
    [
        {"hyper_parameters": 3},
        {"hyper_parameters": {"spec": []}},
        {"hyper_parameters": {"spec": {"target": None}, "settings": 3}},
        {"hyper_parameters": {}},
        {"state_dict": 3},
        {"state_dict": {"generator.network.output.bias": "text"}},
    ],
)
def test_a_damaged_checkpoint_leaves_the_simulated_image_and_the_others(
    tmp_path: Path, changes: dict[str, object]
) -> None:
    damaged = innocent_run(tmp_path / "runs")
    change_checkpoint(damaged, changes)
    innocent_run(tmp_path / "runs", "seed=1")
    notes, rendered = viewed(tmp_path / "runs")
    assert rendered == 1
    assert any("last.ckpt" in note for note in notes.values())


def test_a_folder_of_anything_is_looked_through(tmp_path: Path) -> None:
    """Names, links that lead in a circle or nowhere, and files where folders should be."""
    runs = tmp_path / "runs"
    run = innocent_run(runs)
    study = run.folder.parent
    (study / "nothing").mkdir()
    (study / "nothing" / "seed0").write_text("a file")
    (study / "circle").symlink_to(study, target_is_directory=True)
    (study / "gone").symlink_to(tmp_path / "nowhere")
    for number, text in enumerate(("", "[]", "{", '{"hash": 3}', "[" * 100_000, "\udcff")):
        folder = study / f"broken-seed{number}-0"
        folder.mkdir(parents=True)
        (folder / "training.json").write_bytes(text.encode(errors="surrogateescape"))
        (folder / "last.ckpt").write_bytes(b"")
    offered = pickable(runs)
    assert [run_ for name, run_ in offered.items() if "comes with" not in name] == [run.folder.resolve()]
    assert len(offered) == 1 + len(NAMES) + 1


@pytest.mark.parametrize("key", ["data", "label"])
@pytest.mark.parametrize("name", ["../../../elsewhere", "/etc", "", "x\u0000y", 3])
def test_names_that_lead_elsewhere_make_a_run_unusable(tmp_path: Path, key: str, name: object) -> None:
    run = innocent_run(tmp_path / "runs")
    write_json(run.folder / "training.json", read_json(run.folder / "training.json") | {key: name})
    assert Training(run.folder).state is State.unusable
    assert len(pickable(tmp_path / "runs")) == len(NAMES) + 1


def test_names_are_words_on_the_page_and_never_markup() -> None:
    """viser renders HTML within Markdown; the names of folders and tissues come from whoever made them."""
    name = "<img src=x onerror='go()'> [a](javascript:b) `c` **d** | e\n# f &lt;"
    written = in_markdown(name)
    assert re.fullmatch(r"[\w .:]*", re.sub(r"&#\d+;", "", written)), "no sign is left that Markdown or HTML read"
    assert unescape(written) == " ".join(name.split()), "and a person reads the name itself"


def test_the_page_escapes_runs_and_tissues(tmp_path: Path) -> None:
    views = SceneRenderer(BODY, STATE.pose[None]).render(STATE, Quality.full)
    run = tmp_path / "seed0"
    beside = replace(views, state=replace(STATE, runs=(run,)), generated=(views.target,))
    table = _distances({run: "<script>go()</script>"}, beside)
    assert "<" not in table
    assert "script" in table
    assert np.isinf(float(table.splitlines()[-1].split("|")[2]))
