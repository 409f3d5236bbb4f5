"""Every notebook runs from top to bottom on a study on disk, and says what to run where there is none."""

from contextlib import chdir
from pathlib import Path

import jupytext
import nbclient
import pytest
from nbclient.exceptions import CellExecutionError
from nbformat import NotebookNode

from support.studies import run

FOLDER = Path(__file__).parents[1] / "notebooks"
# Pictures that each shows; those of Fig. 3 are one a frame.
PICTURES = {
    "table2": 0,
    "fig2_qualitative": 2,
    "fig3_error_maps": 2,
    "fig4_boxplots": 2,
    "error_vs_runtime": 1,
    "simulator_tour": 10,
    "verdicts": 1,
}
MADE_BY = {"verdicts": "make answer"}  # the others read what `make sweep` leaves
pytestmark = [
    pytest.mark.slow,
    # Of jupyter_client and what it builds on, in this process.
    pytest.mark.filterwarnings("ignore::DeprecationWarning:jupyter_client.*", "ignore::DeprecationWarning:zmq.*"),
]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    runs = tmp_path_factory.mktemp("runs")
    with chdir(runs.parent):  # a relative folder, as in a checkout; the notebooks run in another one
        assert run("-m", "preset=tiny", "variant=sa2h,sa2h-att", "training.steps=2", f"runs_dir={runs.name}") == 0
    return runs / "tiny-fetal"


def execute(name: str) -> NotebookNode:
    notebook = jupytext.read(FOLDER / f"{name}.py")
    nbclient.NotebookClient(
        notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    return notebook


def test_the_list_of_notebooks_is_the_folder() -> None:
    assert sorted(PICTURES) == sorted(path.stem for path in FOLDER.glob("*.py"))


@pytest.mark.parametrize("name", PICTURES)
def test_it_runs_on_a_study(name: str, study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ABLATE_STUDY", str(study))
    before = {path for path in study.parent.rglob("*") if path.is_file()}
    outputs = [output for cell in execute(name).cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == PICTURES[name]
    assert {path for path in study.parent.rglob("*") if path.is_file()} == before  # it reads, and writes nothing
    assert not (FOLDER / "runs").exists()


@pytest.mark.parametrize("kept", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_kept_notebook_is_the_last_run_of_its_source(kept: Path) -> None:
    source, run_of_it = (jupytext.read(path).cells for path in (kept.with_suffix(".py"), kept))
    assert [cell.source for cell in source] == [cell.source for cell in run_of_it], "run `make notebooks`"


@pytest.mark.parametrize("name", PICTURES)
def test_without_a_study_it_says_what_to_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ABLATE_STUDY", str(tmp_path / "nothing"))
    with pytest.raises(CellExecutionError) as stopped:
        execute(name)
    text = str(stopped.value)
    assert (
        f"There is no finished study at {tmp_path / 'nothing'}. Run `{MADE_BY.get(name, 'make sweep')}` first" in text
    )
    assert "Traceback" not in text
