"""Run the notebooks and keep each with its outputs beside its source, as notebooks/NAME.ipynb.

make notebooks
python scripts/notebooks.py verdicts          # only this one

The sources are notebooks/NAME.py. They read the studies that `make sweep` and `make answer` left in `runs/`.
"""

import argparse
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from tqdm import tqdm

FOLDER = Path(__file__).parents[1] / "notebooks"


def keep_with_outputs(source: Path) -> None:
    """Run a notebook in its folder and write it whole; one that fails raises CellExecutionError and writes nothing."""
    notebook = jupytext.read(source)
    NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(FOLDER)}}).execute()
    for number, cell in enumerate(notebook.cells):  # the same files from the same run
        cell["id"] = f"{source.stem}-{number}"
        cell["metadata"].pop("execution", None)
        if "outputs" in cell:  # warnings name folders of this machine
            cell["outputs"] = [output for output in cell["outputs"] if output.get("name") != "stderr"]
    notebook["metadata"].pop("jupytext", None)
    nbformat.write(notebook, source.with_suffix(".ipynb"))


def main() -> None:
    """Run all notebooks, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = sorted(path.stem for path in FOLDER.glob("*.py"))
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of {', '.join(names)}; all where none is given")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(names):
        parser.error(f"{', '.join(sorted(unknown))}: no such notebook, allowed are {', '.join(names)}")
    for name in tqdm(arguments.names or names, unit="notebook"):
        keep_with_outputs(FOLDER / f"{name}.py")


if __name__ == "__main__":
    main()
