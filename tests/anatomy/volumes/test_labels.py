"""Scene folders with a volume of labels: the scene that is made, and one line for everything that is wrong."""

import logging
import re
import tracemalloc
from pathlib import Path

import nibabel
import numpy as np
import pytest
import trimesh
import yaml
from nibabel.affines import apply_affine, from_matvec
from scipy.ndimage import gaussian_filter, maximum_filter
from scipy.spatial.transform import Rotation

from ablate.anatomy import load_scene, load_tissues, validate_scene_folder
from ablate.anatomy.volumes import label_map
from ablate.anatomy.volumes import labelled_structures as module
from ablate.anatomy.volumes.label_order import read_order
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings
from ablate.ultrasound.probe import pixel_coordinates_mm
from support.scene_hash import content_hash

OBLIQUE = from_matvec(
    Rotation.from_euler("xyz", [25, -30, 40], degrees=True).as_matrix() * [1.1, 1.3, 2.4], [-60, 9, 4]
)
FLIPPED = from_matvec(np.diag([-1.5, 1.5, 1.5]), [50, -40, -10])
TISSUES = {1: "soft_tissue", 2: "liver", 3: "bone"}


def write(folder: Path, values: np.ndarray, affine: np.ndarray, **labels: object) -> Path:
    nibabel.save(nibabel.Nifti1Image(values, affine), folder / "labels.nii.gz")
    content = {"labels": {"file": "labels.nii.gz", "tissues": TISSUES, **labels}}
    (folder / "scene.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder


def three_balls() -> tuple[np.ndarray, list[tuple[np.ndarray, float, int]]]:
    """A volume of three balls, and the middle in voxels, radius in voxels and label of each."""
    balls = [(np.array([14.2, 15.1, 16.0]), 9.0, 1), (np.array([33.0, 30.4, 17.7]), 11.0, 2)]
    balls.append((np.array([15.5, 38.0, 30.1]), 8.0, 3))
    values = np.zeros((48, 50, 42), np.uint8)
    voxels = np.moveaxis(np.indices(values.shape), 0, -1)
    for middle, radius, label in balls:
        values[np.linalg.norm(voxels - middle, axis=-1) < radius] = label
    return values, balls


@pytest.mark.parametrize("affine", [OBLIQUE, FLIPPED])
def test_the_segmentation_is_within_a_voxel_of_the_labels_at_every_pixel(tmp_path: Path, affine: np.ndarray) -> None:
    random = np.random.default_rng(4)
    fields = [gaussian_filter(random.normal(size=(46, 40, 34)), 4) for _ in range(4)]
    values = np.argmax(fields, axis=0).astype(np.int16)
    scene = load_scene(write(tmp_path, values, affine))
    probe, settings = ConvexProbe(radius_mm=20, depth_mm=60), SimulatorSettings.low_quality(image_shape=(150, 130))
    middle = apply_affine(affine, np.array(values.shape) / 2)
    for turn in Rotation.random(3, rng=np.random.default_rng(5)).as_matrix():
        pose = from_matvec(turn, middle - 30 * turn[:, 2])
        frame = Simulator(scene, probe, settings).render(pose, seed=0)
        x, z = pixel_coordinates_mm(probe, settings.image_shape)
        points = np.stack(np.broadcast_arrays(x[None, :], 0.0, z[:, None]), axis=-1)
        nearest = np.rint(apply_affine(np.linalg.inv(affine), apply_affine(pose, points))).astype(int)
        padded = np.pad(values, 2)
        inside = (nearest >= -2).all(axis=-1) & (nearest < np.array(values.shape) + 2).all(axis=-1)
        index = tuple(np.where(inside[..., None], nearest + 2, 0).reshape(-1, 3).T)
        assert (frame.segmentation[frame.mask] > 1).mean() > 0.3
        for number, name in enumerate(["coupling_gel", *TISSUES.values()]):
            drawn = frame.segmentation == 1 + [t.name for t in scene.tissues].index(name)
            near = maximum_filter(padded == number, 3)[index].reshape(drawn.shape)
            allowed = np.where(inside, near, number == 0)
            assert allowed[drawn & frame.mask].all()


def test_labels_come_before_meshes_and_a_table_names_its_classes(tmp_path: Path) -> None:
    values, _ = three_balls()
    values[values == 1] = 5
    values[values == 3] = 92
    folder = write(tmp_path, values, np.eye(4), tissues="totalsegmentator")
    trimesh.creation.box((9, 9, 9)).export(folder / "box.obj")
    content = yaml.safe_load((folder / "scene.yaml").read_text())
    content["structures"] = [{"mesh": "box.obj", "tissue": "gas"}]
    content["sites"] = {"region": ["liver", "box.obj"]}
    (folder / "scene.yaml").write_text(yaml.safe_dump(content))
    scene = load_scene(folder)
    names = ["kidney_right", "liver", "rib_left_1", "box.obj"]
    assert [s.mesh.metadata["name"] for s in scene.structures] == names
    assert [s.tissue.name for s in scene.structures] == ["kidney", "liver", "bone", "gas"]
    assert validate_scene_folder(folder).sites.region == ("liver", "box.obj")  # type: ignore[union-attr]


def test_the_table_holds_known_tissues_and_each_class_once() -> None:
    rows = label_map.numbered_classes()
    assert [number for number, _, _ in rows] == list(range(1, 118))
    assert len({name for _, name, _ in rows}) == 117
    assert {tissue for _, _, tissue in rows} <= load_tissues().keys()


def test_a_label_may_be_left_out(tmp_path: Path) -> None:
    values, _ = three_balls()
    scene = load_scene(write(tmp_path, values, np.eye(4), tissues={3: "bone", 2: None, 1: "fat"}))
    assert [s.mesh.metadata["name"] for s in scene.structures] == ["label 3", "label 1"]


def test_the_body_is_what_is_above_a_threshold_and_all_within_it(tmp_path: Path) -> None:
    values, _ = three_balls()
    image = np.full(values.shape, -1000, np.int16)
    image[3:45, 3:47, 3:39] = 20
    image[20:24, 20:24, 10:30] = -900  # gas
    image[0:48, 48:50, :] = 50  # the table
    folder = write(tmp_path, values, OBLIQUE, body={"file": "ct.nii.gz", "above": -300, "tissue": "fat"})
    nibabel.save(nibabel.Nifti1Image(image, OBLIQUE), folder / "ct.nii.gz")
    scene = load_scene(folder)
    assert [s.mesh.metadata["name"] for s in scene.structures] == ["body", "label 1", "label 2", "label 3"]
    assert scene.structures[0].tissue.name == "fat"
    order, _ = read_order(validate_scene_folder(folder).labels, "labels")  # type: ignore[arg-type]
    expected = np.zeros(values.shape, np.uint8)
    expected[3:45, 3:47, 3:39] = 1
    assert np.array_equal(order, np.where(values > 0, values + 1, expected))
    corners = apply_affine(np.linalg.inv(OBLIQUE), scene.structures[0].mesh.vertices)
    assert corners.min(axis=0) == pytest.approx([2.5] * 3, abs=0.2)
    assert corners.max(axis=0) == pytest.approx([44.5, 46.5, 38.5], abs=0.2)


def test_surfaces_are_kept_and_follow_the_labels_but_not_the_values_of_tissues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values, _ = three_balls()
    kept, folder = tmp_path / "kept", tmp_path / "scene"
    folder.mkdir()
    first = load_scene(write(folder, values, OBLIQUE), kept)

    def made(*_: object) -> None:
        raise ValueError("made")

    monkeypatch.setattr(module, "read_order", made)
    assert content_hash(load_scene(folder, kept)) == content_hash(first)
    text = (folder / "scene.yaml").read_text()
    (folder / "scene.yaml").write_text(text + "tissues: {liver: {scatterer_sd: 0.1}}\n")
    assert load_scene(folder, kept).structures[1].tissue.scatterer_sd == 0.1
    write(folder, values[:, ::-1], OBLIQUE)
    with pytest.raises(ValueError, match="made"):
        load_scene(folder, kept)
    write(folder, values, OBLIQUE)
    monkeypatch.setattr(module, "ANATOMY_VERSION", 99)  # of mesh repair, which surfaces go through
    with pytest.raises(ValueError, match="made"):
        load_scene(folder, kept)
    assert [path.suffix for path in kept.iterdir()] == [".npz"]


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"tissues": {1: "soft_tissue", 2: "liver"}}, "labels.tissues: .*nii.gz has label 3 without a tissue; allowed"),
        ({"tissues": {**TISSUES, 7: "bile"}}, "labels.tissues.7: no voxel of .*gz has this label; it has 1, 2, 3"),
        ({"tissues": {**TISSUES, 7: "bille"}}, r"labels\.tissues\.7='bille' \(did you mean bile"),
        ({"tissues": {"liver": 2}}, "labels.tissues: label='liver': allowed are whole numbers from 1 to 65535"),
        ({"tissues": dict.fromkeys(TISSUES)}, "labels.tissues: every label is null; allowed is at least one"),
        ({"tissues": "monai"}, "labels.tissues='monai': allowed are totalsegmentator, or mappings of labels to"),
        ({"file": "labels.img"}, "labels.file='labels.img': allowed are names of files that end in .nii, .nii.gz"),
        ({"body": {"file": "labels.nii.gz"}}, "labels.body.above=None: allowed are finite numbers"),
        ({"body": {"file": "small.nii.gz", "above": 0}}, "labels.body.file: .*small.nii.gz has not the shape"),
        ({"body": {"file": "colour.nii.gz", "above": 0}}, "labels.body.file: .*colour.nii.gz holds colours"),
        ({"body": {"file": "complex.nii.gz", "above": 0}}, "labels.body.file: .*complex.nii.gz holds complex numbers"),
        ({"body": {"file": "labels.nii.gz", "above": 9}}, "labels.body.above: no voxel of .* is above 9 and has no"),
    ],
)
def test_what_is_wrong_with_labels_is_one_line(tmp_path: Path, labels: dict[str, object], message: str) -> None:
    values, _ = three_balls()
    folder = write(tmp_path, values, np.eye(4), **labels)
    nibabel.save(nibabel.Nifti1Image(values[1:], np.eye(4)), folder / "small.nii.gz")
    for name, kind in {"colour": [("R", "u1"), ("G", "u1"), ("B", "u1")], "complex": np.complex64}.items():
        image = nibabel.Nifti1Image(np.zeros(values.shape, kind), np.eye(4))
        nibabel.save(image, folder / f"{name}.nii.gz")
    with pytest.raises(ValueError, match=rf"scene\.yaml: {message}") as caught:
        load_scene(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("damaged", ["labels.nii.gz", "ct.nii.gz"])
def test_labels_and_the_image_of_the_body_must_have_their_checksums(tmp_path: Path, damaged: str) -> None:
    values, _ = three_balls()
    folder = write(tmp_path, values, np.eye(4), body={"file": "ct.nii.gz", "above": 0})
    nibabel.save(nibabel.Nifti1Image(np.ones(values.shape, np.int16), np.eye(4)), folder / "ct.nii.gz")
    content = bytearray((folder / damaged).read_bytes())
    content[-8] ^= 1
    (folder / damaged).write_bytes(content)
    with pytest.raises(ValueError, match=rf"{damaged}: not readable to its end: CRC check failed"):
        load_scene(folder)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((9, 9, 9), np.uint8), "has no label, only 0"),
        (np.full((9, 9, 9), -4, np.int16), "holds the value -4; allowed are 0 to 65535"),
        (np.full((9, 9, 9), 0.37, np.float32), "holds the value 0.37; labels are whole numbers"),
        (np.full((9, 9, 9), np.nan, np.float32), "holds the value nan; allowed are 0 to 65535"),
        (np.full((9, 9, 9), 0.9999999, np.float32), "holds the value 0.9999999; labels are whole numbers"),
        (np.full((9, 9, 9), 2 + 1e-12, np.float64), "holds the value 2.000000000001; labels are whole numbers"),
        (np.full((9, 9, 9), 65535.004, np.float32), "holds the value 65535.004; allowed are 0 to 65535"),
        (np.full((9, 9, 9), 1e300, np.float64), "holds the value 1e+300; allowed are 0 to 65535"),
    ],
)
def test_values_that_are_no_labels_are_named(tmp_path: Path, values: np.ndarray, message: str) -> None:
    folder = write(tmp_path, values, np.eye(4))
    with pytest.raises(ValueError, match=rf"scene\.yaml: labels\.file: .*labels\.nii\.gz {re.escape(message)}"):
        load_scene(folder)


