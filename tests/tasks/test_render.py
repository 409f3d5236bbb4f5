"""Frames as files and drawn with their probe: what a data set holds at the same pose, bit for bit."""

import json
from pathlib import Path

import numpy as np
import pydicom
import pytest
import trimesh
from matplotlib.image import imread
from PIL import Image, ImageSequence

from ablate.command.labels import frame_words
from ablate.dataset import open_pairs
from ablate.settings.conf import build
from ablate.settings.study import ConfigurationError
from ablate.tasks import render as tasks_render
from ablate.ultrasound import Simulator, SimulatorSettings
from ablate.ultrasound.settings import probe_from
from support.scene_folders import ball_folder
from support.studies import run


@pytest.fixture
def arguments(tmp_path: Path) -> list[str]:
    """A small scene, and five poses that slide over it."""
    sites = {"heights": [-15, 0, 15], "angles": [-40, -10, 10, 40], "axis": [0, 0, 1]}
    folder = ball_folder(tmp_path / "ball", sites)
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (5, 1, 1))
    poses[:, 2, 3], poses[:, 0, 3] = 55, np.linspace(-10, 10, 5)
    np.save(tmp_path / "slide.npy", poses)
    where = ["scene=folder", f"scene.folder={folder}", f"runs_dir={tmp_path / 'runs'}", "dataset.grid=null"]
    return ["preset=tiny", "simulator.image_shape=[64,89]", *where]


def test_a_frame_is_the_one_of_the_data_set(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("task=render", "frame=7", *arguments) == 0
    folder = Path(capsys.readouterr().out.strip())
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(before) == ["attenuation.png", "frame.npz", "image.png", "segmentation.png", "settings.json"]
    run("task=simulate", *arguments)
    pairs = open_pairs(next((tmp_path / "runs" / "data").glob("ball-*")))
    assert np.array_equal(np.array(Image.open(folder / "image.png")), pairs.read("target", [7])[0])
    labels = np.array(Image.open(folder / "segmentation.png"))  # exact to the pixel; stored are those of scanlines
    assert (labels == pairs.read("segmentation", [7])[0]).mean() > 0.95
    attenuation = np.array(Image.open(folder / "attenuation.png"))
    assert attenuation.dtype == np.uint16
    assert attenuation / 65535 == pytest.approx(pairs.read("attenuation", [7])[0], rel=0.004, abs=1e-4)
    capsys.readouterr()
    assert run("task=render", "frame=7", *arguments) == 0
    assert (folder / "image.png").read_bytes() == before["image.png"]


def test_what_is_written_is_enough_to_make_the_frame_again(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "one.npy", np.load(tmp_path / "slide.npy")[:1])
    run("task=render", f"pose={tmp_path / 'one.npy'}", *arguments)
    folder = Path(capsys.readouterr().out.strip())
    assert folder == tmp_path / "runs" / "render" / "ball-one.image_shape-64_89.preset-tiny"
    made_with = json.loads((folder / "settings.json").read_text())
    from ablate.anatomy import load_scene

    scene = load_scene(made_with["scene"]["folder"])
    simulator = Simulator(scene, probe_from(made_with["probe"]), build(SimulatorSettings, made_with["simulator"]))
    frame = simulator.render(np.array(made_with["poses"][0]), seed=made_with["seed"])
    with np.load(folder / "frame.npz") as held:
        assert np.array_equal(held["envelope"], frame.envelope)
        assert np.array_equal(held["image"], frame.image)
    assert made_with["labels"] == {"0": "outside the fan", "1": "coupling_gel", "2": "liver"}
    probe = probe_from(made_with["probe"])
    width = 2 * (probe.radius_mm + probe.depth_mm) * np.sin(np.deg2rad(probe.fov_deg) / 2)
    assert 89 * made_with["pixel_mm"]["width"] == pytest.approx(width)


def test_gain_brightens_the_picture_alone_and_stands_in_the_name_of_its_folder(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Between black and white 6 dB are a tenth of 60 dB; the envelope before the gain stays, and so do the maps."""
    images, envelopes, folders = [], [], []
    for gain in ([], ["gain_db=6"]):
        run("task=render", "frame=7", "simulator.dynamic_range_db=60", *gain, *arguments)
        folders.append(Path(capsys.readouterr().out.strip()))
        images.append(np.array(Image.open(folders[-1] / "image.png"), float))
        with np.load(folders[-1] / "frame.npz") as held:
            envelopes.append(held["envelope"])
    assert [folder.name for folder in folders] == [
        "ball-frame_7.dynamic_range_db-60.image_shape-64_89.preset-tiny",
        "ball-frame_7.dynamic_range_db-60.gain_db-6.image_shape-64_89.preset-tiny",
    ]
    between = (images[0] > 60) & (images[0] < 180)
    assert between.sum() > 100
    assert np.median((images[1] - images[0])[between]) == pytest.approx(255 * 6 / 60, abs=1)
    assert np.array_equal(*envelopes)
    assert json.loads((folders[1] / "settings.json").read_text())["gain_db"] == 6


def test_a_file_of_poses_may_have_a_long_name(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A letter of Chinese takes three bytes, and a name 255 at most."""
    poses = tmp_path / f"{80 * '位'}.npy"
    np.save(poses, np.load(tmp_path / "slide.npy")[:1])
    assert run("task=render", f"pose='{poses}'", *arguments) == 0
    assert Path(capsys.readouterr().out.strip()).name.startswith(f"ball-{65 * '位'}")


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ([], ""),
        (["probe=linear", "probe.depth_mm=60", "gain_db=-6"], "depth_mm-60.gain_db--6.probe-linear"),
        (["simulator.rays=8", "simulator.rays=64", "scene.anatomy_seed=3"], "anatomy_seed-3.rays-64"),
        (["task=render", "plane=head", "scene=folder", "scene.folder=/a/b", "runs_dir=c", "model.depth=6"], ""),
        (["simulator.time_gain_db=[0,1.5,2.5,3.5,4.5,5.5,6.5,7.5]"], ""),
    ],
)
def test_a_folder_is_called_by_what_is_typed_of_its_frame(words: list[str], name: str) -> None:
    assert frame_words(words) == name


