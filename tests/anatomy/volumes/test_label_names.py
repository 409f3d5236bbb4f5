"""Names of labels: those in a file win, then a table beside it; numbers alone mean nothing, or a whole table."""

from pathlib import Path
from textwrap import dedent

import nrrd
import numpy as np
import pytest
import yaml

from ablate.anatomy import load_scene, proposed_scene, structure_names, validate_scene_folder
from ablate.anatomy.volumes.label_map import numbered_classes
from ablate.anatomy.volumes.label_names import names_beside, names_in_header
from support.volumes import AFFINE, blocks, save, save_named

NAMES = {1: "Leber & Milz", 2: "肝臓", 7: "Left kidney"}
TABLES = {
    "itk-snap.txt": """
        # ITK-SnAP Label Description File
            0     0    0    0        0  0  0    "Clear Label"
            1   255    0    0        1  1  1    "Leber & Milz"
            2     0  255    0      0.5  1  1    "肝臓"
            7     0    0  255        1  0  1    "Left kidney"
        """,
    "slicer.ctbl": """
        # Color table file seg.ctbl
        # 4 values
        0 Background 0 0 0 0
        1 Leber_&_Milz 255 0 0 255
        2 肝臓 0 255 0 255
        7 Left_kidney 0 0 255 255
        """,
    "slicer.csv": """
        LabelValue,Name,Color_R,Color_G,Color_B,Color_A
        1,Leber & Milz,255,0,0,255
        2,肝臓,0,255,0,255
        7,Left kidney,0,0,255,255
        """,
    "bids.tsv": "index\tname\tabbreviation\n1\tLeber & Milz\tL\n2\t肝臓\tK\n7\tLeft kidney\tN\n",
    "spreadsheet.csv": "\ufefflabel;name\n1;Leber & Milz\n2;肝臓\n7;Left kidney\n",
    "tabs.csv": "value\tlabel\n1\tLeber & Milz\n2\t肝臓\n7\tLeft kidney\n",
    "organs.csv": "Label ID,Organ\n1,Leber & Milz\n2,肝臓\n7,Left kidney\n,\n",
    "dataset.json": '{"labels": {"background": 0, "Leber & Milz": 1, "肝臓": 2, "Left kidney": 7}}',
    "old.json": '{"labels": {"0": "background", "1": "Leber & Milz", "2": "肝臓", "7": "Left kidney"}}',
}
NO_TABLES = {
    "notes.txt": "1 2 3",
    "points.csv": "x,y,z\n1,2,3\n",
    "few.ctbl": "1 liver 255 0 0 255\n",  # the others have no name
    "broken.json": "{",
    "broken.csv": 'label,name\n1,"' + 200_000 * "x",
    "list.json": "[1]",
    "sizes.txt": "1 2 3 4 5 6\n2 3 4 5 6 7\n7 8 9 10 11 12\n",
}


def proposed(folder: Path) -> str:
    text = proposed_scene(folder)
    (folder / "scene.yaml").write_text(text, encoding="utf-8")
    return text


def tissues(folder: Path) -> dict[str, str]:
    labels = validate_scene_folder(folder).labels
    assert labels is not None
    return {label.name: label.tissue.name for label in labels.labels if label.tissue}


@pytest.mark.parametrize("code", [0, 30])
def test_names_in_a_nifti_are_read(tmp_path: Path, code: int) -> None:
    save_named(tmp_path / "a.nii.gz", blocks([1, 2, 7]), {0: "???", **NAMES}, code)
    assert names_in_header(tmp_path / "a.nii.gz") == NAMES


def test_names_in_an_nrrd_are_read_though_they_are_not_ascii(tmp_path: Path) -> None:
    header = {"space": "RAS", "space directions": AFFINE[:3, :3], "space origin": AFFINE[:3, 3]}
    nrrd.write(str(tmp_path / "a.seg.nrrd"), blocks([1, 2, 7]), header)
    lines = [f"Segment{k}_LabelValue:={n}\nSegment{k}_Name:={name}" for k, (n, name) in enumerate(NAMES.items())]
    content = (tmp_path / "a.seg.nrrd").read_bytes()
    (tmp_path / "a.seg.nrrd").write_bytes(content.replace(b"\n\n", "\n{}\n\n".format("\n".join(lines)).encode(), 1))
    assert names_in_header(tmp_path / "a.seg.nrrd") == NAMES
    assert "7: kidney   # guessed: its name has kidney: Left kidney" in proposed(tmp_path)
    assert len(load_scene(tmp_path).structures) == 3


