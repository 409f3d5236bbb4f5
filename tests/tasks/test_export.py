"""Exported data sets: what is read back is what was stored, by the readers of each format."""

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pydicom
import pytest
import zarr
from PIL import Image

from ablate.command.compose import jobs_of
from ablate.dataset import Pairs, Part, open_pairs
from ablate.dataset.dicom_files import write_cine, write_dicom
from ablate.dataset.export_formats import write_nnunet, write_png
from ablate.settings.study import ConfigurationError
from ablate.sources.data_set import DataSet
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
    assert "1 is coupling_gel, 2 is liver" in card
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
    assert described["labels"] == {"background": 0, "coupling_gel": 1, "liver": 2}
    images, labels = ({p.name for p in (raw / d).iterdir()} for d in ("imagesTr", "labelsTr"))
    assert len(labels) == described["numTraining"] == int((pairs.split != Part.test).sum())
    assert images == {name.replace(".png", "_0000.png") for name in labels}
    (fold,) = json.loads((raw / "splits_final.json").read_text())
    assert sorted(fold["train"] + fold["val"]) == sorted(name.removesuffix(".png") for name in labels)
    frame = int(pairs.frames(Part.test)[0])
    held = np.array(Image.open(raw / "labelsTs" / f"frame{frame:05d}.png"))
    assert np.array_equal(held, pairs.stored("segmentation", frame))


def test_nnunet_counts_the_classes_that_occur(tmp_path: Path) -> None:
    stored = {"segmentation": np.uint8([[0, 1], [4, 5]]), "target": np.uint8([[0, 9], [9, 9]])}

    class OfThreeTissues:
        tissues, split = ("background", "bone", "gas", "liver", "liver"), np.array([Part.train])

        def __len__(self) -> int:
            return 1

        def stored(self, name: str, _: int) -> np.ndarray:
            return stored[name]

        def frames(self, part: Part) -> np.ndarray:
            return np.flatnonzero(self.split == part)

    write_nnunet(OfThreeTissues(), tmp_path)  # type: ignore[arg-type]
    described = json.loads((tmp_path / "dataset.json").read_text())
    assert described["labels"] == {"background": 0, "background_1": 1, "liver_4": 2, "liver_5": 3}, "names twice"
    assert np.array(Image.open(tmp_path / "labelsTr" / "frame00000.png")).tolist() == [[0, 1], [2, 3]]


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
    write_dicom(open_pairs(again), tmp_path / "again", (0.3, 0.3))
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
    assert [segment.SegmentLabel for segment in segmented.SegmentSequence] == list(pairs.tissues)
    labels = np.zeros(pairs.shape, np.uint8)
    for layer, of in zip(
        np.atleast_3d(segmented.pixel_array.T).T, segmented.PerFrameFunctionalGroupsSequence, strict=True
    ):
        labels[layer > 0] = of.SegmentIdentificationSequence[0].ReferencedSegmentNumber
    assert np.array_equal(labels, pairs.stored("segmentation", len(pairs) - 1))


def test_what_cannot_be_exported_is_one_line(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pydicom", None)
    for task in ("export", "render"):
        with pytest.raises(ConfigurationError, match=r"dataset\.format=dicom: needs the package pydicom"):
            run(f"task={task}", "dataset.format=dicom", *arguments)
