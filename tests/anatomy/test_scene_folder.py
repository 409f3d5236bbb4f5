"""Scene folders: what is read, and one clear line for everything that is wrong."""

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from ablate.anatomy import load_scene, load_sites, load_tissues, mesh_files, validate_scene_folder
from ablate.anatomy.meshes.repair import load_mesh, odd_edges
from ablate.anatomy.meshes.vtk_files import VTK_SUFFIXES
from ablate.anatomy.scene_folder import MESH_SUFFIXES

GOOD = {
    "unit": "cm",
    "background": "coupling_gel",
    "structures": [{"mesh": "skin.obj", "tissue": "fat"}, {"mesh": "liver.stl", "tissue": "graft"}],
    "tissues": {"graft": {"speed_m_s": 1600, "texture_mm": [1, 2, 3]}, "fat": {"scatterer_sd": 0.5}},
    "sites": {
        "axis": [0, 0, 1],
        "front": [0, -1, 0],
        "heights": {"range": [6, 16], "count": 6},
        "angles": {"range": [-60, 60], "count": 9},
        "tilts": [-15, 0, 15],
        "rolls": 0,
    },
}


def warned(caplog: pytest.LogCaptureFixture, folder: Path) -> list[str]:
    caplog.clear()
    load_scene(folder)
    return [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]


