"""A data set is known by what its frames are made from: no more, and no less."""

from pathlib import Path

import nibabel
import numpy as np
import pytest
import trimesh

from ablate.command.compose import jobs_of
from ablate.networks import GeneratorSpec
from ablate.sources.data_set import maps_needed

SCENE = """
structures: [{mesh: organs/body.obj, tissue: soft_tissue}]
sites: {axis: [0, 0, 1], heights: {range: [-10, 10], count: 2}, angles: {range: [-20, 20], count: 2}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "organs").mkdir()
    trimesh.creation.icosphere(2, radius=60).export(tmp_path / "organs" / "body.obj")
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


def hash_of(folder: Path) -> str:
    return jobs_of(["scene=folder", f"scene.folder={folder}"])[0].data.name


def test_a_mesh_decides_and_what_lies_beside_it_does_not(folder: Path) -> None:
    before = hash_of(folder)
    (folder / "notes.txt").write_text("seen on Monday")
    (folder / "unused.obj").write_text("v 0 0 0\n")
    assert hash_of(folder) == before
    trimesh.creation.icosphere(2, radius=61).export(folder / "organs" / "body.obj")
    assert hash_of(folder) != before


def test_the_buffers_of_a_gltf_decide(folder: Path) -> None:
    def export(radius: float) -> None:
        for name, content in trimesh.creation.icosphere(2, radius=radius).export(None, file_type="gltf").items():
            (folder / "organs" / name).write_bytes(content)

    export(60)
    described = (folder / "organs" / "model.gltf").read_bytes()
    scene = (folder / "scene.yaml").read_text()
    (folder / "scene.yaml").write_text(scene.replace("body.obj", "model.gltf"))
    before = hash_of(folder)
    export(30)
    (folder / "organs" / "model.gltf").write_bytes(described)
    assert hash_of(folder) != before


def test_a_volume_of_labels_decides(folder: Path) -> None:
    values = np.zeros((8, 8, 8), np.uint8)
    values[2:5, 3:5, 3:5] = 1
    nibabel.save(nibabel.Nifti1Image(values, np.eye(4)), folder / "labels.nii")
    with (folder / "scene.yaml").open("a") as scene:
        scene.write("labels: {file: labels.nii, tissues: {1: liver}}\n")
    before = hash_of(folder)
    nibabel.save(nibabel.Nifti1Image(values[::-1], np.eye(4)), folder / "labels.nii")
    assert hash_of(folder) != before


@pytest.mark.parametrize(("region", "decides"), [("", False), (", region: cyst", True)])
def test_a_table_that_names_labels_decides_where_the_probe_looks_at_one_of_them(
    folder: Path, region: str, decides: bool
) -> None:
    values = np.zeros((8, 8, 8), np.uint8)
    values[2:5, 3:5, 3:5], values[5:7, 3:5, 3:5] = 1, 2
    nibabel.save(nibabel.Nifti1Image(values, np.eye(4)), folder / "labels.nii")
    (folder / "labels.csv").write_text("label,name\n1,cyst\n2,mass\n")
    sites = SCENE.replace("count: 2}}", f"count: 2}}{region}}}")
    (folder / "scene.yaml").write_text(sites + "labels: {file: labels.nii, tissues: {1: liver, 2: liver}}\n")
    before = hash_of(folder)
    (folder / "labels.csv").write_text("label,name\n1,mass\n2,cyst\n")
    assert (hash_of(folder) != before) is decides


def test_the_low_quality_image_is_made_for_those_who_read_it() -> None:
    unet = {"family": "unet", "concat": "input", "upsampling": "transposed", "noise": "none", "depth": 8}
    assert "low" not in maps_needed([GeneratorSpec()])
    assert "low" in maps_needed([GeneratorSpec(), GeneratorSpec(**unet, extra_input="low")])  # type: ignore[arg-type]
