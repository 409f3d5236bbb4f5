"""Exported data sets: what is read back is what was stored, by the readers of each format."""

import csv
import json
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pydicom
import pytest
import trimesh
import yaml
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from ablate.command.compose import jobs_of
from ablate.dataset import Pairs, Part, open_pairs
from ablate.dataset.classes import by_tissue
from ablate.dataset.dicom_files import write_cine, write_dicom
from ablate.dataset.export_formats import write_nnunet, write_png
from ablate.settings.study import ConfigurationError
from ablate.sources.data_set import DataSet
from ablate.ultrasound import ConvexProbe
from ablate.ultrasound.probe import pixel_size_mm
from support.scene_folders import ball_folder
from support.studies import run


@pytest.fixture(scope="module")
def arguments(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A small scene, whose data set has been simulated."""
    sites = {"heights": [-15, 0, 15], "angles": [-40, -10, 10, 40], "axis": [0, 0, 1]}
    folder = ball_folder(tmp_path_factory.mktemp("export") / "ball", sites)
    where = ["scene=folder", f"scene.folder={folder}", f"runs_dir={folder / 'runs'}", "dataset.grid=null"]
    made = ["preset=tiny", "simulator.image_shape=[129,179]", *where]
    run("task=simulate", *made)
    return made


def exported(arguments: list[str], form: str, capsys: pytest.CaptureFixture[str]) -> tuple[Path, Pairs]:
    """The folder that was written, and the pairs that it was written from."""
    capsys.readouterr()
    assert run("task=export", f"dataset.format={form}", *arguments) == 0
    folder = Path(capsys.readouterr().out.strip().splitlines()[-1])
    (source,) = (folder.parents[1] / "data").glob("*/about.json")
    card = (folder / "README.md").read_text()
    assert source.parent.name in card
    assert f"1 is coupling_gel, 2 is {'liver' if form == 'png' else 'body'}" in card
    return folder, open_pairs(source.parent)


def test_pngs_come_back_bit_for_bit(arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, pairs = exported(arguments, "png", capsys)
    where = ["scene=pairs", f"scene.folder={folder}", f"runs_dir={tmp_path}", "preset=tiny"]
    assert run("task=simulate", *where) == 0
    again = open_pairs(next((tmp_path / "data").glob("*/about.json")).parent)
    assert len(again) == len(pairs)
    assert again.tissues == pairs.tissues
    assert np.array_equal(again.split, pairs.split)
    for name in ("segmentation", "target", "attenuation"):
        for frame in range(len(pairs)):
            assert np.array_equal(again.stored(name, frame), pairs.stored(name, frame))
    assert again.probe is not None
    assert replace(again.probe, frequency_mhz=3) == pairs.probe
    rows = list(csv.DictReader((folder / "frames.csv").read_text().splitlines()))
    assert [row["part"] for row in rows] == [Part(part).name for part in pairs.split]


def test_nnunet_finds_what_its_description_promises(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    folder, pairs = exported(arguments, "nnunet", capsys)
    (raw,) = (path for path in folder.iterdir() if path.is_dir())
    described = json.loads((raw / "dataset.json").read_text())
    assert raw.name.startswith("Dataset001_")
    assert described["file_ending"] == ".png"
    assert described["labels"] == {"background": 0, "coupling_gel": 1, "body": 2}
    images, labels = ({p.name for p in (raw / d).iterdir()} for d in ("imagesTr", "labelsTr"))
    assert len(labels) == described["numTraining"] == int((pairs.split != Part.test).sum())
    assert images == {name.replace(".png", "_0000.png") for name in labels}
    (fold,) = json.loads((raw / "splits_final.json").read_text())
    assert sorted(fold["train"] + fold["val"]) == sorted(name.removesuffix(".png") for name in labels)
    frame = int(pairs.frames(Part.test)[0])
    held = np.array(Image.open(raw / "labelsTs" / f"frame{frame:05d}.png"))
    assert np.array_equal(held, pairs.stored("segmentation", frame))


def test_classes_are_structures_which_together_are_the_tissues(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two organs of one tissue are two classes, unless tissues are asked for; of S both are one label."""
    folder = tmp_path / "organs"
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=60).export(folder / "body.obj")
    for name, x in (("left_kidney", -12.0), ("right_kidney", 12.0)):
        organ = trimesh.creation.icosphere(2, radius=10)
        organ.apply_translation((x, -35, 0)).export(folder / f"{name}.obj")
    organs = [{"mesh": f"{name}.obj", "tissue": "kidney"} for name in ("left_kidney", "right_kidney")]
    sites = {"heights": [-6, 0, 6], "angles": [-12, -4, 4, 12], "axis": [0, 0, 1]}
    content = {"structures": [{"mesh": "body.obj", "tissue": "liver"}, *organs], "sites": sites}
    (folder / "scene.yaml").write_text(yaml.safe_dump(content))
    made = ["preset=tiny", "simulator.image_shape=[129,179]", "scene=folder", f"scene.folder={folder}"]
    made += [f"runs_dir={tmp_path / 'runs'}", "dataset.grid=null", "dataset.format=nnunet", "task=export"]
    held = {}
    for classes in ("structures", "tissues"):
        assert run(f"dataset.classes={classes}", *made) == 0
        raw = next(Path(capsys.readouterr().out.strip().splitlines()[-1]).glob("Dataset001_*"))
        labels = json.loads((raw / "dataset.json").read_text())["labels"]
        files = sorted(raw.glob("labelsT?/*.png"))
        held[classes] = labels, np.stack([np.array(Image.open(file)) for file in files])
    (of_structures, structures), (of_tissues, tissues) = held.values()
    assert of_structures.keys() == {"background", "coupling_gel", "body", "left_kidney", "right_kidney"}
    assert of_tissues.keys() == {"background", "coupling_gel", "liver", "kidney"}
    for side in ("left_kidney", "right_kidney"):
        assert (structures == of_structures[side]).sum() > 100
    both = (structures == of_structures["left_kidney"]) | (structures == of_structures["right_kidney"])
    np.testing.assert_array_equal(both, tissues == of_tissues["kidney"])
    np.testing.assert_array_equal(structures == of_structures["body"], tissues == of_tissues["liver"])


