"""Run the notebooks and keep each with its outputs beside its source, as notebooks/NAME.ipynb.

make notebooks
python scripts/notebooks.py verdicts          # only this one
python scripts/notebooks.py --sources         # take over changes that change no output, such as the name of a module

The sources are notebooks/NAME.py. They read the studies that `make sweep` and `make answer` left in `runs/`. Each kept
notebook names, in its metadata, the study that it was run on and the versions that this study was made with.
"""

import argparse
import json
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from tqdm import tqdm

FOLDER = Path(__file__).parents[1] / "notebooks"
# Run behind the last cell of a notebook, and taken out again: every notebook calls its study `study`.
WHICH_STUDY = """
import json

_made = study.usable.runs[0].identity
_about = {"study": study.folder.name, "simulator_version": _made["data"].get("simulator_version")}
print(json.dumps(_about | {"training_version": _made["training_version"]}))
"""


def execute(notebook: NotebookNode) -> None:
    """Run it in its folder, and note its study in its metadata; a cell that fails raises CellExecutionError."""
    notebook.cells.append(nbformat.v4.new_code_cell(WHICH_STUDY))
    NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(FOLDER)}}).execute()
    asked = notebook.cells.pop()
    printed = "".join(output["text"] for output in asked["outputs"] if output.get("name") == "stdout")
    notebook["metadata"]["ablate"] = json.loads(printed)


def take_over(notebook: NotebookNode, file: Path) -> NotebookNode:
    """The kept notebook with the sources of this one, cell by cell; other cells than before are a ValueError."""
    kept = nbformat.read(file, as_version=4)
    for old, new in zip(kept.cells, notebook.cells, strict=True):
        if old.cell_type != new.cell_type:
            raise ValueError(f"{file.name} has other cells than its source: run it")
        old["source"] = new.source
    return kept


def keep(notebook: NotebookNode, file: Path) -> None:
    """Write a notebook without what differs between two runs: ids, times, and warnings with folders of this machine."""
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"{file.stem}-{number}"
        cell["metadata"].pop("execution", None)
        if "outputs" in cell:
            cell["outputs"] = [output for output in cell["outputs"] if output.get("name") != "stderr"]
    notebook["metadata"].pop("jupytext", None)
    nbformat.write(notebook, file)


def main() -> None:
    """Run all notebooks, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = sorted(path.stem for path in FOLDER.glob("*.py"))
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(names)}; all where none is given")
    parser.add_argument("--sources", action="store_true", help="run nothing, and keep the outputs that there are")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(names):
        parser.error(f"{', '.join(sorted(unknown))}: no such notebook, allowed are {', '.join(names)}")
    for name in tqdm(arguments.names or names, unit="notebook"):
        source = FOLDER / f"{name}.py"
        kept = source.with_suffix(".ipynb")
        notebook = jupytext.read(source)
        if arguments.sources:
            notebook = take_over(notebook, kept)
        else:
            execute(notebook)
        keep(notebook, kept)


if __name__ == "__main__":
    main()
