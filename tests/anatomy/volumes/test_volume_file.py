"""Headers of volumes: where voxels lie in the world, and one line for those that cannot be used."""

import re
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest
from nibabel.affines import apply_affine, from_matvec
from scipy.spatial.transform import Rotation

from ablate.anatomy.volumes.label_map import check_volume, slabs

TURNED = from_matvec(Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix() * [0.8, 0.9, 2.5], [5, -7, 9])
SHEARED = from_matvec([[1, 0.2, 0], [0, 1, 0], [0, 0, 1]])
FLIPPED = from_matvec(np.diag([-1.5, 1.5, 2.0]), [40, 0, -10])


def values(shape: tuple[int, ...] = (5, 6, 7)) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 9, shape).astype(np.int16)


IN_RAS = {"space": "RAS", "space directions": np.eye(3), "space origin": [0, 0, 0]}


def test_an_nrrd_may_say_that_it_is_in_mm(tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "a.nrrd"), values(), {**IN_RAS, "space units": ["mm", "mm", "mm"]})
    assert check_volume(tmp_path / "a.nrrd", "labels.file").spacing_mm == pytest.approx([1, 1, 1])


@pytest.mark.parametrize("affine", [np.eye(4), TURNED, FLIPPED])
def test_nifti_and_nrrd_have_the_affine_that_they_were_written_with(tmp_path: Path, affine: np.ndarray) -> None:
    nibabel.save(nibabel.Nifti1Image(values(), affine), tmp_path / "a.nii.gz")
    lps = np.diag([-1, -1, 1, 1]) @ affine
    header = {"space": "left-posterior-superior", "space directions": lps[:3, :3].T, "space origin": lps[:3, 3]}
    nrrd.write(str(tmp_path / "a.nrrd"), values(), header)
    indices = np.random.default_rng(1).uniform(0, 6, (20, 3))
    for name in ("a.nii.gz", "a.nrrd"):
        volume = check_volume(tmp_path / name, "labels.file")
        assert volume.shape == (5, 6, 7)
        assert apply_affine(volume.affine, indices) == pytest.approx(apply_affine(affine, indices), abs=1e-4)
        assert volume.spacing_mm == pytest.approx(nibabel.affines.voxel_sizes(affine), rel=1e-5)


@pytest.mark.parametrize("series", [(), (1,), (1, 1)])
def test_a_volume_or_a_series_of_one_is_read_in_slabs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, series: tuple[int, ...]
) -> None:
    monkeypatch.setattr("ablate.anatomy.volumes.label_map._SLAB_VOXELS", 60)
    nibabel.save(nibabel.Nifti1Image(values().reshape(5, 6, 7, *series), np.eye(4)), tmp_path / "a.nii.gz")
    parts = list(slabs(check_volume(tmp_path / "a.nii.gz", "labels.file")))
    assert [part.shape for _, part in parts] == [(5, 6, 2)] * 3 + [(5, 6, 1)]
    assert np.array_equal(np.concatenate([part for _, part in parts], axis=2), values())


