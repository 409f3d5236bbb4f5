"""A class of the user's is trained, scored and compared as a variant, by one command."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from ablate.command.compose import jobs_of
from ablate.settings.study import ConfigurationError
from ablate.storage import read_json
from ablate.study.work import do
from ablate.tasks.entry import execute
from ablate.training import load_generator
from support.studies import run

TOY = """
from torch import nn

class Toy(nn.Sequential):
    def __init__(self, channels):
        super().__init__(nn.Conv2d(channels, 8, 3, padding=1), nn.ReLU(), nn.Conv2d(8, 1, 3, padding=1), nn.Tanh())
"""


def test_a_network_of_the_user_is_a_variant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = tmp_path / "toy_networks.py"
    module.write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    sizes = ["preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10", "metrics=[psnr,mae]"]
    sizes += ["training.steps=2", f"runs_dir={tmp_path / 'runs'}"]
    assert run(*sizes, "variant=custom", "model.target=toy_networks.Toy") == 0
    study = tmp_path / "runs/tiny-fetal"
    (folder,) = study.glob("Toy-seed0-*")
    known = read_json(folder / "training.json")["identity"]["model"]
    assert known["target"] == "toy_networks.Toy"
    assert len(known["source"]) == 64
    # weights and biases of its two convolutions: S, A and two maps of position in
    assert read_json(folder / "trained.json")["scalars"]["parameters_generator"] == 4 * 8 * 9 + 8 + 8 * 9 + 1
    assert set(pd.read_csv(study / "comparison/table.csv")["variant"]) >= {"Toy"}

    module.write_text(
        TOY.replace("Conv2d(8, 1, 3", "Conv2d(8, 1, 5").replace("padding=1), nn.Tanh", "padding=2), nn.Tanh")
    )
    (begun,) = jobs_of([*sizes, "variant=custom", "model.target=toy_networks.Toy", "seed=1"])
    assert begun.identity["model"] == known
    trained = folder / "last.ckpt"
    assert load_generator(trained, custom="toy_networks.Toy").spec.target == "toy_networks.Toy"
    monkeypatch.delitem(sys.modules, "toy_networks")
    with pytest.raises(ConfigurationError, match=r"toy_networks\.Toy: edited since the sweep began; repeat"):
        do(begun)
    with pytest.raises(ValueError, match=r"last\.ckpt: the code of toy_networks\.Toy is not that of the training"):
        load_generator(trained, custom="toy_networks.Toy")
    (edited,) = jobs_of([*sizes, "variant=custom", "model.target=toy_networks.Toy"])
    assert edited.folder != folder, "edited code is another training"


def test_a_class_that_does_not_work_is_refused_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = "    def forward(self, maps):\n        return super().forward(maps)"
    refused = {
        "toy_smaller": (TOY.replace("8, 1, 3, padding=1", "8, 1, 3"), "returns (2, 1, "),
        "toy_lazy": (TOY.replace("Conv2d(channels, 8", "LazyConv2d(8"), "has parameters without a size"),
        "toy_apart": (f"{TOY}{step}.detach()\n", "returns an image that does not depend on its parameters"),
        "toy_double": (f"{TOY}{step}.double()\n", "returns torch.float64, allowed are float32"),
        "toy_nan": (f"{TOY}{step} / 0 * 0\n", "returns numbers that are not finite"),
        "toy_single": (f"{TOY}{step}.reshape(1, 1, *maps.shape[2:])\n", "two images of"),
        "nowhere": (None, "ModuleNotFoundError"),
    }
    monkeypatch.syspath_prepend(tmp_path)
    runs = tmp_path / "runs"
    for name, (code, message) in refused.items():
        if code:
            (tmp_path / f"{name}.py").write_text(code)
        with pytest.raises(ConfigurationError, match=f"^{re.escape(f'model.target={name}.Toy: {message}')}"):
            run("preset=tiny", "variant=custom", f"model.target={name}.Toy", f"runs_dir={runs}")
    with pytest.raises(ConfigurationError, match="target=None with family=custom"):
        run("preset=tiny", "variant=custom", f"runs_dir={runs}")
    assert not list(runs.rglob("*.json"))


SIZED = """
from torch import nn

