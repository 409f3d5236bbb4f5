"""Files of components beside a user's own files are read, and what is wrong with one is said before anything runs."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from ablate.command.checks import check
from ablate.command.compose import jobs_of
from ablate.settings.components import components, read_components_from
from ablate.settings.conf import conf_folder
from ablate.settings.study import ConfigurationError
from ablate.tasks.entry import execute

FILE = "key: training.reconstruction\non: crps\noff: l1\nmetric: crps\nband: 0.8\n"
MALFORMED = {
    "a metric that there is not": (FILE.replace("metric: crps", "metric: crsp"), "; did you mean crps?"),
    "a slip in a key": (FILE.replace("band", "bnad"), "; did you mean band?"),
    "no band": (FILE.replace("band: 0.8\n", ""), "has both a metric and a band"),
    "no metric": (FILE.replace("metric: crps\n", ""), "has both a metric and a band"),
    "a band of nothing": (FILE.replace("0.8", "0"), "band=0: allowed are finite numbers above 0"),
    "a band in words": (FILE.replace("0.8", "small"), "band='small': allowed are finite numbers above 0"),
    "no key": (FILE.replace("key: training.reconstruction\n", ""), "'key'"),
    "a key that there is not": (
        FILE.replace("reconstruction", "reconstructoin"),
        "; did you mean training.reconstruction?",
    ),
    "a level that there is not": (
        FILE.replace("crps\noff", "crsp\noff"),
        "reconstruction='crsp': allowed are l1, crps",
    ),
    "a list of metrics": (FILE.replace("metric: crps", "metric: [crps]"), "metric=['crps']: allowed is text"),
    "a list": ("- key\n", "holds no keys"),
    "nothing": ("", "holds no keys"),
    "no YAML": ("key: [training\n", "line 2"),
    "the key of another": (
        FILE.replace("training.reconstruction\non: crps\noff: l1", "model.noise"),
        "by conf/component",
    ),
}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder, without files of the user's."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    yield folder
    read_components_from([])


def write(folder: Path, text: str = FILE, name: str = "reconstruction") -> Path:
    file = folder / "component" / f"{name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def plan(*words: str) -> int:
    return execute(["preset=tiny", "task=plan", *words])


def bands() -> dict[str, float | None]:
    return {component.name: component.band for component in components()}


@pytest.mark.parametrize("sweep", [(), ("-m", "seed=0,1")], ids=["one", "sweep"])
@pytest.mark.parametrize("place", ["conf", "--config-dir", "hydra.searchpath"])
def test_a_file_of_ones_own_declares_a_component(
    here: Path, tmp_path: Path, place: str, sweep: tuple[str, ...]
) -> None:
    theirs = tmp_path / "elsewhere"
    words = {
        "conf": [],
        "--config-dir": ["--config-dir", str(theirs)],
        "hydra.searchpath": [f"hydra.searchpath=[file://{theirs}]"],
    }[place]
    shipped = bands()
    file = write(here / "conf" if place == "conf" else theirs)
    assert plan(*words, *sweep) == 0
    assert bands() == {**shipped, "reconstruction": 0.8}
    file.write_text(FILE.replace("0.8", "0.7"))  # while the command runs
    assert bands()["reconstruction"] == 0.7
    file.unlink()
    assert bands() == shipped


def test_files_of_a_folder_are_those_of_its_commands_alone(here: Path, tmp_path: Path) -> None:
    write(here / "conf")
    jobs_of(["preset=tiny"])
    assert "reconstruction" in bands()
    (tmp_path / "other").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path / "other")
        jobs_of(["preset=tiny"])
        assert "reconstruction" not in bands()


@pytest.mark.parametrize("case", MALFORMED)
def test_a_file_that_declares_no_component_is_refused(here: Path, case: str) -> None:
    text, words = MALFORMED[case]
    write(here / "conf", text)
    for task in ("plan", "study"):
        with pytest.raises(ConfigurationError) as error:
            plan(f"task={task}", "runs_dir=runs")
        assert str(error.value).startswith("conf/component/reconstruction.yaml: ")
        assert words in str(error.value)
        assert "\n" not in str(error.value)
    assert not (here / "runs").exists()


def test_a_metric_of_ones_own_need_not_be_named_where_nothing_is_judged(here: Path) -> None:
    write(here / "conf", FILE.replace("metric: crps", "metric: mine"))
    (job,) = jobs_of(["preset=tiny", "task=render", "runs_dir=runs"])
    check([job])
    with pytest.raises(
        ConfigurationError, match=r"metric=mine: .*allowed are .*, and one of yours that metrics= names$"
    ):
        plan("runs_dir=runs")


def test_a_file_with_the_name_of_a_shipped_one_takes_its_place_and_this_is_said(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = conf_folder() / "component" / "noise.yaml"
    (here / "conf/component").mkdir(parents=True)
    shutil.copy(shipped, here / "conf/component")
    assert plan() == 0
    assert "noise" not in capsys.readouterr().out, "it is the same"
    write(here / "conf", shipped.read_text().replace("band: 0.4", "band: 0.9"), "noise")
    assert plan() == 0
    said = "Note: The component noise is that of conf/component/noise.yaml, not that of the package.\n"
    assert said in capsys.readouterr().out
    assert bands()["noise"] == 0.9


def test_two_files_of_ones_own_with_one_name_are_refused(here: Path, tmp_path: Path) -> None:
    write(here / "conf")
    write(tmp_path / "elsewhere")
    with pytest.raises(ConfigurationError, match=r"reconstruction\.yaml has its name; allowed is one of them$"):
        plan("--config-dir", str(tmp_path / "elsewhere"))


def test_a_setting_of_an_own_network_is_a_component(here: Path) -> None:
    write(here / "conf", "key: model.settings.skip\non: true\noff: false\nmetric: psnr\nband: 0.1\n", "skip")
    assert plan() == 0
    assert bands()["skip"] == 0.1