class OfTissues:
    """Pairs of one frame of 2 x 2 pixels, with tissues of these names."""

    def __init__(self, tissues: Sequence[str], labels: Sequence[int], folder: Path | None = None) -> None:
        self.tissues, self.split, self.folder = tuple(tissues), np.array([Part.train]), folder
        self.held = {"segmentation": np.uint8(labels).reshape(2, -1), "target": np.uint8(labels).reshape(2, -1)}

    def __len__(self) -> int:
        return 1

    def stored(self, name: str, _: int) -> np.ndarray:
        return self.held[name]

    def mask(self) -> np.ndarray:
        return self.held["segmentation"] > 0

    def frames(self, part: Part) -> np.ndarray:
        return np.flatnonzero(self.split == part)


def test_nnunet_counts_the_classes_that_occur(tmp_path: Path) -> None:
    tissues = ("background", "bone", "gas", "liver", "liver")
    pairs: Any = OfTissues(tissues, [0, 1, 4, 5])
    write_nnunet(pairs, tmp_path, by_tissue(pairs))
    described = json.loads((tmp_path / "dataset.json").read_text())
    assert described["labels"] == {"background": 0, "background_1": 1, "liver_4": 2, "liver_5": 3}, "names twice"
    assert np.array(Image.open(tmp_path / "labelsTr" / "frame00000.png")).tolist() == [[0, 1], [2, 3]]


@given(st.lists(st.sampled_from(["background", "liver", "liver_1", "liver_2", "liver_2_2", "ignore"]), min_size=1))
@settings(deadline=None, max_examples=30)
def test_every_class_of_nnunet_has_a_name_of_its_own(tissues: list[str]) -> None:
    labels = range(1, len(tissues) + 1)
    with TemporaryDirectory() as folder:
        pairs: Any = OfTissues(tissues, [0, *labels] * 2)
        write_nnunet(pairs, Path(folder), by_tissue(pairs))
        described = json.loads((Path(folder) / "dataset.json").read_text())["labels"]
    assert sorted(described.values()) == [0, *labels], "no name is taken twice"
    assert described["background"] == 0
    assert "ignore" not in described, "which nnU-Net leaves out of the loss"
    names = {number: name for name, number in described.items()}
    for label, tissue in zip(labels, tissues, strict=True):
        assert names[label].startswith(tissue)
        assert names[label] == tissue or tissues.count(tissue) > 1 or tissue in ("background", "ignore")


