"""A proposed scene.yaml: it can be used as it is, and says what was guessed."""

from pathlib import Path

import pytest
import trimesh

from ablate.anatomy import load_scene, load_sites, proposed_scene
from ablate.anatomy.tissue_names import tissue_of_name
from ablate.anatomy.volumes.label_map import _table


def folder_of(tmp_path: Path, scale: float = 1.0) -> Path:
    sizes = {"Skin surface.stl": 150, "liver.ply": 60, "ribs-left.obj": 70, "left_kidney.stl": 30, "VenaCava.obj": 10}
    for name, size in {**sizes, "thing.ply": 5}.items():
        trimesh.creation.icosphere(1, radius=scale * size).export(tmp_path / name)
    (tmp_path / "notes.txt").write_text("seen on Monday")
    return tmp_path


def test_a_proposal_is_a_scene_as_it_is(tmp_path: Path) -> None:
    text = proposed_scene(folder_of(tmp_path))
    (tmp_path / "scene.yaml").write_text(text)
    tissues = {s.mesh.metadata["name"]: s.tissue.name for s in load_scene(tmp_path).structures}
    assert list(tissues.items()) == [
        ("Skin surface.stl", "soft_tissue"),
        ("liver.ply", "liver"),
        ("left_kidney.stl", "kidney"),
        ("thing.ply", "soft_tissue"),
        ("VenaCava.obj", "blood"),
        ("ribs-left.obj", "bone"),
    ]
    assert "tissue: soft_tissue}   # guessed: its name says nothing" in text
    assert "tissue: kidney}   # guessed: its name has kidney" in text
    assert load_sites(tmp_path).heights_mm[0] == pytest.approx(-90)


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "mm"), (0.1, "cm"), (0.001, "m")])
def test_the_unit_is_the_one_that_makes_a_body(tmp_path: Path, scale: float, unit: str) -> None:
    text = proposed_scene(folder_of(tmp_path, scale))
    assert f"\nunit: {unit}   # guessed: the largest extent is " in text
    (tmp_path / "scene.yaml").write_text(text)
    assert load_scene(tmp_path).structures[0].mesh.extents.max() == pytest.approx(300, rel=0.05)


@pytest.mark.parametrize(("space", "front"), [("RAS", (0, 1, 0)), ("LPS", (0, -1, 0))])
def test_the_front_is_that_of_the_space_that_a_mesh_names(tmp_path: Path, space: str, front: tuple[float, ...]) -> None:
    surface = trimesh.creation.icosphere(1, radius=60).export(file_type="obj")
    (tmp_path / "liver.obj").write_text(f"# 3D Slicer output. SPACE={space}\n{surface}")
    (tmp_path / "scene.yaml").write_text(proposed_scene(tmp_path))
    assert load_sites(tmp_path).front == front


def test_a_mesh_that_cannot_be_used_is_named_in_a_comment(tmp_path: Path) -> None:
    (folder_of(tmp_path) / "torn.ply").write_text("not a mesh")
    text = proposed_scene(tmp_path)
    (comment,) = [line for line in text.splitlines() if "torn" in line]
    assert comment.startswith("  # left out: ")
    (tmp_path / "scene.yaml").write_text(text)
    assert len(load_scene(tmp_path).structures) == 6


def test_what_is_not_read_is_named_whatever_its_format(tmp_path: Path) -> None:
    """Also what lies within an inner folder, but nothing that is no structure."""
    folder_of(tmp_path)
    for name in ("kidney.3mf", "a.dcm", "b.dcm", "c.DCM", "spleen.MHA", "texture.png"):
        (tmp_path / name).touch()
    (tmp_path / "right").mkdir()
    trimesh.creation.icosphere(1).export(tmp_path / "right" / "lung.stl")
    text = proposed_scene(tmp_path)
    left_out = [line.removeprefix("  # left out: ") for line in text.splitlines() if "# left out: " in line]
    assert [line.partition(" is ")[0] for line in left_out[:-1]] == [
        "kidney.3mf: .3mf",
        "a.dcm: .dcm (and 2 more)",
        "spleen.MHA: .mha",
    ]
    assert left_out[-1] == "right: of folders within this one nothing is taken; right/lung.stl may be named"
    (tmp_path / "scene.yaml").write_text(text)
    assert len(load_scene(tmp_path).structures) == 6


def test_a_folder_without_meshes_is_refused_in_one_line(tmp_path: Path) -> None:
    none = r"scene\.folder: .* has no scene\.yaml, no mesh and no volume; \.obj, \.stl"
    with pytest.raises(FileNotFoundError, match=none):
        proposed_scene(tmp_path)
    (tmp_path / "empty.obj").write_text("")
    with pytest.raises(ValueError, match=r"scene\.folder: .*empty\.obj"):
        proposed_scene(tmp_path)


@pytest.mark.parametrize(
    ("name", "tissue"),
    [
        *[("hippocampus", "brain"), ("tibialis_anterior", "muscle"), ("gastrocnemius_left", "muscle")],
        *[
            ("heart_left_ventricle", "blood"),
            ("left_ventricle_myocardium", "myocardium"),
            ("left_ventricle", "blood"),
            ("ventricle_right", "blood"),
            ("lateral_ventricle_left", "csf"),
            ("Left-Lateral-Ventricle", "csf"),
            ("brain_ventricle_left", "csf"),
            ("cerebral_left_ventricle", "csf"),
            ("3rd-Ventricle", "csf"),
            ("ventricles", "csf"),
            ("hip_left", "bone"),
            ("tibia", "bone"),
        ],
        *[
            ("bladder_wall", "muscle"),
            ("urinary_bladder", "urine"),
            ("gall_bladder_wall", "gallbladder_wall"),
            ("gall_bladder", "bile"),
            ("tibialis_anterior_artery", "blood"),
            ("iliac_artery_left", "blood"),
        ],
        *[
            ("bowel_gas", "gas"),
            ("gastric wall", "stomach_wall"),
            ("lung", "gas"),
            ("lung_tumor", "soft_tissue"),
            ("lung_nodules", "soft_tissue"),
            ("colon_cancer_primaries", "soft_tissue"),
        ],
    ],
)
def test_longer_names_of_muscles_and_chambers_are_no_bones(name: str, tissue: str) -> None:
    assert tissue_of_name(name)[0] == tissue


def test_names_of_totalsegmentator_point_to_the_tissues_of_its_table() -> None:
    """The table was written without the patterns."""
    assert len(_table()) == 117 + 21  # those of version 1 and of MR have no number
    assert {row["name"]: tissue_of_name(row["name"])[0] for row in _table().values()} == {
        row["name"]: row["tissue"] for row in _table().values()
    }