@pytest.mark.parametrize("table", TABLES)
def test_names_in_a_table_beside_a_volume_are_read(tmp_path: Path, table: str) -> None:
    for name, text in {**NO_TABLES, table: dedent(TABLES[table]).strip()}.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert names_beside(tmp_path / "a.nii.gz", [0, 1, 2, 7]) == (NAMES, table)
    save(tmp_path / "a.nii.gz", blocks([1, 2, 7]))
    assert f"# the names are those of {table}" in proposed(tmp_path)


def test_other_files_beside_a_volume_name_nothing(tmp_path: Path) -> None:
    for name, text in NO_TABLES.items():
        (tmp_path / name).write_text(text)
    assert names_beside(tmp_path / "a.nii.gz", [1, 2, 7]) == ({}, "")


def test_a_table_of_a_kind_that_is_not_read_is_said(tmp_path: Path) -> None:
    save(tmp_path / "a.nii.gz", blocks([1, 2, 7]))
    assert "no name" not in proposed(tmp_path)
    (tmp_path / "a.json").write_text('{"1": "liver", "2": "spleen", "7": "kidney"}')
    assert "\n  # no name was found of each label, in the header nor beside it in a.json\n" in proposed(tmp_path)
    assert len(load_scene(tmp_path).structures) == 3


