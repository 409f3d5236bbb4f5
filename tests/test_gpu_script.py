"""benchmarks/gpu.py, dry: tiny sizes on a CPU, without the packages that a machine with a GPU lacks."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "benchmarks"))
import gpu_parts  # noqa: E402
from gpu_carried import Carried, make_carried  # noqa: E402
from gpu_parts import Place, measure, names  # noqa: E402
from gpu_results import add_weights, read_rows, value_of  # noqa: E402

_LACKING = ("numba", "embreex", "trimesh", "hydra", "mlflow", "zarr", "numcodecs", "google_crc32c")
_WITHOUT = """
import runpy, sys
class Lacking:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {lacking}:
            raise ImportError(name + " is not on the machine with the GPU")
sys.meta_path.insert(0, Lacking())
sys.argv = {argv}
sys.path.insert(0, {benchmarks!r})
runpy.run_path({script!r}, run_name="__main__")
"""


@pytest.fixture(scope="module")
def carried(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gpu") / "carried"
    make_carried(folder, study_frames=8, paper_frames=4, tiny=True)
    return folder


def test_every_test_that_needs_a_gpu_is_run_by_the_script() -> None:
    marked = {str(f.relative_to(ROOT)) for f in ROOT.glob("tests/*/*.py") if "pytest.mark.gpu" in f.read_text()}
    assert set(gpu_parts.TESTS) == marked
    waiting = {f for f in ROOT.glob("tests/*/*.py") if "skipif(not torch.cuda.is_available()" in f.read_text()}
    assert {str(f.relative_to(ROOT)) for f in waiting} == marked


@pytest.mark.slow
def test_all_parts_run_on_a_cpu(carried: Path, tmp_path: Path) -> None:
    import torch

    out, working = tmp_path / "out", tmp_path / "working"
    out.mkdir()
    working.mkdir()
    place = Place(Carried(carried), out, working, torch.device("cpu"), 60.0)
    todo = names(place.carried, place.device)
    assert [part for part, _ in todo] == sorted(part for part, _ in todo)
    assert {part for part, _ in todo} == set("abcdef")
    found = {}
    for part, name in todo:
        if part != "a":
            found[part, name] = {row[1]: row[2] for row in measure(place, part, name)}
    assert all(np.isfinite(list(values.values())).all() for values in found.values())
    signal = found["b", "pose 0"]
    assert signal["apart from the whole simulator, at most"] <= 1
    assert signal["cpu: scatterers"] < signal["cpu: whole"]
    for part in "ef":
        runs = [values for (p, _), values in found.items() if p == part]
        assert len(runs) == 2
        assert all(0 < values["mae_fan"] < 255 and values["weights kept"] for values in runs)
    assert len((out / "scores.csv").read_text().splitlines()) > 10
    assert sum(f.is_file() for f in out.iterdir()) <= 8


@pytest.mark.slow
def test_it_needs_few_packages_and_goes_on_where_it_stopped(carried: Path, tmp_path: Path) -> None:
    script, out = ROOT / "benchmarks" / "gpu.py", tmp_path / "out"
    argv = [
        "gpu.py",
        "run",
        str(carried),
        str(out),
        "--parts",
        "b",
        "--device",
        "cpu",
        "--working",
        str(tmp_path / "w"),
    ]
    words = {"lacking": _LACKING, "benchmarks": str(script.parent), "script": str(script)}
    one = [*argv, "--minutes", "1", "--one", "b", "pose 1"]
    out.mkdir()
    done = subprocess.run([sys.executable, "-c", _WITHOUT.format(argv=one, **words)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "apart from the whole simulator" in done.stdout

    def run(minutes: float) -> str:
        command = [sys.executable, str(script), *argv[1:], "--minutes", str(minutes)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    assert "The time is up" in run(0)
    assert "All is measured" in run(9)
    rows = read_rows(out)
    assert value_of(rows, "b", "pose 1", "apart from the CPU here, at most") == 0
    assert "All is measured" in run(9)
    assert read_rows(out) == rows


def test_weights_go_into_archives_that_stay_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    import gpu_results

    monkeypatch.setattr(gpu_results, "_LARGEST", 30_000)
    kept = [add_weights(tmp_path, f"run{n}", torch.nn.Linear(100, 100)) for n in range(6)]  # 20 kB each
    assert kept == [True] * 4 + [False] * 2
    assert len(list(tmp_path.glob("weights_*.zip"))) == 4