NAMES = ("coupling_gel", "肝臓", "Läppchen", "a\\b^c=d", "tab\tname", "  ", "x" * 80, "ä" * 40, "no")


def test_names_of_any_script_are_one_value_of_dicom_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pairs: Any = OfTissues(NAMES, [*range(1, len(NAMES) + 1), 1], tmp_path / "肝臓\\left-0123")
    write_dicom(pairs, tmp_path / "set", (0.3, 0.2), by_tissue(pairs))
    monkeypatch.setattr(pydicom.config.settings, "reading_validation_mode", pydicom.config.RAISE)
    image, segmented = (pydicom.dcmread(tmp_path / "set" / place / "frame00000.dcm") for place in (".", "segmentation"))
    for held in (image, segmented):
        assert held.SpecificCharacterSet == "ISO_IR 192"
        assert str(held)  # every value is converted, and checked
        assert held.PatientID == "肝臓/left-0123"
        assert held["PatientOrientation"].VM == 0
    labels = [segment.SegmentLabel for segment in segmented.SegmentSequence]
    assert labels == ["coupling_gel", "肝臓", "Läppchen", "a/b^c=d", "tab name", "label 6", "x" * 64, "ä" * 32, "no"]
    coded = [segment.SegmentedPropertyTypeCodeSequence[0] for segment in segmented.SegmentSequence]
    assert [code.CodeMeaning for code in coded] == labels
    assert len({code.CodeValue for code in coded}) == len(NAMES)
    if dciodvfy := shutil.which("dciodvfy"):  # of dicom3tools, where somebody has it
        for path in (tmp_path / "set").rglob("*.dcm"):
            said = subprocess.run([dciodvfy, path], capture_output=True, check=False).stderr.decode(errors="replace")
            assert "Error" not in said


def test_a_map_that_was_begun_and_tissues_of_ones_own_are_left_out(arguments: list[str], tmp_path: Path) -> None:
    (about,) = Path(next(a for a in arguments if a.startswith("runs_dir=")).partition("=")[2]).glob("data/*/about.json")
    begun = tmp_path / about.parent.name
    shutil.copytree(about.parent, begun)
    shutil.copytree(begun / "pairs.zarr/target", begun / "pairs.zarr/low")
    shutil.rmtree(begun / "pairs.zarr/low/c")
    tissues = DataSet(begun).tissues
    pairs = open_pairs(begun)
    assert "low" in pairs.maps
    write_png(pairs, tmp_path / "pngs", tissues)
    assert {path.name for path in (tmp_path / "pngs").iterdir()} >= {"segmentation", "image", "labels.csv"}
    assert not (tmp_path / "pngs/low").exists()
    write_png(pairs, tmp_path / "others", (tissues[0], replace(tissues[1], impedance_mrayl=7.0)))
    assert not (tmp_path / "others/labels.csv").exists()


def test_a_sweep_over_data_sets_is_refused(arguments: list[str]) -> None:
    with pytest.raises(ConfigurationError, match="task=export: a sweep over data sets; allowed is one data set"):
        run("-m", "task=export", *arguments, "dataset.seed=0,1")


def test_a_cine_is_known_by_what_it_shows(tmp_path: Path) -> None:
    mask, known = np.ones((8, 9), bool), []
    for number, (grey, pixel_mm) in enumerate([(0, 0.5), (0, 0.5), (9, 0.5), (0, 0.6)]):
        folder = tmp_path / str(number) / "fetal-sweep"
        folder.mkdir(parents=True)
        write_cine(folder / "cine.dcm", np.full((3, 8, 9), grey, np.uint8), mask, (pixel_mm, 0.5), 50.0)
        held = pydicom.dcmread(folder / "cine.dcm")
        known.append((held.SOPInstanceUID, held.SeriesInstanceUID, held.StudyInstanceUID))
        assert held.file_meta.MediaStorageSOPInstanceUID == held.SOPInstanceUID
    assert known[0] == known[1]
    assert len({uid for uids in known for uid in uids}) == 9


