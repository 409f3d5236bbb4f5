"""A preview shows the frame that the data set holds or will hold, and leaves the data set alone."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from matplotlib.image import imread

from ablate.analysis import Preview
from ablate.analysis.figures import body_view
from ablate.dataset import open_pairs
from ablate.settings.study import ConfigurationError
from ablate.tasks import render as module
from support.studies import run

TINY = ["preset=tiny", "simulator.image_shape=[64,89]"]


@pytest.fixture(params=["fetal", "folder"])
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> list[str]:
    """The overrides that name a small scene."""
    if request.param == "fetal":
        return ["scene.triangles=6000", "dataset.grid=[3,4,1,1]"]
    folder = tmp_path / "ball"
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=60).export(folder / "body.obj")
    trimesh.creation.icosphere(3, radius=20).export(folder / "organ.obj")
    sites = {"heights": [-15, 0, 15], "angles": [-40, -10, 10, 40, 180], "axis": [0, 0, 1], "region": ["organ.obj"]}
    structures = [{"mesh": "body.obj", "tissue": "fat"}, {"mesh": "organ.obj", "tissue": "bone"}]
    (folder / "scene.yaml").write_text(yaml.safe_dump({"structures": structures, "sites": sites}))
    return ["scene=folder", f"scene.folder={folder}", "dataset.grid=null"]


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body_view, "_COLUMNS_PX", 150)


def test_a_frame_is_shown_before_and_after_it_is_simulated(
    scene: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [f"runs_dir={tmp_path / 'runs'}", *TINY, *scene, "frame=7"]
    shown: list[Preview] = []

    def keep(_body: object, _probe: object, preview: Preview, path: Path) -> Path:
        shown.append(preview)
        return path

    assert run("task=preview", *arguments) == 0
    path = Path(capsys.readouterr().out.strip())
    assert imread(path)[..., :3].std() > 0.05
    assert [p.name for p in path.parent.iterdir()] == ["preview_7.png"], "nothing else is made"
    monkeypatch.setattr(module, "preview_figure", keep)
    run("task=preview", *arguments)
    run("task=simulate", *arguments)
    pairs = open_pairs(path.parent)
    monkeypatch.setattr(module, "Simulator", lambda *_, **__: pytest.fail("the frame is on disk"))
    run("task=preview", *arguments)
    before, after = shown
    for preview in shown:
        np.testing.assert_array_equal(preview.image, pairs.read("target", [7])[0])
        np.testing.assert_array_equal(preview.segmentation, pairs.read("segmentation", [7])[0])
        np.testing.assert_array_equal(preview.pose, pairs.poses[7])
    assert before.title == after.title
    assert "frame 7 of 12" in after.title
    about = json.loads((path.parent / "about.json").read_text())
    assert about["poses"]["usable"] >= 12
    assert set(about["poses"]["dropped"].values()) == {0}


@pytest.mark.parametrize("frame", [12, -1])
def test_a_frame_that_is_not_there_is_refused(tmp_path: Path, frame: int) -> None:
    arguments = [f"runs_dir={tmp_path}", *TINY, "dataset.grid=[3,4,1,1]", "task=preview", f"frame={frame}"]
    with pytest.raises(ConfigurationError, match=rf"^frame={frame}: allowed are 0 to 11$"):
        run(*arguments)


def test_dropped_poses_are_counted_told_and_kept_with_the_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The organ lies behind: of 18 poses those that face away from it miss it, and all the others are used."""
    folder = tmp_path / "ball"
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=90).export(folder / "body.obj")
    organ = trimesh.creation.icosphere(3, radius=10)
    organ.apply_translation((0, 70, 0))
    organ.export(folder / "organ.obj")
    sites = {"heights": [-10, 0, 10], "angles": [0, 30, 150, 180, 210, 330], "region": "organ.obj"}
    structures = [{"mesh": "body.obj", "tissue": "fat"}, {"mesh": "organ.obj", "tissue": "liver"}]
    (folder / "scene.yaml").write_text(yaml.safe_dump({"structures": structures, "sites": sites}))
    where = ["scene=folder", f"scene.folder={folder}", "dataset.grid=null", "probe.depth_mm=120"]
    run("task=simulate", f"runs_dir={tmp_path / 'runs'}", *TINY, *where)
    about = json.loads(next(tmp_path.glob("runs/data/*/about.json")).read_text())
    assert about["poses"] == {
        "usable": 9,
        "dropped": {
            "the direction misses the body": 0,
            "part of the face has no body before it": 0,
            "the face lies in bone or gas": 0,
            "the fan misses the region of interest": 9,
        },
    }
    told = capsys.readouterr()
    assert "9 probe poses at 9 sites; dropped 9: 9 the fan misses the region of interest; 9 of 12 frames" in (
        told.out + told.err
    )
    with pytest.raises(ConfigurationError, match="frame=9: allowed are 0 to 8"):
        run("task=preview", "frame=9", f"runs_dir={tmp_path / 'runs'}", *TINY, *where)