class Sized(nn.Sequential):
    def __init__(self, channels, hidden: int = 8, block=None):
        super().__init__(nn.Conv2d(channels, hidden, 3, padding=1), nn.Conv2d(hidden, 1, 1), nn.Tanh())
"""
OWN = ["preset=tiny", "variant=custom", "model.target=sized_network.Sized"]


@pytest.fixture
def sized(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "sized_network.py").write_text(SIZED)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "sized_network", raising=False)
    return tmp_path


def test_its_settings_are_part_of_the_training_and_of_its_checkpoint(sized: Path) -> None:
    sizes = ["simulator.image_shape=[96,134]", "dataset.frames=10", "metrics=[psnr,mae]", "training.steps=2"]
    words = [*OWN, *sizes, f"runs_dir={sized / 'runs'}"]
    assert run(*words, "model.settings.hidden=5") == 0
    (folder,) = (sized / "runs/tiny-fetal").glob("Sized.hidden-5-seed0-*")
    assert read_json(folder / "trained.json")["scalars"]["parameters_generator"] == 4 * 5 * 9 + 5 + 5 + 1
    loaded = load_generator(folder / "last.ckpt", custom="sized_network.Sized")
    assert loaded.spec.settings == {"hidden": 5}
    (again,) = jobs_of([*words, "model.settings={hidden:5}"])
    assert again.finished
    (usual,) = jobs_of(words)
    assert not usual.finished
    assert "settings" not in usual.identity["model"], "trainings without settings keep their hash"


@pytest.mark.parametrize(
    ("swept", "labels"),
    [
        (["model.settings.hidden=16,32"], ["Sized.hidden-16", "Sized.hidden-32"]),
        (["model.settings={hidden:16},{hidden:32}"], ["Sized.hidden-16", "Sized.hidden-32"]),
        (["model={settings:{hidden:16}},{noise:input}"], ["Sized.hidden-16", "Sized.noise-input"]),
        (
            ["model.settings.block.a.size=1,2", "+model.settings.block.b.size=1,2"],
            [f"Sized.block_a_size-{a}.block_b_size-{b}" for a in (1, 2) for b in (1, 2)],
        ),
    ],
)
@pytest.mark.usefixtures("sized")
def test_its_settings_are_swept_like_any_key(swept: Sequence[str], labels: Sequence[str]) -> None:
    jobs = jobs_of(["-m", *OWN, *swept])
    assert [job.label for job in jobs] == labels
    assert len({job.hash for job in jobs}) == len(jobs)


SLIPS = {
    "model.settings.hiden=3": "model.settings.hiden=3: did you mean settings.hidden? sized_network.Sized takes",
    "model.settings.hidden=wide": "model.settings.hidden='wide': sized_network.Sized takes a whole number as hidden",
    "model.settings=3": "model.settings=3: allowed are names with numbers, text",
    "model.hidden=32": "a setting of your own network is typed model.settings.hidden=32",
    "+model.hidden=32": "a setting of your own network is typed model.settings.hidden=32",
    "hidden=32": "a setting of your own network is typed model.settings.hidden=32",
}


@pytest.mark.parametrize("word", SLIPS)
def test_a_setting_that_it_does_not_take_is_refused_before_anything_runs(sized: Path, word: str) -> None:
    for task in ("plan", "study"):
        with pytest.raises(ConfigurationError) as error:
            execute([*OWN, word, f"task={task}", f"runs_dir={sized / 'runs'}"])
        assert SLIPS[word] in str(error.value)
        assert "\n" not in str(error.value)
    assert not (sized / "runs").exists()


def test_a_network_of_the_package_refuses_settings() -> None:
    with pytest.raises(ConfigurationError, match=r"^model\.settings\.hidden=3 with family=local: .*variant=custom"):
        jobs_of(["preset=tiny", "model.settings.hidden=3"])