def test_a_table_with_the_name_of_the_volume_comes_first_and_the_header_before_both(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("label,name\n1,bone\n")
    (tmp_path / "seg.csv").write_text("label,name\n1,liver\n")
    save(tmp_path / "seg.nii.gz", blocks([1]))
    assert "1: liver" in proposed(tmp_path)
    save_named(tmp_path / "seg.nii.gz", blocks([1]), {1: "urinary bladder"})
    assert "1: urine" in proposed(tmp_path)


#: The beginnings of three lists of classes: number 7 is one thing in version 1, another in version 2 and MR.
VERSION_1 = ["spleen", "kidney_right", "kidney_left", "gallbladder", "liver", "stomach", "aorta", "inferior_vena_cava"]
MR = ["spleen", "kidney_right", "kidney_left", "gallbladder", "liver", "stomach", "pancreas", "adrenal_gland_right"]
MR += ["adrenal_gland_left", "lung_left", "lung_right", "esophagus", "small_bowel", "duodenum", "colon"]
MR += ["urinary_bladder", "prostate", "sacrum", "vertebrae", "intervertebral_discs", "spinal_cord", "heart", "aorta"]


@pytest.mark.parametrize("classes", [VERSION_1, MR])
@pytest.mark.parametrize("by_table", [True, False])
def test_every_label_has_the_tissue_of_its_name_whatever_its_number(
    tmp_path: Path, classes: list[str], by_table: bool
) -> None:
    names = dict(enumerate(classes, start=1))
    save_named(tmp_path / "seg.nii.gz", blocks(list(names)), names)
    if by_table:
        content = {"labels": {"file": "seg.nii.gz", "tissues": "totalsegmentator"}}
        (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    else:
        proposed(tmp_path)
    found = list(tissues(tmp_path).values())
    expected = {
        "aorta": "blood", "inferior_vena_cava": "blood", "pancreas": "pancreas", "small_bowel": "bowel_wall",
        "spleen": "spleen", "vertebrae": "bone", "spinal_cord": "brain", "lung_left": "gas", "urinary_bladder": "urine",
    }  # fmt: skip
    assert {n: found[classes.index(n)] for n in expected if n in classes} == {
        n: tissue for n, tissue in expected.items() if n in classes
    }
    labels = validate_scene_folder(tmp_path).labels
    assert labels is not None
    assert not labels.guessed


def test_a_structure_is_called_as_the_volume_calls_its_label_and_found_by_its_number(tmp_path: Path) -> None:
    save_named(tmp_path / "seg.nii.gz", blocks([1, 2, 3, 4]), {1: "spleen", 2: "lesion", 3: "lesion"})
    named = {1: "spleen", 2: "liver", 3: "liver", 4: "kidney"}
    sites = {"axis": [0, 0, 1], "heights": [110], "angles": [0], "region": ["label 1"]}
    content = {"labels": {"file": "seg.nii.gz", "tissues": named}, "sites": sites}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    scene = load_scene(tmp_path)
    assert [s.mesh.metadata["name"] for s in scene.structures] == ["spleen", "lesion 2", "lesion 3", "label 4"]
    assert structure_names(scene) == ["spleen", "lesion 2", "lesion 3", "kidney (label 4)"]
    folder = validate_scene_folder(tmp_path)
    assert folder.sites is not None
    assert folder.sites.region == ("spleen",)


@pytest.mark.parametrize(
    ("names", "called"),
    [
        ({1: "GTV/CTV", 2: "3rd/4th ventricle", 7: "CTV"}, ["GTV/CTV", "3rd/4th ventricle", "CTV"]),
        ({1: "liver", 2: "liver", 7: "liver 2"}, ["liver 1", "liver 2", "liver 2"]),
        ({1: "label 2"}, ["label 2", "label 2", "label 7"]),
    ],
)
def test_a_label_has_its_own_tissue_whatever_it_and_others_are_called(
    tmp_path: Path, names: dict[int, str], called: list[str]
) -> None:
    save_named(tmp_path / "a.nii.gz", blocks([1, 2, 7]), names)
    content = {"labels": {"file": "a.nii.gz", "tissues": {1: "liver", 2: "spleen", 7: "kidney"}}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    for _ in range(2):  # built, and read again
        structures = load_scene(tmp_path, tmp_path / "cache").structures
        assert [s.tissue.name for s in structures] == ["liver", "spleen", "kidney"]
        assert [s.mesh.metadata["name"] for s in structures] == called


def test_a_mask_that_is_called_body_leaves_the_body_its_tissue(tmp_path: Path) -> None:
    save(tmp_path / "image.nii", np.ones((22, 22, 10), np.uint8))
    masks_folder(tmp_path, {"body.nii": blocks([1])}, {"body.nii": "bone"})
    content = yaml.safe_load((tmp_path / "scene.yaml").read_text())
    content["labels"]["body"] = {"file": "image.nii", "above": 0.5, "tissue": "fat"}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    assert [s.tissue.name for s in load_scene(tmp_path).structures] == ["fat", "bone"]


def test_a_name_that_is_no_class_of_the_table_is_refused_by_its_label(tmp_path: Path) -> None:
    save_named(tmp_path / "seg.nii.gz", blocks([1, 2]), {1: "liver", 2: "left wing"})
    content = {"labels": {"file": "seg.nii.gz", "tissues": "totalsegmentator"}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ValueError, match=r"labels\.tissues: .*seg\.nii\.gz calls its label 2 'left wing', which is no"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    ("numbers", "taken"),
    [
        (range(1, 24), False),  # of MR, of version 1 or of version 2
        (range(80, 105), False),
        ([*range(1, 24), 117], True),
        ([1, 5, 117], False),  # too few to be a whole body
        ([*range(1, 24), 118], False),
    ],
)
def test_numbers_alone_are_taken_for_a_table_only_where_they_fit_no_other(
    tmp_path: Path, numbers: list[int], taken: bool
) -> None:
    save(tmp_path / "seg.nii.gz", blocks(list(numbers)))
    text = proposed(tmp_path)
    assert ("tissues: totalsegmentator   # guessed: " in text) == taken
    labels = validate_scene_folder(tmp_path).labels
    assert labels is not None
    assert bool(labels.guessed) == taken
    if not taken:
        assert set(tissues(tmp_path).values()) == {"soft_tissue"}


def test_a_folder_with_a_file_an_organ_is_a_scene(tmp_path: Path) -> None:
    """As TotalSegmentator leaves it: 117 files in `segmentations`, most of them empty, beside the CT."""
    (tmp_path / "segmentations").mkdir()
    held = {"liver": 3, "kidney_left": 4, "rib_left_4": 5}
    for _, name, _ in numbered_classes():
        mask = (blocks([1, 2, 3, 4, 5]) == held.get(name, 99)).astype(np.uint8)
        save(tmp_path / "segmentations" / f"{name}.nii.gz", mask)
    save(tmp_path / "ct.nii.gz", np.pad(np.full((20, 20, 8), 30, np.int16), 1, constant_values=-1000))
    text = proposed(tmp_path)
    assert "segmentations/aorta.nii.gz: it has no labels but holds only 0" in text
    assert text.count("left out: ") == 114
    scene = load_scene(tmp_path)
    assert [(s.mesh.metadata["name"], s.tissue.name) for s in scene.structures] == [
        *[("body", "soft_tissue"), ("kidney_left", "kidney"), ("liver", "liver"), ("rib_left_4", "bone")]
    ]


def masks_folder(folder: Path, masks: dict[str, np.ndarray], named: object) -> Path:
    for name, values in masks.items():
        save(folder / name, values)
    (folder / "scene.yaml").write_text(yaml.safe_dump({"labels": {"masks": named}}, sort_keys=False))
    return folder


def test_of_masks_that_overlap_the_later_one_owns_the_voxels(tmp_path: Path) -> None:
    large, small = np.zeros((2, 12, 12, 12), np.uint8)
    large[2:10, 2:10, 2:10], small[4:10, 4:10, 4:10] = 1, 255
    masks = {"large.nii.gz": large, "small.nii": small}
    folder = masks_folder(tmp_path, masks, {"large.nii.gz": "liver", "small.nii": "gas"})
    scene = load_scene(folder)
    assert [s.mesh.metadata["name"] for s in scene.structures] == ["large", "small"]
    assert scene.structures[1].mesh.volume == pytest.approx(6**3 * 4.0**3, rel=0.02)
    masks_folder(tmp_path, masks, {"small.nii": "gas", "large.nii.gz": "liver"})
    with pytest.raises(ValueError, match=r"labels\.masks: small: all its voxels are in masks behind it, which own"):
        load_scene(folder)
    masks_folder(tmp_path, masks, {"large.nii.gz": None, "small.nii": "gas"})
    assert len(load_scene(folder).structures) == 1


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"a.nii": "liver", "two.nii": "gas"}, "two.nii holds more values than 0 and one more; allowed is a mask"),
        ({"a.nii": "liver", "zero.nii": "gas"}, "zero.nii holds only 0; allowed are masks with at least one voxel"),
        ({"a.nii": "liver", "nan.nii": "gas"}, "nan.nii holds more values than 0 and one more"),
        ({"a.nii": "liver", "small.nii": "gas"}, r"masks\.small.nii: .*small.nii has not the shape and the affine of"),
        ({"a.nii": "liver", "a.nii.gz": "gas"}, "another mask is called a, too"),
        ({"a.nii": "livver"}, r"masks\.a\.nii='livver' \(did you mean liver\?\)"),
        ({"b.nii": "liver"}, "no file 'b.nii' in"),
        ({}, "allowed are mappings of 1 to 254 files to tissues"),
        (["a.nii"], "allowed are mappings of 1 to 254 files to tissues"),
    ],
)
def test_what_is_wrong_with_masks_is_one_line(tmp_path: Path, named: object, message: str) -> None:
    one = blocks([1])
    masks = {"a.nii": one, "a.nii.gz": one, "two.nii": blocks([1, 2]), "zero.nii": 0 * one, "small.nii": one[1:]}
    masks_folder(tmp_path, {**masks, "nan.nii": np.where(one, np.nan, 0).astype(np.float32)}, named)
    with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
        load_scene(tmp_path)
    assert "\n" not in str(caught.value)


def test_masks_and_a_file_of_all_labels_exclude_each_other(tmp_path: Path) -> None:
    save(tmp_path / "a.nii", blocks([1]))
    content = {"labels": {"masks": {"a.nii": "liver"}, "file": "a.nii"}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ValueError, match=r"labels\.file: allowed is either file or masks"):
        load_scene(tmp_path)
