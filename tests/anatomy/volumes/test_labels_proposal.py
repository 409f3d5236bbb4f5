"""A scene.yaml proposed for a volume of labels: it can be used as it is, and says what was guessed."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from skimage.filters import threshold_otsu

from ablate.anatomy import load_scene, load_sites, proposed_scene
from support.volumes import MM, save


def organs() -> np.ndarray:
    """A body of 32 x 28 x 24 voxels with two organs, labels 3 and 7, that fill a small part of it."""
    labels = np.zeros((40, 36, 30), np.uint8)
    labels[8:16, 8:16, 8:20] = 3
    labels[20:28, 12:20, 8:20] = 7
    return labels


def image(labels: np.ndarray, air: float, flesh: float) -> np.ndarray:
    """An image of the body around the organs."""
    values = np.full(labels.shape, air, np.float32)
    values[4:36, 4:32, 3:27] = flesh
    values[labels > 0] = flesh + 40
    return values + np.random.default_rng(0).normal(scale=5, size=labels.shape).astype(np.float32)


def proposed(folder: Path) -> str:
    text = proposed_scene(folder)
    (folder / "scene.yaml").write_text(text)
    return text


def test_labels_beside_a_ct_are_a_scene_with_a_body(tmp_path: Path) -> None:
    save(tmp_path / "my scan.nii.gz", image(organs(), -1000, 30))
    save(tmp_path / "organs.nii.gz", organs())
    text = proposed(tmp_path)
    assert "  file: organs.nii.gz" in text
    assert "3: soft_tissue   # guessed: its name says nothing" in text
    assert 'body: {file: "my scan.nii.gz", above: -300, tissue: soft_tissue}   # guessed: a CT' in text
    scene = load_scene(tmp_path)
    assert [s.mesh.metadata["name"] for s in scene.structures] == ["body", "label 3", "label 7"]
    assert scene.structures[0].mesh.extents == pytest.approx([32 * MM, 28 * MM, 24 * MM], abs=MM)
    sites = load_sites(tmp_path)
    assert list(sites.front) == [0, 1, 0], "y of RAS+ points to the front"
    low, high = 100.0, 100 + 29 * MM
    assert (sites.heights_mm[0], sites.heights_mm[-1]) == pytest.approx((low + 0.2 * 29 * MM, high - 0.2 * 29 * MM))


def test_a_mesh_beside_labels_is_in_their_unit(tmp_path: Path) -> None:
    save(tmp_path / "organs.nii.gz", organs())
    trimesh.creation.icosphere(2, radius=20).export(tmp_path / "kidney.stl")  # 40 mm, which alone would be 400
    assert "\nunit: mm   #" in proposed(tmp_path)


def test_the_body_in_another_image_is_above_otsus_threshold(tmp_path: Path) -> None:
    values = image(organs(), 100, 600)
    save(tmp_path / "mr.nii", values)
    save(tmp_path / "organs.nii", organs())
    text = proposed(tmp_path)
    (line,) = [line for line in text.splitlines() if "body:" in line]
    assert float(line.split("above: ")[1].split(",")[0]) == pytest.approx(threshold_otsu(values[::4, ::4]), rel=0.01)
    assert line.endswith("# guessed: by Otsu's threshold")
    assert load_scene(tmp_path).structures[0].mesh.extents[0] == pytest.approx(32 * MM, abs=MM)


def test_organs_without_a_body_are_named_as_such(tmp_path: Path) -> None:
    save(tmp_path / "organs.nii", organs())
    filled = f"# Labels fill {100 * (organs() > 0).mean():.0f} % of the volume, and the rest is gel: name an image as"
    assert filled in proposed(tmp_path)
    assert len(load_scene(tmp_path).structures) == 2


def test_a_mask_and_an_image_with_gaps_beside_labels_do_not_mislead(tmp_path: Path) -> None:
    values = image(organs(), -1000, 30)
    values[0, 0] = np.nan
    save(tmp_path / "ct.nii", values)
    save(tmp_path / "mask.nii", (organs() > 0).astype(np.uint8))
    save(tmp_path / "organs.nii", organs())
    text = proposed(tmp_path)
    assert "  file: organs.nii" in text
    assert "body: {file: ct.nii, above: -300" in text


def test_meshes_beside_a_volume_without_labels_are_still_proposed(tmp_path: Path) -> None:
    save(tmp_path / "ct.nii", image(organs(), -1000, 30))
    trimesh.creation.icosphere(1, radius=60).export(tmp_path / "liver.stl")
    assert "  # left out: ct.nii: it has no labels but holds " in proposed(tmp_path)
    assert [s.tissue.name for s in load_scene(tmp_path).structures] == ["liver"]


@pytest.mark.parametrize(
    "values",
    [
        image(organs(), 0, 99),
        np.zeros((9, 9, 9), np.uint8),
        -organs().astype(np.int16),
        np.where(organs(), np.float32(np.inf), 0),
    ],
)
def test_a_volume_without_labels_is_refused(tmp_path: Path, values: np.ndarray) -> None:
    save(tmp_path / "image.nii", values)
    with pytest.raises(ValueError, match=r"scene\.folder: .*image\.nii: it has no labels but holds .*; allowed"):
        proposed_scene(tmp_path)
