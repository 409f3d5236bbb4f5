"""Headers of volumes: where voxels lie in the world, and one line for those that cannot be used."""

import gzip
import re
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nibabel
import nrrd
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nibabel.affines import apply_affine, from_matvec
from scipy.spatial.transform import Rotation

from ablate.anatomy.volumes.volume_file import check_volume, slabs

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
    monkeypatch.setattr("ablate.anatomy.volumes.volume_file._SLAB_VOXELS", 60)
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


@st.composite
def damages(draw: st.DrawFn) -> tuple[float, int]:
    """A place in a file, as a share of its length, and what is done there: a bit that flips, or -1 for its end."""
    return draw(st.floats(0, 1, exclude_max=True)), draw(st.integers(-1, 7))


@given(damages())
@settings(max_examples=120, deadline=None)
def test_a_compressed_file_that_was_damaged_is_refused_or_read_as_it_was_written(damage: tuple[float, int]) -> None:
    """The checksum of gzip covers the header and the voxels; the header of an NRRD stands before it, in plain text."""
    place, bit = damage
    affine = np.diag([2.0, 2, 3, 1])
    with TemporaryDirectory() as folder:
        for name in ("a.nii.gz", "a.nrrd"):
            path = Path(folder) / name
            if name == "a.nrrd":
                nrrd.write(str(path), values(), {**IN_RAS, "space directions": affine[:3, :3]})
            else:
                nibabel.save(nibabel.Nifti1Image(values(), affine), path)
            content = bytearray(path.read_bytes())
            first = content.find(b"\n\n") + 2 if name == "a.nrrd" else 0
            at = first + int(place * (len(content) - first))
            if bit < 0:
                del content[at:]
            else:
                content[at] ^= 1 << bit
            path.write_bytes(content)
            with warnings.catch_warnings():  # of nibabel, about headers
                warnings.simplefilter("ignore")
                volume, parts, refusal = None, [], ""
                try:
                    volume = check_volume(path, "labels.file")
                    parts = [part for _, part in slabs(volume)]
                except ValueError as error:
                    refusal = str(error)
            if volume is None or refusal:
                assert name in refusal
                assert "\n" not in refusal
                continue
            assert bit >= 0, "what ends early is never read"
            assert np.array_equal(np.concatenate(parts, axis=2), values())
            assert np.array_equal(volume.affine, affine)


def test_a_checksum_is_read_though_no_voxel_needs_it(tmp_path: Path) -> None:
    """Stored, not compressed: a changed voxel leaves the stream readable, and only the checksum tells."""
    content = bytearray(gzip.compress(nibabel.Nifti1Image(values((20, 20, 20)), np.eye(4)).to_bytes(), compresslevel=0))
    for place, message in ((5000, "CRC check failed"), (-5, "CRC check failed"), (-2, "Incorrect length")):
        damaged = content.copy()
        damaged[place] ^= 1
        (tmp_path / "a.nii.gz").write_bytes(damaged)
        with pytest.raises(ValueError, match=rf"a\.nii\.gz: not readable to its end: {message}"):
            list(slabs(check_volume(tmp_path / "a.nii.gz", "labels.file")))


@pytest.mark.parametrize("name", ["a.nii.gz", "a.nii", "A.NII.GZ"])
def test_voxels_that_the_header_does_not_declare_are_named(tmp_path: Path, name: str) -> None:
    image = nibabel.Nifti1Image(values((5, 6, 7)), np.eye(4))
    content = bytearray(image.to_bytes())
    content[42:44] = (4).to_bytes(2, "little")  # dim[1]
    (tmp_path / name).write_bytes(gzip.compress(content) if name.lower().endswith("gz") else content)
    with pytest.raises(ValueError, match=rf"{re.escape(name)}: not readable to its end: {2 * 6 * 7} bytes lie behind"):
        list(slabs(check_volume(tmp_path / name, "labels.file")))
    (tmp_path / name).write_bytes(gzip.compress(image.to_bytes()) if name.lower().endswith("gz") else image.to_bytes())
    assert np.array_equal(next(slabs(check_volume(tmp_path / name, "labels.file")))[1], values((5, 6, 7)))


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ([("R", "u1"), ("G", "u1"), ("B", "u1")], r"holds colours \(R, G, B\); allowed is one real number a voxel"),
        ([("R", "u1"), ("G", "u1"), ("B", "u1"), ("A", "u1")], r"holds colours \(R, G, B, A\); allowed is one"),
        (np.complex64, "holds complex numbers; allowed is one real number a voxel"),
        (np.complex128, "holds complex numbers; allowed is one real number a voxel"),
    ],
)
def test_what_is_not_one_real_number_a_voxel_is_named(tmp_path: Path, kind: Any, message: str) -> None:
    nibabel.save(nibabel.Nifti1Image(np.zeros((5, 6, 7), kind), np.eye(4)), tmp_path / "a.nii")
    with pytest.raises(ValueError, match=rf"^labels\.file: .*a\.nii {message}"):
        check_volume(tmp_path / "a.nii", "labels.file")


@pytest.mark.parametrize("kind", ["u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", ">i2", ">f4"])
def test_every_kind_of_real_numbers_is_read(tmp_path: Path, kind: str) -> None:
    for name in ("a.nii.gz", "a.nrrd"):
        if name == "a.nrrd":
            nrrd.write(str(tmp_path / name), values().astype(kind), IN_RAS)
        else:
            nibabel.save(nibabel.Nifti1Image(values().astype(kind), np.eye(4), dtype=np.dtype(kind)), tmp_path / name)
        (part,) = slabs(check_volume(tmp_path / name, "labels.file"))
        assert np.array_equal(part[1], values())


def test_an_exception_that_says_only_a_number_is_put_into_words(tmp_path: Path) -> None:
    image = nibabel.Nifti1Image(values(), np.eye(4))
    image.header["xyzt_units"] = 7  # which there is not
    (tmp_path / "a.nii").write_bytes(image.header.binaryblock + bytes(4) + values().tobytes())
    with pytest.raises(ValueError, match=r"^labels\.file: .*a\.nii: not readable: KeyError "):
        check_volume(tmp_path / "a.nii", "labels.file")


def test_segments_that_overlap_are_named_as_such(tmp_path: Path) -> None:
    header = {**IN_RAS, "space directions": np.vstack([np.full(3, np.nan), np.eye(3)])}
    nrrd.write(str(tmp_path / "a.seg.nrrd"), values((2, 5, 6, 7)), header)
    with pytest.raises(ValueError, match=r"a\.seg\.nrrd has 4 axes, .*; 3D Slicer writes segments that overlap so"):
        check_volume(tmp_path / "a.seg.nrrd", "labels.file")


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nibabel.save(nibabel.Nifti1Image(values(), np.eye(4)), tmp_path / "a.nii")
    nrrd.write(str(tmp_path / "a.nrrd"), values())
    for module, package, name in (("nibabel", "nibabel", "a.nii"), ("nrrd", "pynrrd", "a.nrrd")):
        monkeypatch.setitem(__import__("sys").modules, module, None)
        with pytest.raises(ValueError, match=rf"{name} needs the package {package}: pip install "):
            check_volume(tmp_path / name, "labels.file")
