"""A data set at poses of the user's own: which frames it has, what it is known by, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from ablate.command.checks import check
from ablate.command.compose import jobs_of
from ablate.settings.study import ConfigurationError
from ablate.sources.prepare import prepare_data
from ablate.sources.simulated import lay_out
from ablate.sources.source import source_of
from ablate.study.job import trainings_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A scene without probe sites, and eleven poses above it, 2 mm apart along x."""
    trimesh.creation.icosphere(2, radius=60).export(tmp_path / "body.obj")
    (tmp_path / "scene.yaml").write_text("structures: [{mesh: body.obj, tissue: liver}]\n")
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (11, 1, 1))
    poses[:, 2, 3], poses[:, 0, 3] = 58, np.linspace(0, 20, 11)
    np.save(tmp_path / "poses.npy", poses)
    return tmp_path


def arguments(folder: Path, *more: str) -> list[str]:
    own = f"dataset.poses={folder / 'poses.npy'}"
    return ["preset=tiny", "scene=folder", f"scene.folder={folder}", f"runs_dir={folder / 'runs'}", own, *more]


def test_all_poses_are_frames_and_need_no_sites(folder: Path) -> None:
    jobs = jobs_of(arguments(folder, "dataset.frames=11"))
    check(jobs)
    layout = lay_out(jobs[0].settings, *source_of(jobs[0].settings).scene())
    assert sorted(layout.poses[:, 0, 3]) == pytest.approx(np.linspace(0, 20, 11))
    assert sorted(layout.sites) == list(range(11))


def test_poses_decide_and_where_they_lie_does_not(folder: Path) -> None:
    def data(poses: str) -> str:
        (job,) = jobs_of([*arguments(folder)[:-1], *([f"dataset.poses={folder / poses}"] if poses else [])])
        return job.data.name

    without, own = data(""), data("poses.npy")
    (folder / "poses.npy").rename(folder / "moved.npy")
    assert data("moved.npy") == own != without
    np.save(folder / "moved.npy", np.load(folder / "moved.npy")[::-1])
    assert data("moved.npy") != own


def test_what_places_a_grid_decides_nothing_and_files_that_were_edited_since_are_refused(folder: Path) -> None:
    jobs = jobs_of(["-m", *arguments(folder), "dataset.press_mm=4,8"])
    assert [one.label for one in trainings_of(jobs)] == [jobs[0].label], "one training"
    (job,) = jobs_of(arguments(folder))
    assert job.identity["data"]["dataset"]["poses"]
    np.save(folder / "poses.npy", np.load(folder / "poses.npy")[::-1])
    with pytest.raises(ConfigurationError, match="its files were edited since the command began; repeat the command"):
        prepare_data(job.settings, job.data, job.identity["data"], frozenset())


@pytest.mark.parametrize(("apart_mm", "said"), [(0.3, True), (4.0, False)])
def test_poses_that_nearly_coincide_are_said_though_each_is_a_site(folder: Path, apart_mm: float, said: bool) -> None:
    poses = np.load(folder / "poses.npy")
    poses[:, 0, 3] = apart_mm * np.arange(11)
    np.save(folder / "poses.npy", poses)
    (job,) = jobs_of(arguments(folder, "dataset.frames=11"))
    data = prepare_data(job.settings, job.data, job.identity["data"], frozenset({"segmentation", "target"}))
    lines = [line for line in data.about["left_out"] if "of a training frame" in line]
    assert bool(lines) == said
    assert not said or "(the nearest 0.3 mm)" in lines[0]


def test_a_preset_asks_for_no_more_frames_than_there_are_poses(folder: Path) -> None:
    np.save(folder / "poses.npy", np.load(folder / "poses.npy")[:2])
    with pytest.raises(ConfigurationError, match=r"^training\.batch_size=3: more than the 1 training frames"):
        check(jobs_of([*arguments(folder), "training.batch_size=3"]))