@pytest.mark.parametrize(
    ("shape", "affine", "message"),
    [
        ((4, 5, 6, 2), np.eye(4), "has 4 axes, (4, 5, 6, 2); allowed is one volume of 3"),
        ((4, 5, 6), None, "has no affine, so where its voxels lie is not known; allowed is sform or qform"),
        ((4, 5, 6), SHEARED, "is sheared: its axes 0 and 1 meet at 78.7 degrees; allowed are right angles"),
        ((4, 5, 6), np.diag([10, 10, 10, 1]), "has voxels of 10 x 10 x 10 mm; allowed are sides of 0.01 to 6 mm"),
        ((4, 5, 6), np.diag([1, 1, np.nan, 1]), "has an affine that is not finite"),
    ],
)
def test_a_volume_that_cannot_be_used_is_named_in_one_line(
    tmp_path: Path, shape: tuple[int, ...], affine: np.ndarray | None, message: str
) -> None:
    image = nibabel.Nifti1Image(values(shape), None)
    if affine is not None:
        image.header.set_sform(affine, 1)
    image.to_filename(tmp_path / "a.nii")
    with pytest.raises(ValueError, match=rf"^labels\.file: .*a\.nii {re.escape(message)}") as caught:
        check_volume(tmp_path / "a.nii", "labels.file")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({}, "has no affine"),
        ({"space": "scanner-xyz", "space directions": np.eye(3), "space origin": [0, 0, 0]}, "its space is 'scanner"),
        ({"space": "LPS", "space directions": 8 * np.eye(3), "space origin": [0, 0, 0]}, "has voxels of 8 x 8 x 8 mm"),
        ({**IN_RAS, "space units": ["cm", "cm", "cm"]}, "its unit is 'cm'; allowed is mm"),
    ],
)
def test_an_nrrd_that_cannot_be_used_is_named_in_one_line(
    tmp_path: Path, header: dict[str, object], message: str
) -> None:
    nrrd.write(str(tmp_path / "a.nrrd"), values(), header)
    with pytest.raises(ValueError, match=rf"^labels\.file: .*a\.nrrd.*{message}"):
        check_volume(tmp_path / "a.nrrd", "labels.file")


@pytest.mark.parametrize("name", ["a.nii.gz", "a.nii", "a.nrrd"])
def test_what_is_no_volume_or_ends_early_is_named_in_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"not a volume")
    with pytest.raises(ValueError, match=rf"^labels\.file: .*{re.escape(name)}: not readable") as caught:
        check_volume(path, "labels.file")
    assert "\n" not in str(caught.value)
    if name.endswith("nrrd"):
        header = {"space": "LPS", "space directions": np.eye(3), "space origin": [0, 0, 0]}
        nrrd.write(str(path), values((40, 40, 40)), header)
    else:
        nibabel.save(nibabel.Nifti1Image(values((40, 40, 40)), np.eye(4)), path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ValueError, match=rf"{re.escape(name)}: not readable to its end") as caught:
        list(slabs(check_volume(path, "labels.file")))
    assert "\n" not in str(caught.value)


def test_more_voxels_than_any_scan_has_are_refused_by_the_header(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(values(), np.eye(4))
    for shape in ((32767, 32767, 32767), (5, -6, 7)):
        image.header["dim"][1:4] = shape
        (tmp_path / "a.nii").write_bytes(image.header.binaryblock + bytes(2000))
        with pytest.raises(
            ValueError, match=r"^labels\.file: .*a\.nii(: not readable| has .* voxels; allowed are 1 and)"
        ):
            check_volume(tmp_path / "a.nii", "labels.file")


def test_an_nrrd_that_holds_more_than_its_header_says_is_refused(tmp_path: Path) -> None:
    nrrd.write(str(tmp_path / "a.nrrd"), np.zeros((25, 25, 25), np.uint8), IN_RAS)
    content = (tmp_path / "a.nrrd").read_bytes()
    (tmp_path / "a.nrrd").write_bytes(content.replace(b"sizes: 25 25 25", b"sizes: 4 4 4"))
    with pytest.raises(ValueError, match=r"a\.nrrd: not readable to its end"):
        list(slabs(check_volume(tmp_path / "a.nrrd", "labels.file")))


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nibabel.save(nibabel.Nifti1Image(values(), np.eye(4)), tmp_path / "a.nii")
    nrrd.write(str(tmp_path / "a.nrrd"), values())
    for module, package, name in (("nibabel", "nibabel", "a.nii"), ("nrrd", "pynrrd", "a.nrrd")):
        monkeypatch.setitem(__import__("sys").modules, module, None)
        with pytest.raises(ValueError, match=rf"{name} needs the package {package}: pip install "):
            check_volume(tmp_path / name, "labels.file")
