"""Run the notebooks and keep each with its outputs beside its source, as notebooks/NAME.ipynb.

make notebooks
python scripts/notebooks.py verdicts          # only this one

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

_made = study.usable.runs[0].spec["semantic"]
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
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(names):
        parser.error(f"{', '.join(sorted(unknown))}: no such notebook, allowed are {', '.join(names)}")
    for name in tqdm(arguments.names or names, unit="notebook"):
        source = FOLDER / f"{name}.py"
        notebook = jupytext.read(source)
        execute(notebook)
        keep(notebook, source.with_suffix(".ipynb"))


if __name__ == "__main__":
    main()