def test_what_scene_yaml_does_not_name_is_said_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Meshes and volumes, also beside a file of a folder within; not what is neither, hidden, or part of a mesh."""
    write(tmp_path, structures=[{"mesh": "skin.obj", "tissue": "fat"}, {"mesh": "in/liver.stl", "tissue": "graft"}])
    (tmp_path / "in").mkdir()
    (tmp_path / "liver.stl").rename(tmp_path / "in" / "liver.stl")
    for name in ("skin.mtl", "._skin.obj", "notes.txt", "in/readme.md"):
        (tmp_path / name).touch()
    assert not warned(caplog, tmp_path)
    (tmp_path / "in" / "spleen.glb").touch()
    assert warned(caplog, tmp_path) == [f"{tmp_path}: not in scene.yaml, so left out: in/spleen.glb"]
    assert not warned(caplog, tmp_path)
    (tmp_path / "segmentations").mkdir()
    for name in ("ct.nii.gz", "labels.NRRD", "segmentations/kidney.nii.gz"):
        (tmp_path / name).touch()
    listed = "ct.nii.gz, in/spleen.glb, labels.NRRD and 1 more"
    assert warned(caplog, tmp_path) == [f"{tmp_path}: not in scene.yaml, so left out: {listed}"]


def write(folder: Path, **changes: object) -> Path:
    trimesh.creation.box((10, 10, 10)).export(folder / "skin.obj")
    trimesh.creation.icosphere(radius=3.0).export(folder / "liver.stl")
    (folder / "scene.yaml").write_text(yaml.safe_dump({**GOOD, **changes}))
    return folder


def test_a_tissue_of_ones_own_has_the_values_of_the_one_that_it_is_like(tmp_path: Path) -> None:
    own = {"graft": {"like": "kidney", "speed_m_s": 1600}, "fat": {}, "other": {"like": "graft"}}
    tissue = load_scene(write(tmp_path, tissues=own)).structures[1].tissue
    assert tissue == replace(load_tissues()["kidney"], name="graft", speed_m_s=1600)
    with pytest.raises(ValueError, match=r"tissues\.graft\.like='kidny' \(did you mean kidney"):
        load_scene(write(tmp_path, tissues={"graft": {"like": "kidny"}}))


def test_a_folder_is_read_in_mm_with_its_own_tissues(tmp_path: Path) -> None:
    scene = load_scene(write(tmp_path))
    assert scene.name == tmp_path.name
    assert [s.tissue.name for s in scene.structures] == ["fat", "graft"]
    assert scene.structures[0].mesh.extents == pytest.approx([100, 100, 100])
    assert scene.structures[0].tissue.scatterer_sd == 0.5
    assert scene.structures[0].tissue.speed_m_s == load_tissues()["fat"].speed_m_s
    assert scene.structures[1].tissue.texture_mm == (1.0, 2.0, 3.0)
    assert scene.background == load_tissues()["coupling_gel"]


def test_sites_are_in_mm_and_degrees(tmp_path: Path) -> None:
    sites = load_sites(write(tmp_path))
    assert sites.heights_mm == pytest.approx((60, 80, 100, 120, 140, 160))
    assert sites.angles_deg == pytest.approx((-60, -45, -30, -15, 0, 15, 30, 45, 60))
    assert sites.tilts_deg == (-15, 0, 15)
    assert sites.rolls_deg == (0,)


def test_a_folder_may_be_all_background(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("background: liver\n")
    scene = load_scene(tmp_path)
    assert scene.structures == ()
    assert scene.tissues == (load_tissues()["liver"],)
    with pytest.raises(ValueError, match=r"scene\.yaml: sites: missing"):
        load_sites(tmp_path)


def structure(**values: object) -> dict[str, object]:
    return {"structures": [{"mesh": "skin.obj", "tissue": "fat", **values}]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"unit": "inch"}, r": unit='inch': allowed are mm, cm, m"),
        ({"backgroud": "fat"}, r": key='backgroud' \(did you mean background\?\): allowed are unit, "),
        ({"background": "gell"}, r": background='gell'.*: allowed are coupling_gel, "),
        ({"structures": {"mesh": "a"}}, r": structures={'mesh': 'a'}: allowed are lists of {mesh, tissue}"),
        ({"structures": ["skin.obj"]}, r": structures\[0\]='skin\.obj': allowed are mappings of mesh, tissue"),
        (structure(tissue="livr"), r": structures\[0\]\.tissue='livr' \(did you mean liver"),
        (structure(color="red"), r": structures\[0\]: key='color': allowed are mesh, tissue"),
        (structure(mesh="skin.txt"), r": structures\[0\]\.mesh='skin\.txt': allowed are names of files"),
        (structure(mesh="empty.obj"), r": structures\[0\]\.mesh: .*empty\.obj is empty"),
        ({"tissues": {"fat": {"speed": 1}}}, r": tissues\.fat: key='speed' \(did you mean speed_m_s"),
        (
            {"tissues": {"Graft": {}, "graft": {}}},
            r"\.Graft: nothing here is made of it; did you mean graft\?",
        ),
        ({"tissues": {"fat": {"speed_m_s": "fast"}}}, r"tissue .fat.: speed_m_s='fast': allowed are numbers"),
        ({"tissues": {"fat": {"speed_m_s": -1}}}, r": tissues: tissue 'fat': speed_m_s=-1: allowed are numbers from"),
        ({"tissues": {"fat": {"texture_mm": 1}}}, r": tissues: tissue .fat.: texture_mm=1: allowed are 3 numbers"),
        ({"sites": {"height": [1]}}, r": sites: key='height' \(did you mean heights"),
        ({"sites": {"heights": {"range": [1, 2]}}}, r": sites\.heights\.count=None: allowed are whole numbers from 1"),
        ({"sites": {"angles": []}}, r": sites: site grid: angles_deg must be one or more"),
        ({"sites": {"axis": [0, 1, 0]}}, r": .*must not point along axis"),
        ({"sites": {"tilts": [0, 120]}}, r": sites: site grid: tilts_deg must lie between -90 and 90"),
        ({"sites": {"region": ["skn.obj"]}}, r": sites\.region='skn\.obj' \(did you mean skin\.obj\?\): allowed are "),
        (
            {"sites": {key: {"range": [0, 1], "count": 400} for key in ("heights", "angles")}},
            ": sites: .* at most 100000 poses, not 160000",
        ),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    (tmp_path / "empty.obj").touch()
    with pytest.raises(ValueError, match=message) as caught:
        validate_scene_folder(write(tmp_path, **changes))
    assert "\n" not in str(caught.value)
    assert "scene.yaml" in str(caught.value)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="nowhere is not a folder"):
        load_scene(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match=r"has no scene\.yaml; task=describe proposes one"):
        load_scene(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"structures\[0\]\.mesh: no file .*gone\.obj"):
        load_scene(write(tmp_path, **structure(mesh="gone.obj")))


def test_a_file_that_is_named_lies_in_the_folder(tmp_path: Path) -> None:
    folder, outside = tmp_path / "scene", write_mesh(tmp_path, ".obj")
    folder.mkdir()
    (folder / "linked.obj").symlink_to(outside)
    for name in ("../model.obj", str(outside), "linked.obj"):
        with pytest.raises(ValueError, match=r"structures\[0\]\.mesh: '(model|linked)\.obj' does not lie in .*/scene;"):
            validate_scene_folder(write(folder, **structure(mesh=name)))
    mesh = write_mesh(folder, ".gltf")
    buffer = sorted(folder.glob("*.bin"))[0]
    mesh.write_text(mesh.read_text().replace(buffer.name, f"../{buffer.name}"))
    buffer.rename(tmp_path / buffer.name)
    with pytest.raises(ValueError, match=rf"model\.gltf: buffer: '{buffer.name}' does not lie in"):
        mesh_files(mesh)
    (tmp_path / "link").symlink_to(folder)
    write(folder, **structure(mesh="own.obj"))
    write_mesh(folder, ".obj").rename(folder / "own.obj")
    assert validate_scene_folder(tmp_path / "link").meshes, "the folder itself may be a link"


def test_keys_given_twice_are_refused(tmp_path: Path) -> None:
    write(tmp_path)
    with (tmp_path / "scene.yaml").open("a") as stream:
        stream.write("background: fat\n")
    with pytest.raises(ValueError, match=r"scene\.yaml: not readable as YAML: 'background' is given twice .*line"):
        validate_scene_folder(tmp_path)


@pytest.mark.parametrize(
    ("unit", "size", "message"),
    [
        ("mm", 0.31, r"unit: mm makes the scene's largest extent 0.31 mm; bodies have 5 to 2250 mm; m would make it"),
        ("m", 30.0, r"largest extent 3e\+04 mm;.*; mm would make it 30 mm and cm would make it 300 mm$"),
        ("mm", 3e5, r"largest extent 3e\+05 mm; bodies have 5 to 2250 mm$"),
    ],
)
def test_units_that_make_no_body_are_refused(tmp_path: Path, unit: str, size: float, message: str) -> None:
    write(tmp_path, unit=unit, **structure())
    trimesh.creation.box((size / 2, size, size / 3)).export(tmp_path / "skin.obj")
    with pytest.raises(ValueError, match=message) as caught:
        load_scene(tmp_path)
    assert "scene.yaml" in str(caught.value)


def test_a_real_patient_is_closed_quickly(cases: Path) -> None:
    start = time.perf_counter()
    scene = load_scene(cases / "ircad11")
    assert time.perf_counter() - start < 20  # about 1.5 s on one idle core
    assert len(scene.structures) == 11
    assert all(len(odd_edges(s.mesh.faces)) == 0 for s in scene.structures)
    by_name = {s.mesh.metadata["name"]: s.mesh for s in scene.structures}
    assert by_name["skin.obj"].extents == pytest.approx([339.4, 254.0, 210.6], abs=0.2)
    assert by_name["liver.obj"].centroid[0] < by_name["aorta.obj"].centroid[0]  # the liver is on the right
    assert load_sites(cases / "ircad11").rolls_deg == (0, 90)


@pytest.mark.parametrize(
    "text",
    [
        f"unit: {100_000 * 'm'}\n",
        f"structures: {{x: [{','.join(10_000 * ['1'])}]}}\n",
        f"background: {'[' * 3000}",
        f"sites: {{heights: [0x{400 * 'f'}]}}\n",
        f"structures: [{{mesh: {300 * 'x'}.obj, tissue: liver}}]\n",
        "background: 2020-13-45\n",
        *("structures: [", "just words", "[1, 2]", "", "unit: mm\nunit: cm", "? [a]\n: 1"),
    ],
    ids=lambda text: text[:12],
)
def test_what_is_odd_is_refused_shortly(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.yaml").write_text(text)
    with pytest.raises((ValueError, FileNotFoundError), match=r"scene\.yaml") as refused:
        validate_scene_folder(tmp_path)
    assert len(str(refused.value)) < 1000
    assert "\n" not in str(refused.value)


def write_mesh(folder: Path, suffix: str) -> Path:
    """A ball of radius 30 in any format; glTF names the files of its buffers."""
    made = trimesh.creation.icosphere(2, radius=30.0).export(None, file_type=suffix[1:])
    path = folder / f"model{suffix}"
    for name, content in made.items() if isinstance(made, dict) else [(path.name, made)]:
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("suffix", sorted({*MESH_SUFFIXES} - {*VTK_SUFFIXES}))  # those have tests of their own
def test_every_format_that_is_offered_can_be_read(tmp_path: Path, suffix: str) -> None:
    mesh = write_mesh(tmp_path, suffix)
    (tmp_path / "scene.yaml").write_text(f"structures: [{{mesh: {mesh.name}, tissue: liver}}]\n")
    (structure,) = load_scene(tmp_path).structures
    assert structure.mesh.volume == pytest.approx(trimesh.creation.icosphere(2, radius=30.0).volume, rel=1e-4)


def test_the_buffers_of_a_gltf_are_files_of_the_mesh(tmp_path: Path) -> None:
    mesh = write_mesh(tmp_path, ".gltf")
    buffers = sorted(tmp_path.glob("*.bin"))
    assert sorted(mesh_files(mesh)) == sorted([mesh, *buffers])
    assert mesh_files(write_mesh(tmp_path, ".glb")) == (tmp_path / "model.glb",)
    buffers[0].unlink()
    with pytest.raises(FileNotFoundError, match=rf"model\.gltf: buffer '{buffers[0].name}' is no file"):
        mesh_files(mesh)
    for broken in ("[", "[]", '{"buffers": [1]}', '{"buffers": 3}', '{"buffers": [{"uri": 3}]}'):
        mesh.write_text(broken)
        with pytest.raises(ValueError, match=r"model\.gltf: not readable as glTF"):
            mesh_files(mesh)


def test_materials_and_textures_are_not_read(tmp_path: Path) -> None:
    mesh = write_mesh(tmp_path, ".obj")
    plain = load_mesh(mesh)
    mesh.write_text(f"mtllib a.mtl\nusemtl red\n{mesh.read_text()}")
    (tmp_path / "a.mtl").write_text("newmtl red\nmap_Kd a.png\n")
    os.mkfifo(tmp_path / "a.png")  # whoever opens it waits for ever
    assert np.array_equal(load_mesh(mesh).triangles, plain.triangles)


@pytest.mark.parametrize(
    ("written", "value"),
    [("1e-3", 0.001), ("-2E+1", -20.0), ("010", 10.0), ("+.5", 0.5), ("7.", 7.0), ("1:30", None), ("1_0", None)],
)
def test_numbers_are_those_of_yaml_1_2(tmp_path: Path, written: str, value: float | None) -> None:
    """YAML 1.1 has 1e-3 as text, 010 as 8, and 1:30 as 90."""
    text = yaml.safe_dump({**GOOD, "sites": {**GOOD["sites"], "rolls": "ROLLS"}}).replace("ROLLS", written)
    (write(tmp_path) / "scene.yaml").write_text(text)
    if value is None:
        with pytest.raises(ValueError, match=rf"sites\.rolls='{written}': allowed are finite numbers"):
            load_sites(tmp_path)
    else:
        assert load_sites(tmp_path).rolls_deg == (value,)


def test_a_mesh_may_be_named_by_text(tmp_path: Path) -> None:
    write(tmp_path)
    assert load_mesh(f"{tmp_path}/liver.stl").volume == load_mesh(tmp_path / "liver.stl").volume
