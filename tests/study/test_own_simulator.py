"""`scene.target`: a data set by a function of the user's own, as the page prints it; known by its code, resumed."""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh

from ablate.command.compose import jobs_of
from ablate.dataset import Pairs, Part, Recipe
from ablate.dataset.simulate import frame_simulator
from ablate.metrics import mae
from ablate.settings.study import ConfigurationError
from ablate.sources.prepare import prepare_data
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.tasks.entry import execute
from ablate.ultrasound import OwnSimulatorError
from support.scripts import ROOT
from support.studies import run

MAPS = frozenset({"segmentation", "attenuation", "target", "resimulation"})
PAGE = (ROOT / "docs" / "own_simulator.md").read_text("utf-8")
(EXAMPLE,) = re.findall(r"```python\n# my_simulators\.py\n(.*?)```", PAGE, re.S)
SIZES = ["preset=tiny", "dataset.frames=6", "dataset.shard=1"]


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The file of the page."""
    file = tmp_path / "my_simulators.py"
    file.write_text(EXAMPLE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_simulators", raising=False)
    yield file
    sys.modules.pop("my_simulators", None)


def job_of(folder: Path, *more: str) -> Job:
    (job,) = jobs_of([*SIZES, "scene.target=my_simulators.blurred", f"runs_dir={folder / 'runs'}", *more])
    return job


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.suffix != ".lock"
    }


def made(job: Job) -> Pairs:
    return prepare_data(job.settings, job.data, job.identity["data"], MAPS).pairs


def test_the_command_of_the_page_makes_pairs_that_a_network_is_trained_on(module: Path) -> None:
    """Labels and attenuation are ours; the image is the function's, and another seed gives another speckle."""
    assert "scene.target=my_simulators.blurred" in PAGE
    results = f"runs_dir={module.parent / 'runs'}"
    sizes = [*SIZES, "dataset.workers=1", "training.steps=2", "metrics=[psnr,mae]", results]
    assert run("variant=lsa2h", "scene.target=my_simulators.blurred", *sizes) == 0
    assert len(list((module.parent / "runs/tiny-fetal").glob("lsa2h-seed0-*/trained.json"))) == 1
    (job,) = jobs_of([*sizes, "scene.target=my_simulators.blurred"])
    (ours,) = jobs_of(sizes)
    theirs, usual = job.data.pairs, made(ours)
    frames = theirs.frames(Part.test)
    for name in ("segmentation", "attenuation"):
        np.testing.assert_array_equal(theirs.read(name, frames), usual.read(name, frames))
    np.testing.assert_array_equal(theirs.poses, usual.poses)
    target, again, our_target = (p.read(name, frames).astype(float) for p, name in (
        (theirs, "target"), (theirs, "resimulation"), (usual, "target")
    ))  # fmt: skip
    inside = theirs.mask()
    assert np.corrcoef(target[:, inside].ravel(), our_target[:, inside].ravel())[0, 1] > 0.6, "the same scatterers"
    for other in (again, our_target, theirs.read("low", frames)):
        assert (target != other)[:, inside].mean() > 0.3