def test_memory_is_less_than_three_times_the_volume(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    values = np.zeros((400, 400, 120), np.int16)
    values[180:220, 190:210, 50:70] = 2
    folder = write(tmp_path, values, np.eye(4), tissues={2: "liver"})
    size = values.nbytes
    del values
    tracemalloc.start()
    with caplog.at_level(logging.WARNING):
        load_scene(folder)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 3 * size
    assert caplog.text == ""


def test_what_3d_slicer_wrote_in_two_spaces_is_not_one_body(tmp_path: Path) -> None:
    """It says LPS or RAS in its meshes; labels are in RAS."""
    mesh = trimesh.creation.icosphere(2, radius=9).export(file_type="obj")
    values, _ = three_balls()
    labels = yaml.safe_load((write(tmp_path, values, OBLIQUE) / "scene.yaml").read_text())["labels"]
    for beside, structures in ({"labels": labels}, ["tumour"]), ({}, ["liver", "tumour"]):
        named = [{"mesh": f"{name}.obj", "tissue": "liver"} for name in structures]
        (tmp_path / "scene.yaml").write_text(yaml.safe_dump({**beside, "structures": named}))
        (tmp_path / "liver.obj").write_text(f"# 3D Slicer output. SPACE=RAS\n{mesh}")
        (tmp_path / "tumour.obj").write_text(f"# 3D Slicer output. SPACE=RAS\n{mesh}")
        validate_scene_folder(tmp_path)
        (tmp_path / "tumour.obj").write_text(f"# 3D Slicer output. SPACE=LPS\n{mesh}")
        other = "labels are" if beside else r"liver\.obj is"
        with pytest.raises(ValueError, match=rf"tumour\.obj is in LPS, but {other} in RAS; export all as RAS"):
            validate_scene_folder(tmp_path)


@pytest.mark.parametrize(("spacing", "tilt"), [((1, 1, 1), 15), ((1, 1, 5), 0), ((1, 1, 5), 15)])
def test_a_lung_is_filled_across_the_body_in_a_tilted_volume_of_thick_slices(
    tmp_path: Path, spacing: tuple[float, float, float], tilt: float
) -> None:
    """A trunk along z in sagittal slices: the upper border of the volume cuts its lung open, slices across do not."""
    size = np.array([100, 100, 100 // spacing[2]])
    front, up, side = np.indices(size) * np.reshape(spacing, (3, 1, 1, 1))
    lung = (np.hypot(side - 50, front - 50) < 25) & (up > 40)
    trunk = (np.hypot(side - 50, front - 50) < 45) & ~lung
    axes = np.eye(3)[:, [1, 2, 0]]  # voxels go to the front, up, and to the side
    affine = from_matvec(Rotation.from_euler("y", tilt, degrees=True).as_matrix() @ axes * spacing, [0, 0, 0])
    nibabel.save(nibabel.Nifti1Image(np.where(trunk, 40, -900).astype(np.int16), affine), tmp_path / "ct.nii.gz")
    liver = ((np.hypot(side - 50, front - 50) < 10) & (up > 5) & (up < 20)).astype(np.uint8)
    body = {"file": "ct.nii.gz", "above": -300, "tissue": "soft_tissue"}
    folder = write(tmp_path, liver, affine, tissues={1: "liver"}, body=body)
    labels = validate_scene_folder(folder).labels
    assert labels is not None
    order, _ = read_order(labels, "labels")
    assert (order[lung] == 1).all()