def test_dicom_is_valid_and_calibrated(
    arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder, pairs = exported(arguments, "dicom", capsys)
    files = sorted(folder.glob("*.dcm"))
    assert len(files) == len(pairs)
    monkeypatch.setattr(pydicom.config.settings, "reading_validation_mode", pydicom.config.RAISE)
    uids = set()
    for frame, file in enumerate(files):
        held = pydicom.dcmread(file)
        assert str(held)  # every value is converted, and checked
        assert np.array_equal(held.pixel_array, pairs.stored("target", frame))
        uids.add(held.SOPInstanceUID)
    assert len(uids) == len(pairs)
    again = Path(shutil.copytree(pairs.folder, tmp_path / pairs.folder.name))
    targets = zarr.open(again / "pairs.zarr")["target"]
    targets[0] = np.clip(targets[0], 0, 200) + np.uint8(9)  # other pixels of the same recipe, as of another processor
    write_dicom(open_pairs(again), tmp_path / "again", (0.3, 0.3), by_tissue(pairs))
    assert {pydicom.dcmread(file).SOPInstanceUID for file in (tmp_path / "again").glob("*.dcm")} != uids
    probe = pairs.probe or jobs_of(arguments)[0].settings.probe
    region = held.SequenceOfUltrasoundRegions[0]
    half = np.deg2rad(probe.fov_deg) / 2
    width_cm = 2 * (probe.radius_mm + probe.depth_mm) * np.sin(half) / 10
    height_cm = (probe.radius_mm + probe.depth_mm - probe.radius_mm * np.cos(half)) / 10
    assert region.PhysicalDeltaX * held.Columns == pytest.approx(width_cm)
    assert region.PhysicalDeltaY * held.Rows == pytest.approx(height_cm)
    assert region.PhysicalUnitsXDirection == 3
    inside = np.argwhere(pairs.mask())
    corners = (region.RegionLocationMinY0, region.RegionLocationMinX0, region.RegionLocationMaxY1)
    assert corners == (inside[:, 0].min(), inside[:, 1].min(), inside[:, 0].max())

    segmented = pydicom.dcmread(folder / "segmentation" / files[-1].name)
    assert segmented.SOPClassUID.name == "Segmentation Storage"
    assert segmented.ReferencedSeriesSequence[0].ReferencedInstanceSequence[0].ReferencedSOPInstanceUID in uids
    assert [segment.SegmentLabel for segment in segmented.SegmentSequence] == ["coupling_gel", "body"]
    labels = np.zeros(pairs.shape, np.uint8)
    for layer, of in zip(
        np.atleast_3d(segmented.pixel_array.T).T, segmented.PerFrameFunctionalGroupsSequence, strict=True
    ):
        labels[layer > 0] = of.SegmentIdentificationSequence[0].ReferencedSegmentNumber
    assert np.array_equal(labels, pairs.stored("segmentation", len(pairs) - 1))


def test_pairs_made_elsewhere_have_the_mm_of_their_fan(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, pairs = exported(arguments, "png", capsys)
    own = Path(shutil.copytree(folder, tmp_path / "own"))
    where = ["scene=pairs", f"scene.folder={own}", f"runs_dir={tmp_path}", "preset=tiny", "task=export"]
    assert run(*where, "dataset.format=dicom", "probe.radius_mm=11", "probe.depth_mm=77") == 0
    out = Path(capsys.readouterr().out.strip().splitlines()[-1])
    held = pydicom.dcmread(out / "frame00000.dcm")
    height_mm, width_mm = pixel_size_mm(pairs.probe or ConvexProbe(), pairs.shape)
    region = held.SequenceOfUltrasoundRegions[0]
    assert (10 * region.PhysicalDeltaY, 10 * region.PhysicalDeltaX) == pytest.approx((height_mm, width_mm))
    assert "imulated" not in f"{held}", "nothing is known of who made it"
    assert f"A pixel is {height_mm:.4g} mm high and {width_mm:.4g} mm wide" in (out / "README.md").read_text()
    (own / "fan.yaml").unlink()
    with pytest.raises(ConfigurationError, match=r"dataset\.format=dicom: needs .*own/fan\.yaml, which tells the mm"):
        run(*where, "dataset.format=dicom")


def test_what_cannot_be_exported_is_one_line(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pydicom", None)
    for task in ("export", "render"):
        with pytest.raises(ConfigurationError, match=r"dataset\.format=dicom: needs the package pydicom"):
            run(f"task={task}", "dataset.format=dicom", *arguments)