def test_a_frame_is_rendered_and_previewed(module: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from skimage.io import imread

    job = job_of(module.parent, "dataset.workers=1")
    pairs = made(job)
    words = [*SIZES, "scene.target=my_simulators.blurred", f"runs_dir={module.parent / 'runs'}", "frame=2"]
    assert run(*words, "task=render") == 0
    folder = Path(capsys.readouterr().out.split()[-1])
    np.testing.assert_array_equal(imread(folder / "image.png"), pairs.stored("target", 2))


def test_error_against_run_time_is_that_of_its_pairs(module: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Re-simulation is as far from the reference as that of the data set; ablate's grey levels are matched."""
    job = job_of(module.parent, "dataset.workers=1", "evaluation.timed_frames=6")
    (ours,) = jobs_of([*SIZES, "dataset.workers=1", f"runs_dir={module.parent / 'runs'}"])
    pairs = made(job)
    assert run(*job.words, "task=precision") == 0
    assert "The reference is my_simulators.blurred; settings of rays" in capsys.readouterr().out
    folder = job.settings.results / "precision"
    points = pd.read_csv(folder / "precision.csv")
    found = points[points["metric"] == "mae"].set_index("setting")["error"]
    test = np.flatnonzero(pairs.split == Part.test)
    target, again = (pairs.read(name, test) for name in ("target", "resimulation"))
    theirs, unmatched = (
        np.mean([mae(*pair) for pair in zip(images, target, strict=True)])
        for images in (again, made(ours).read("resimulation", test))
    )
    assert found["my_simulators.blurred"] == pytest.approx(theirs)
    assert found[f"rays {job.settings.simulator.rays}"] < unmatched
    assert (folder / "renderers.png").exists()
    assert not (folder / "precision.png").exists(), "its rays are not varied"


def test_its_code_is_part_of_the_identity(module: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = job_of(module.parent)
    (ours,) = jobs_of([*SIZES, f"runs_dir={module.parent / 'runs'}"])
    assert "target" not in ours.identity["data"], "data sets of ours keep their hash"
    assert begun.data.name != ours.data.name
    known = begun.identity["data"]["target"]
    assert known["path"] == "my_simulators.blurred"
    assert len(known["source"]) == 64
    module.write_text(EXAMPLE + "# edited\n")
    assert job_of(module.parent).data.name == begun.data.name, "what runs is what was loaded"
    monkeypatch.delitem(sys.modules, "my_simulators")
    assert job_of(module.parent).data.name != begun.data.name
    with pytest.raises(ConfigurationError, match="its files were edited since the command began; repeat the command"):
        made(begun)


def test_a_process_that_finds_other_code_stops(module: Path) -> None:
    """A worker loads the file itself."""
    job = job_of(module.parent, "dataset.workers=1")
    pairs, scene = made(job), source_of(job.settings).scene()[0]
    recipe = Recipe(scene, job.settings.probe, job.settings.simulator, 0, "my_simulators.blurred", "that of others")
    with pytest.raises(OwnSimulatorError, match=r"my_simulators\.blurred: edited since the command began; repeat"):
        frame_simulator(recipe, pairs)


@pytest.mark.slow
def test_two_processes_give_the_bytes_of_one_and_a_killed_one_is_taken_up_again(module: Path) -> None:
    one = job_of(module.parent / "one", "dataset.workers=1")
    whole = made(one)
    two = job_of(module.parent / "two", "dataset.workers=2")
    assert contents(made(two).folder) == contents(whole.folder)

    module.write_text(EXAMPLE.replace("    lines =", "    import time; time.sleep(0.2)\n    lines =", 1))
    sys.modules.pop("my_simulators")
    slow = job_of(module.parent / "slow", "dataset.workers=1")
    command = [sys.executable, "-m", "ablate", *slow.words, "task=simulate"]
    process = subprocess.Popen(command, cwd=module.parent, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(list(slow.data.folder.glob("pairs.zarr/target/c/*/0/0"))) < 2:
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    missing = slow.data.pairs.missing(MAPS)
    assert 0 < len(missing) < 6
    first = slow.data.pairs.shard_file("target", 0)
    before = first.stat().st_mtime_ns
    resumed = made(slow)
    assert not resumed.missing(MAPS)
    assert first.stat().st_mtime_ns == before, "what is there is not made again"
    assert contents(resumed.folder / "pairs.zarr") == contents(whole.folder / "pairs.zarr")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_frame_that_fails_names_itself_and_stops_the_rest(module: Path, workers: int) -> None:
    module.write_text(
        "import numpy as np\n"
        "def blurred(echoes):\n"
        "    grey = np.zeros(echoes.settings.beam_shape)\n"
        "    if echoes.surfaces.any():\n"
        "        grey[0, 0] = np.nan\n"
        "    return grey\n"
    )
    job = job_of(module.parent, f"dataset.workers={workers}")
    named = r"^motion, frame \d: scene\.target=my_simulators\.blurred"  # frames after motions are made first
    said = f"{named}: returns 1 of 2048 values that are NaN or infinite"
    with pytest.raises(OwnSimulatorError, match=said) as error:
        made(job)
    assert "\n" not in str(error.value)
    assert not job.data.exists
    with pytest.raises(ConfigurationError, match=said):
        run(*job.words, "task=simulate")
    with pytest.raises(ConfigurationError, match=r"^scene\.target=my_simulators\.blurred: returns 1 of 2048"):
        run(*job.words, "task=precision")


def test_a_scene_of_files_is_simulated_by_it(module: Path) -> None:
    folder = module.parent / "body"
    folder.mkdir()
    trimesh.creation.icosphere(2, radius=60).export(folder / "body.obj")
    (folder / "scene.yaml").write_text("structures: [{mesh: body.obj, tissue: liver}]\n")
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (6, 1, 1))
    poses[:, 2, 3], poses[:, 0, 3] = 58, np.linspace(0, 20, 6)
    np.save(folder / "poses.npy", poses)
    own = ["scene=folder", f"scene.folder={folder}", f"dataset.poses={folder / 'poses.npy'}", "dataset.workers=1"]
    pairs = made(job_of(module.parent, *own))
    assert pairs.read("target", [0])[0].max() > 50


REFUSED = {
    "scene.target=nowhere.blurred": "scene.target=nowhere.blurred: ModuleNotFoundError",
    "scene.target=my_simulators.blured": "scene.target=my_simulators.blured: AttributeError",
    "scene.target=blurred": "scene.target=blurred: names no module; allowed is the path of a function, as my_package",
    "scene.target=my_simulators.np": "scene.target=my_simulators.np: is a module, allowed is a function",
    "simulator.compound_angles=3": "scene.target=my_simulators.blurred: allowed is compound_angles=1",
    "task=view": "task=view: shows ablate's own simulator alone; allowed with scene.target are study",
}


@pytest.mark.parametrize("word", REFUSED)
def test_what_cannot_be_done_is_refused_before_anything_is_made(module: Path, word: str) -> None:
    words = [*SIZES, f"runs_dir={module.parent / 'runs'}", word]
    if not word.startswith("scene.target"):
        words.insert(0, "scene.target=my_simulators.blurred")
    with pytest.raises(ConfigurationError) as error:
        execute(words)
    assert str(error.value).startswith(REFUSED[word])
    assert "\n" not in str(error.value)
    assert not (module.parent / "runs" / "data").exists()


def test_pairs_made_elsewhere_are_not_simulated(module: Path) -> None:
    words = ["preset=tiny", "scene=pairs", f"scene.folder={module.parent}", "scene.target=my_simulators.blurred"]
    with pytest.raises(
        ConfigurationError, match=r"^scene\.target=my_simulators\.blurred: pairs made elsewhere are not"
    ):
        execute([*words, f"runs_dir={module.parent / 'runs'}"])