def test_one_pose_is_a_cine_of_one_frame_in_dicom(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    run("task=render", "frame=0", "dataset.format=dicom", *arguments)
    folder = Path(capsys.readouterr().out.strip())
    held = pydicom.dcmread(folder / "cine.dcm")
    assert held.NumberOfFrames == 1
    assert np.array_equal(held.pixel_array.reshape(held.Rows, -1), np.array(Image.open(folder / "image.png")))


def test_several_poses_are_a_cine(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run("task=render", f"pose={tmp_path / 'slide.npy'}", "dataset.format=dicom", *arguments)
    folder = Path(capsys.readouterr().out.strip())
    held = pydicom.dcmread(folder / "cine.dcm")
    assert (held.SOPClassUID.name, held.NumberOfFrames) == ("Ultrasound Multi-frame Image Storage", 5)
    assert np.array_equal(held.pixel_array, [np.array(Image.open(folder / f"image_{i:04d}.png")) for i in range(5)])
    with Image.open(folder / "cine.gif") as cine:
        shown = [np.array(frame.convert("L")) for frame in ImageSequence.Iterator(cine)]
    assert len(shown) == 5
    for i, image in enumerate(shown):
        assert np.array_equal(image, np.array(Image.open(folder / f"image_{i:04d}.png")))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["plane=head"], "plane=head: scene=folder has no planes; allowed are pose and frame"),
        (["plane=hed", "scene=fetal"], "plane=hed: allowed are head, abdomen"),
        (["plane=head", "pose=p.npy"], "pose=p.npy, plane=head: allowed is one of them, with task=render"),
        (["pose=p.npy", "task=preview"], "pose=p.npy, plane=None: allowed is one of them, with task=render"),
        (["pose=nowhere.npy"], "pose=nowhere.npy: no such file"),
        (["frame=100"], "frame=100: allowed are 0 to 11"),
    ],
)
def test_what_cannot_be_rendered_is_one_line(arguments: list[str], more: list[str], message: str) -> None:
    if "scene=fetal" in more:
        arguments = ["preset=tiny", arguments[-2], "scene.triangles=4000"]
    with pytest.raises(ConfigurationError) as caught:
        run("task=render", *arguments, *more)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_plane_of_the_built_in_anatomy_shows_the_head(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    size = "simulator.image_shape=[64,89]"
    run("task=render", "plane=head", "preset=tiny", size, f"runs_dir={tmp_path / 'runs'}", "scene.triangles=6000")
    folder = Path(capsys.readouterr().out.strip())
    labels = json.loads((folder / "settings.json").read_text())["labels"]
    shown = np.unique(np.array(Image.open(folder / "segmentation.png")))
    assert "brain" in {labels[str(label)] for label in shown}


TINY = ["preset=tiny", "simulator.image_shape=[64,89]"]


@pytest.fixture(params=["fetal", "folder"])
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> list[str]:
    """The overrides that name a small scene."""
    if request.param == "fetal":
        return ["scene.triangles=6000", "dataset.grid=[3,4,1,1]"]
    sites = {"heights": [-15, 0, 15], "angles": [-40, -10, 10, 40, 180], "axis": [0, 0, 1], "region": ["organ.obj"]}
    folder = ball_folder(tmp_path / "ball", sites, organ=trimesh.creation.icosphere(3, radius=20))
    return ["scene=folder", f"scene.folder={folder}", "dataset.grid=null"]


def test_a_frame_is_shown_before_and_after_it_is_simulated(
    scene: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [f"runs_dir={tmp_path / 'runs'}", *TINY, *scene, "frame=7"]
    shown: list[tuple[str, tuple[np.ndarray, ...]]] = []

    def keep(path: Path, title: str, _scene: object, _probe: object, *maps: np.ndarray) -> Path:
        shown.append((title, maps[:3]))
        return path

    assert run("task=preview", *arguments) == 0
    path = Path(capsys.readouterr().out.strip())
    assert imread(path)[..., :3].std() > 0.05
    assert [p.name for p in path.parent.iterdir()] == ["preview_7.png"], "nothing else is made"
    monkeypatch.setattr(tasks_render, "preview_figure", keep)
    run("task=preview", *arguments)
    run("task=simulate", *arguments)
    pairs = open_pairs(path.parent)
    monkeypatch.setattr(tasks_render, "simulators_of", lambda *_, **__: pytest.fail("the frame is on disk"))
    run("task=preview", *arguments)
    for _, (pose, image, segmentation) in shown:
        np.testing.assert_array_equal(image, pairs.read("target", [7])[0])
        assert (segmentation == pairs.read("segmentation", [7])[0]).mean() > 0.95
        np.testing.assert_array_equal(pose, pairs.poses[7])
    assert shown[0][0] == shown[1][0]
    assert "frame 7 of 12" in shown[0][0]
    about = json.loads((path.parent / "about.json").read_text())
    assert about["poses"]["usable"] >= 12
    assert set(about["poses"]["dropped"].values()) == {0}


def test_dropped_poses_are_counted_told_and_kept_with_the_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The organ lies behind: of 18 poses those that face away from it miss it, and all the others are used."""
    organ = trimesh.creation.icosphere(3, radius=10).apply_translation((0, 70, 0))
    sites = {"heights": [-10, 0, 10], "angles": [0, 30, 150, 180, 210, 330], "region": "organ.obj"}
    folder = ball_folder(tmp_path / "ball", sites, 90, organ)
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
    of_moved = [line for line in told.err.splitlines() if line.startswith("simulate test frames after a motion")]
    assert of_moved, "they are not counted as frames of the data set"
    with pytest.raises(ConfigurationError, match="frame=9: allowed are 0 to 8"):
        run("task=preview", "frame=9", f"runs_dir={tmp_path / 'runs'}", *TINY, *where)
