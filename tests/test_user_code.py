"""Code of the user's own is known by its sources: all that a module imports of them, and nothing else."""

import hashlib
import importlib
import sys
from pathlib import Path

import pytest
import torch

from ablate.user_code import code_digest, load

FILES = {
    "mine/__init__.py": "from mine.model import Model\n",
    "mine/model.py": "import json, numpy\nfrom . import helper\nclass Model:\n    def go(self):\n        import late\n",
    "mine/helper.py": "from constants import SCALE\n",
    "constants.py": "try:\n    import of_another_python\nexcept SyntaxError:\n    SCALE = 2\n",
    "of_another_python.py": "print 2\n",
    "late.py": "import mine.model\n",
    "unused.py": "\n",
    "site-packages/installed.py": "\n",
}

OWN = ("mine", "constants", "late", "of_another_python")


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)


def digest(folder: Path, changes: dict[str, str], path: str = "mine.Model") -> str:
    """Digest of the files with some of them changed, as a new process computes it."""
    write(folder, FILES | changes)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.syspath_prepend(folder / "site-packages")
        for name in [name for name in sys.modules if name.partition(".")[0] in OWN]:
            patch.delitem(sys.modules, name)
        computed = code_digest(path)
        for name in [name for name in sys.modules if name.partition(".")[0] in OWN]:
            del sys.modules[name]
    return computed


@pytest.mark.parametrize("file", ["mine/__init__.py", "mine/model.py", "mine/helper.py", "constants.py", "late.py"])
def test_a_change_of_any_module_behind_the_path_changes_the_digest(tmp_path: Path, file: str) -> None:
    before = digest(tmp_path / "a", {})
    assert digest(tmp_path / "b", {file: FILES[file] + "# changed\n"}) != before
    assert digest(tmp_path / "c", {}) == before, "the folder does not enter"


def test_installed_packages_and_modules_that_are_not_imported_do_not_enter(tmp_path: Path) -> None:
    imports = {"constants.py": "import installed\nSCALE = 2\n"}
    before = digest(tmp_path / "a", imports)
    other = {"site-packages/installed.py": "VERSION = 2\n", "unused.py": "VERSION = 2\n"}
    assert digest(tmp_path / "b", imports | other) == before


# Helpers beside a metric, by what the metric writes to get them; none of these modules of Python is loaded by a test.
HELPERS = {
    "wave.py": "import wave",
    "colorsys.py": "from colorsys import SCALE",
    "types_.py": "import types_",
    "sndhdr/__init__.py": "import sndhdr",
    "a_namespace/part/scale.py": "from a_namespace.part import scale",  # folders without __init__.py
    "chunk.py": "def late():\n    import chunk",
}


@pytest.mark.parametrize("file", HELPERS)
def test_a_helper_is_known_by_where_it_lies_and_not_by_its_name(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    top = file.partition("/")[0].removesuffix(".py")
    digests = []
    for content in ("SCALE = 1\n", "SCALE = 1\n", "SCALE = 2\n"):
        folder = tmp_path / str(len(digests))
        write(folder, {"a_metric.py": f"{HELPERS[file]}\ndef measure(): pass\n", file: content})
        with monkeypatch.context() as patch:
            patch.syspath_prepend(folder)
            for name in [name for name in sys.modules if name.partition(".")[0] in ("a_metric", top)]:
                patch.delitem(sys.modules, name)
            digests.append(code_digest("a_metric.measure"))
            for name in [name for name in sys.modules if name.partition(".")[0] in ("a_metric", top)]:
                del sys.modules[name]
    assert digests[0] == digests[1] != digests[2]


def test_what_python_brings_does_not_enter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`json` is loaded, so that a folder of that name is not what the import gives; nor is a module in C looked at."""
    imports = "import json, array, os.path, zoneinfo, xml.dom.minidom, encodings.idna, sys\n"
    names = ("of_python.py", "json/__init__.py")
    write(tmp_path, {names[0]: f"{imports}def measure(): pass\n", names[1]: "SCALE = 1\n"})
    monkeypatch.syspath_prepend(tmp_path)
    only = hashlib.sha256(b"of_python" + hashlib.sha256((tmp_path / names[0]).read_bytes()).digest()).hexdigest()
    assert code_digest("of_python.measure") == only


def test_what_is_loaded_keeps_its_digest_while_edited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A training takes hours; its result is stored under the code that ran."""
    write(tmp_path, {"edited_later.py": "def measure(): pass\n"})
    monkeypatch.syspath_prepend(tmp_path)
    before = code_digest("edited_later.measure")
    write(tmp_path, {"edited_later.py": "def measure(): return 1\n"})
    assert code_digest("edited_later.measure") == before
    importlib.reload(sys.modules["edited_later"])  # as in a notebook
    assert code_digest("edited_later.measure") != before


def test_a_relative_import_that_leads_nowhere_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "try:\n    from . import part\nexcept ImportError:\n    part = None\ndef measure(): pass\n"
    write(tmp_path, {"in_no_package.py": code})
    monkeypatch.syspath_prepend(tmp_path)
    assert len(code_digest("in_no_package.measure")) == 64


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("Toy", "names no module"),
        ("no_such_module.Toy", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("math.Toy", "AttributeError: module 'math' has no attribute 'Toy'"),
    ],
)
def test_what_cannot_be_loaded_is_said_in_one_line(path: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        load(path)
    with pytest.raises(ValueError, match=f"^{message}$"):
        code_digest(path)


def test_the_default_type_of_torch_that_a_module_sets_is_undone_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, {"in_double.py": "import torch\ntorch.set_default_dtype(torch.float64)\ndef measure(): pass\n"})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match="sets torch's default dtype"):
        load("in_double.measure")
    assert torch.get_default_dtype() is torch.float32
