"""What is kept of compiled functions follows the sources; without a place to keep it they work all the same."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from numba import jit

from ablate.ultrasound import compiled
from ablate.ultrasound.surfaces.embree import closest_of
from ablate.ultrasound.transport.advance import advance

SOURCES = {
    "__init__.py": "",
    "inner.py": "from room.compiled import compiled\n\n@compiled\ndef one(x):\n    return x + 1\n",
    "outer.py": "from room.compiled import compiled\nfrom room.inner import one\n\n"
    "@compiled\ndef two(x):\n    return one(one(x))\n\nprint(two(0))\n",
}


def test_a_change_in_another_file_is_compiled_in(tmp_path: Path) -> None:
    """`outer` calls `inner`. Numba alone would not notice a change of `inner` only."""
    room = tmp_path / "room"
    room.mkdir()
    shutil.copy(compiled.__file__, room)
    for name, source in SOURCES.items():
        (room / name).write_text(source)
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {"PYTHONPATH": str(tmp_path)}

    def result() -> int:
        command = [sys.executable, "-m", "room.outer"]
        done = subprocess.run(command, env=environment, cwd=tmp_path, check=True, capture_output=True, text=True)
        return int(done.stdout)

    assert result() == 2
    assert list(room.glob("__pycache__/compiled-*/**/*.nbi")), "compiled code is kept on disk"
    inner = room / "inner.py"
    inner.write_text(inner.read_text().replace("x + 1", "x + 10"))
    assert result() == 20


def test_without_a_place_of_its_own_or_a_home_it_works_and_leaves_nothing(tmp_path: Path) -> None:
    room, temporary = tmp_path / "room", tmp_path / "temporary"
    for folder in (room, temporary):
        folder.mkdir()
    for name, source in SOURCES.items():
        (room / name).write_text(source)
    source = Path(compiled.__file__).read_text()
    (room / "compiled.py").write_text(source.replace("os.access(_ROOM, os.W_OK)", "False"))  # root may write anywhere
    kept = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment = {**kept, "PYTHONPATH": str(tmp_path), "TMPDIR": str(temporary)}
    environment["NUMBA_CACHE_LOCATOR_CLASSES"] = "UserProvidedCacheLocator"
    command = [sys.executable, "-m", "room.outer"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == "2\n"
    assert done.stderr.count("NUMBA_CACHE_DIR=<folder>") == 1
    assert not list(temporary.iterdir())


def test_a_step_counts_no_references_to_arrays() -> None:
    """They are counted with locks: of every array, at every ray, by all threads."""

    def first_or_second(arrays: tuple[np.ndarray, np.ndarray], number: int) -> float:
        chosen = arrays[0] if number > 0 else arrays[1]
        return chosen[number]

    counted = {}
    for name, options in {"compiled": closest_of.targetoptions, "step": advance.targetoptions}.items():
        function = jit(**{**options, "cache": False})(first_or_second)
        assert function((np.arange(3.0), np.arange(3.0) + 9), 2) == 2
        (llvm,) = function.inspect_llvm().values()
        counted[name] = "@NRT_" in llvm
    assert counted == {"compiled": True, "step": False}
