"""Every notebook runs from top to bottom on a study on disk; the kept ones are whole, and are runs of their sources."""

import ast
from contextlib import chdir
from pathlib import Path

import jupytext
import nbclient
import nbformat
import pandas as pd
import pytest
from nbclient.exceptions import CellExecutionError
from nbformat import NotebookNode

from support.studies import run

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "notebooks"
KEPT = sorted(FOLDER.glob("*.ipynb"))
# Pictures that each shows; those of Fig. 3 are one a frame.
PICTURES = {
    "table2": 0,
    "fig2_qualitative": 2,
    "fig3_error_maps": 2,
    "fig4_boxplots": 2,
    "error_vs_runtime": 1,
    "simulator_tour": 10,
    "verdicts": 1,
    "paper_table2": 1,
}
KEPT_STUDIES = {"verdicts": "full_model", "paper_table2": "table2"}
MADE_BY = {"verdicts": "make answer", "paper_table2": "python -m ablate +study=table2"}  # the others: `make sweep`
# Of jupyter_client and what it builds on, in this process.
pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning:jupyter_client.*", "ignore::DeprecationWarning:zmq.*"
)


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


def pictures_in(notebook: NotebookNode) -> int:
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return sum("image/png" in output.get("data", {}) for output in outputs)


def read_kept(file: Path) -> NotebookNode:
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    return notebook


def test_the_list_of_notebooks_is_the_folder() -> None:
    assert sorted(PICTURES) == sorted(path.stem for path in FOLDER.glob("*.py"))
    assert sorted(PICTURES) == [path.stem for path in KEPT]


@pytest.mark.parametrize("file", KEPT, ids=lambda path: path.stem)
def test_a_kept_notebook_has_whole_cells(file: Path) -> None:
    cells = read_kept(file).cells
    assert cells[0].cell_type == "markdown"
    assert cells[0].source.startswith("# ")
    assert not [cell.source for cell in cells if "%%" in cell.source], "a marker of the source became text"
    for cell in cells:
        if cell.cell_type == "code":
            ast.parse(cell.source)


@pytest.mark.parametrize("file", KEPT, ids=lambda path: path.stem)
def test_a_kept_notebook_is_the_source_cell_by_cell(file: Path) -> None:
    # The source is read by its marks here, not by jupytext, which takes a wrong header for another format.
    code, expected = file.with_suffix(".py").read_text().split("# ---\n", 2)[2], []
    for part in code.split("\n# %%"):
        text = part.removeprefix(" [markdown]").strip()
        kind = "markdown" if part.startswith(" [markdown]") else "code"
        if kind == "markdown":
            text = "\n".join(line.removeprefix("#").removeprefix(" ") for line in text.splitlines())
        expected.append((kind, text))
    found = [(cell.cell_type, cell.source.strip()) for cell in read_kept(file).cells]
    assert found == [part for part in expected if part[1]], "run `make notebooks`"


@pytest.mark.parametrize("file", KEPT, ids=lambda path: path.stem)
def test_a_kept_notebook_has_its_outputs_and_names_its_study(file: Path) -> None:
    notebook = read_kept(file)
    assert pictures_in(notebook) >= PICTURES[file.stem]
    run_cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in run_cells] == list(range(1, len(run_cells) + 1))
    assert run_cells[-1].outputs
    about = notebook.metadata["ablate"]
    assert about["study"] == KEPT_STUDIES.get(file.stem, "quick-fetal")
    assert about["simulator_version"] >= 8
    assert about["training_version"] >= 2


def test_the_kept_verdicts_are_those_of_the_kept_study() -> None:
    verdicts = pd.read_csv(ROOT / "docs" / "results" / "full_model" / "verdicts.csv").dropna(subset="metric")
    cells = read_kept(FOLDER / "verdicts.ipynb").cells
    pages = [
        output["data"].get("text/html", "") for cell in cells for output in cell.get("outputs", []) if "data" in output
    ]
    table = next(page for page in pages if "p_band_holm" in page)
    rows = {row.split("</th>")[0].rsplit("<th>")[-1]: row for row in table.split("<tr>")}
    for verdict in verdicts.to_dict("records"):
        row = rows[verdict["component"]]
        for value in (f"{verdict['effect']:.4f}", f"{verdict['lower']:.4f}", verdict["verdict"]):
            assert f"<td>{value}</td>" in row


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PICTURES if name != "paper_table2"])  # it needs all seven networks
def test_it_runs_on_a_study(name: str, study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ABLATE_STUDY", str(study))
    before = {path for path in study.parent.rglob("*") if path.is_file()}
    assert pictures_in(execute(name)) == PICTURES[name]
    assert {path for path in study.parent.rglob("*") if path.is_file()} == before  # it reads, and writes nothing
    assert not (FOLDER / "runs").exists()


@pytest.mark.slow
def test_the_table_of_the_paper_is_read_from_what_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ABLATE_STUDY", str(ROOT / "docs" / "results" / "table2"))
    assert pictures_in(execute("paper_table2")) == PICTURES["paper_table2"]


@pytest.mark.slow
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
