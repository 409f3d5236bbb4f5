"""A folder of PNGs is taken as it is, or refused with the name of what does not fit."""

import re
import shutil
import struct
import zlib
from pathlib import Path
from typing import Literal
from unicodedata import normalize

import numpy as np
import pytest
from PIL import ExifTags, Image
from skimage.io import imread, imsave

from ablate.dataset import (
    Part,
    PlacedFrames,
    PngFolder,
    StoredAs,
    content_digest,
    create_pairs,
    import_pairs,
    picture_digests,
    read_fan,
    validate_png_folder,
)
from ablate.dataset.png_tables import odd_lengths
from ablate.networks import Space
from ablate.ultrasound import ConvexProbe, LinearProbe, PhasedProbe, Probe, fan_mask
from ablate.ultrasound.probe import pixel_coordinates_mm, square_pixels

H, W = 20, 30
NAMES = ("a_0", "a_1", "b_0", "b_1", "c_0")
FAN = np.zeros((H, W), bool)
FAN[2:18, 5:25] = True


def save(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    imsave(path, image, check_contrast=False)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    for name in NAMES:
        save(tmp_path / "segmentation" / f"{name}.png", (rng.integers(1, 4, (H, W)) * FAN).astype(np.uint8))
        save(tmp_path / "image" / f"{name}.png", rng.integers(0, 256, (H, W), dtype=np.uint8))
    return tmp_path


def imported(checked: PngFolder, path: Path) -> dict[str, np.ndarray]:
    mask, _ = read_fan(checked)
    n = len(checked.names)
    placed = PlacedFrames(np.zeros((n, 4, 4)), np.arange(n), np.zeros(n, np.uint8), mask)
    pairs = create_pairs(path, placed, StoredAs(2, ["x"] * 3), {})
    import_pairs(checked, checked.names, pairs, checked.maps)
    assert not pairs.missing(checked.maps)
    assert pairs.maps == checked.maps
    assert (pairs.mask() == FAN).all()
    return {name: pairs.read(name, range(n)) for name in checked.maps}


def test_a_png_that_is_written_again_with_16_bits_is_refused(folder: Path, tmp_path: Path) -> None:
    """The folder is looked at once a process, and a file that is overwritten changes no folder."""
    checked = validate_png_folder(folder)
    save(folder / "image" / f"{NAMES[0]}.png", np.full((H, W), 300, np.uint16))
    with pytest.raises(ValueError, match=rf"image/{NAMES[0]}\.png: is not plain grey of 8 bits"):
        imported(checked, tmp_path / "pairs")


def test_sites_are_the_names_before_the_last_underscore(folder: Path) -> None:
    checked = validate_png_folder(folder)
    assert checked.names == NAMES
    assert checked.sites == ("a", "a", "b", "b", "c")
    assert checked.maps == {"segmentation", "target"}
    assert (checked.shape, checked.parts, checked.tissues) == ((H, W), None, None)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pixels_become_pairs_and_what_is_outside_the_fan_becomes_0(folder: Path, tmp_path: Path, dtype: type) -> None:
    rng = np.random.default_rng(1)
    for name in NAMES:
        save(folder / "attenuation" / f"{name}.png", rng.integers(0, np.iinfo(dtype).max, (H, W), dtype=dtype))
    stored = imported(validate_png_folder(folder), tmp_path / "set")
    for k, name in enumerate(NAMES):
        np.testing.assert_array_equal(stored["segmentation"][k], imread(folder / "segmentation" / f"{name}.png"))
        np.testing.assert_array_equal(stored["target"][k], imread(folder / "image" / f"{name}.png") * FAN)
        share = imread(folder / "attenuation" / f"{name}.png") / np.iinfo(dtype).max * FAN
        np.testing.assert_allclose(stored["attenuation"][k], share, rtol=1e-6)
    np.testing.assert_array_equal(stored["attenuation"][:, ~FAN], 0)


def test_tables_name_sites_parts_and_tissues(folder: Path) -> None:
    rows = ["name, site, part", "a_0.png, p1, train", "a_1, p1, train", "b_0, p2, validation", "b_1, p2, validation"]
    (folder / "frames.csv").write_text("\n".join([*rows, "c_0, p3, test"]), encoding="utf-8-sig")  # as Excel writes
    (folder / "labels.csv").write_text("label,tissue\n2,liver\n1,coupling_gel\n3,blood\n")
    checked = validate_png_folder(folder)
    assert checked.sites == ("p1", "p1", "p2", "p2", "p3")
    assert checked.parts is not None
    assert checked.parts.tolist() == [Part.train] * 2 + [Part.validation] * 2 + [Part.test]
    assert checked.tissues is not None
    assert [t.name for t in checked.tissues] == ["coupling_gel", "liver", "blood"]


def test_the_digest_follows_names_pixels_and_tables_and_nothing_else(folder: Path) -> None:
    def digest() -> str:
        return content_digest(validate_png_folder(folder))

    before = digest()
    (folder / "notes.txt").write_text("seen on Monday")
    (folder / "image" / "thumbs.db").write_text("")
    assert digest() == before
    (folder / "frames.csv").write_text("name,site\n" + "".join(f"{name},{name}\n" for name in NAMES))
    with_sites = digest()
    save(folder / "image" / "a_0.png", np.zeros((H, W), np.uint8))
    assert len({before, with_sites, digest()}) == 3


def png(width: int, height: int, bits: int, colour: int) -> bytes:
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))


FRAMES = "name,site,part\na_0,1,train\na_1,1,train\nb_0,2,validation\nb_1,2,validation\n"


@pytest.mark.parametrize(
    ("path", "content", "message"),
    [
        ("segmentation", None, r"no folder segmentation in it; needed are segmentation and image"),
        ("image/a_0.png", None, r"image/a_0\.png: missing, though its partner .*segmentation/a_0\.png is there"),
        ("attenuation/a_0.png", png(W, H, 8, 0), r"attenuation/a_1\.png: missing \(and 3 more\), though its"),
        ("image/d_0.png", png(W, H, 8, 0), r"segmentation/d_0\.png: missing, though its partner .*image/d_0"),
        ("image/a_1.png", png(W + 1, H, 8, 0), r"image/a_1\.png: is 31 x 20 px, but .*a_0\.png is 30 x 20"),
        ("image/a_1.png", png(W, H, 8, 2), r"image/a_1\.png: is 8-bit RGB; allowed is 8-bit grey"),
        ("segmentation/a_1.png", png(W, H, 4, 0), r"segmentation/a_1\.png: is 4-bit grey; allowed is 8-bit grey"),
        ("segmentation/a_1.png", png(W, H, 8, 3), r"segmentation/a_1\.png: is 8-bit with a palette"),
        ("image/a_0.png", png(60_000, 60_000, 8, 0), r"a_0\.png: is 60000 x 60000 px; allowed are 1 to 16777216"),
        ("image/a_1.png", "JFIF", r"image/a_1\.png: not a PNG file"),
        ("frames.csv", "frame,site\n", r"frames\.csv: its first line must be name,site and, if wanted, part"),
        ("frames.csv", "name,site\nz_0,1\n", r"frames\.csv, line 2: there is no frame 'z_0'"),
        ("frames.csv", "name,site\na_0,1\na_0,1\n", r"frames\.csv, line 3: frame 'a_0' is listed twice"),
        ("frames.csv", "name,site\na_0,\n", r"frames\.csv, line 2: no site"),
        ("frames.csv", "name,site\na_0,1\n", r"frames\.csv: 4 frames are not listed, the first is 'a_1'"),
        ("frames.csv", FRAMES + "c_0,3,tset\n", r"line 6: part='tset' .*: allowed are train, validation, test"),
        ("frames.csv", FRAMES + "c_0,3,train\n", r"frames\.csv: no frame is in part test"),
        ("frames.csv", b"name,site\na_0,\xe4\n", r"frames\.csv: not readable as CSV in UTF-8"),
        ("frames.csv", "name,site\n" + "x" * 200_000 + ",1\n", r"frames\.csv: not readable as CSV in UTF-8"),
        ("labels.csv", "label,name\n", r"labels\.csv: its first line must be label,tissue, not label,name"),
        ("labels.csv", "label,tissue\n1,livr\n", r"line 2: tissue='livr' \(did you mean liver.*: allowed are"),
        ("labels.csv", "label,tissue\n255,fat\n", r"labels\.csv, line 2: label '255'; allowed are 1 to 254"),
        ("labels.csv", "label,tissue\n1,fat\n1,fat\n", r"labels\.csv, line 3: label 1 is listed twice"),
        ("fan.yaml", "kind: square", r"fan\.yaml: kind='square': allowed are convex, linear, phased"),
        ("fan.yaml", "kind: [convex]", r"fan\.yaml: .*list"),
        ("fan.yaml", "kind: linear\nwidth_mm: wide", r"fan\.yaml: width_mm='wide': allowed are numbers from 1e-06"),
        (
            "fan.yaml",
            "kind: linear\nwidth_mm: 40",
            r"fan\.yaml: no depth_mm; a linear fan has kind, width_mm, depth_mm",
        ),
        ("fan.yaml", "- convex", r"fan\.yaml=\['convex'\]: allowed are mappings of kind, radius_mm"),
        ("labels.csv", "label,tissue\n1,fat\n3,fat\n", r"labels\.csv: the labels must be 1, 2, .* \[1, 3\]"),
    ],
)
def test_what_does_not_fit_is_named_in_one_line(
    folder: Path, path: str, content: bytes | str | None, message: str
) -> None:
    """Of a file with this content, or where a file or folder is missing."""
    place = folder / path
    if content is not None:
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(content if isinstance(content, bytes) else content.encode())
    elif place.is_dir():
        shutil.rmtree(place)
    else:
        place.unlink()
    with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
        validate_png_folder(folder)
    assert "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError, match="nowhere is not a folder"):
        validate_png_folder(folder / "nowhere")


@pytest.mark.parametrize("file", ["NFC", "NFD"])
@pytest.mark.parametrize("table", ["NFC", "NFD"])
@pytest.mark.parametrize("ending", ["", ".png", ".PNG"])
def test_a_frame_is_known_by_its_name_however_it_is_spelled(
    folder: Path, file: Literal["NFC", "NFD"], table: Literal["NFC", "NFD"], ending: str
) -> None:
    """macOS decomposes names of files, and a table may name a file as it is called or without its ending."""
    for name in ("segmentation", "image"):
        for path in (folder / name).iterdir():
            path.rename(path.with_name(normalize(file, f"Mädchen_{path.stem}.PNG")))
    rows = [f"Mädchen_{name}{ending},{normalize(file, 'Bürger')}" for name in NAMES]
    checked = validate_png_folder(folder)
    assert checked.names == tuple(f"Mädchen_{name}" for name in NAMES)
    assert set(checked.sites) == {"Mädchen_a", "Mädchen_b", "Mädchen_c"}
    (folder / "frames.csv").write_text(normalize(table, "\n".join(["name,site", *rows])), encoding="utf-8")
    assert set(validate_png_folder(folder).sites) == {"Bürger"}


def test_a_name_that_ends_as_a_file_is_still_its_own(folder: Path) -> None:
    for name in ("segmentation", "image"):
        (folder / name / "c_0.png").rename(folder / name / "a_0.png.png")
    rows = "".join(f"{name},{k}\n" for k, name in enumerate(["a_0.png", "a_0", "a_1", "b_0", "b_1"]))
    (folder / "frames.csv").write_text(f"name,site\n{rows}")
    checked = validate_png_folder(folder)
    assert dict(zip(checked.names, checked.sites, strict=True))["a_0.png"] == "0"


@pytest.mark.parametrize("other", ["a_0.PNG", "a_0.Png", "ü_0.png"])
def test_two_files_of_one_frame_are_named(folder: Path, other: str) -> None:
    for path in [folder / "image" / normalize("NFD", other), folder / "image" / normalize("NFC", other)]:
        shutil.copy(folder / "image" / "b_0.png", path)
    with pytest.raises(ValueError, match=r"image/.*: there is .*, too; allowed is one file a frame"):
        validate_png_folder(folder)


@pytest.mark.parametrize("turned", range(1, 9))
@pytest.mark.parametrize("place", ["segmentation", "image", "attenuation"])
def test_a_picture_that_viewers_turn_is_refused(folder: Path, tmp_path: Path, turned: int, place: str) -> None:
    for name in NAMES:
        save(folder / "attenuation" / f"{name}.png", np.zeros((H, W), np.uint8))
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = turned
    path = folder / place / "b_0.png"
    Image.fromarray(imread(path)).save(path, exif=exif)
    if turned == 1:
        imported(validate_png_folder(folder), tmp_path / "set")
        return
    with pytest.raises(ValueError, match=rf"{place}/b_0\.png: has an Exif orientation of {turned}, so viewers turn it"):
        imported(validate_png_folder(folder), tmp_path / "set")


def test_pictures_are_the_same_whatever_compresses_them_and_whatever_lies_outside_the_fan(folder: Path) -> None:
    picture = imread(folder / "image" / "a_0.png")
    Image.fromarray(picture).save(folder / "image" / "b_0.png", compress_level=0)
    save(folder / "image" / "c_0.png", np.where(FAN, picture, 255 - picture))
    first, other, *same = picture_digests(validate_png_folder(folder), FAN)
    assert same == [first, same[1], first]
    assert len({first, other, same[1]}) == 3


@pytest.mark.parametrize(
    ("probe", "odd"),
    [
        (ConvexProbe(), ""),
        (ConvexProbe(radius_mm=10, fov_deg=120, depth_mm=80), ""),  # within the body
        (LinearProbe(width_mm=25, depth_mm=30), ""),
        (ConvexProbe(radius_mm=4, fov_deg=70, depth_mm=15), "radius_mm: 4 .* and depth_mm: 15 "),  # cm
        (ConvexProbe(radius_mm=0.04, fov_deg=70, depth_mm=0.15), "radius_mm: 0.04 .* and depth_mm: 0.15 "),  # m
        (ConvexProbe(radius_mm=40, fov_deg=70, depth_mm=1500), "depth_mm: 1500 "),
        (LinearProbe(width_mm=3.8, depth_mm=4), "width_mm: 3.8 .* and depth_mm: 4 "),
        (PhasedProbe(aperture_mm=2, depth_mm=160), "aperture_mm: 2 "),
        (PhasedProbe(fov_deg=1.4), "fov_deg: 1.4 .usual are 10 to 180"),  # radians
    ],
)
def test_lengths_that_no_probe_has_are_named(probe: Probe, odd: str) -> None:
    assert bool(odd_lengths(probe)) == bool(odd)
    assert re.match(odd, odd_lengths(probe))


def test_a_folder_of_jpegs_is_refused_with_the_reason(folder: Path) -> None:
    for path in (folder / "image").iterdir():
        path.rename(path.with_suffix(".jpg"))
    with pytest.raises(FileNotFoundError, match=r"image: no PNG in it; JPEG is not read, as it changes labels"):
        validate_png_folder(folder)


def test_with_their_fan_pairs_are_read_in_beam_space(tmp_path: Path) -> None:
    """A wave along x and z, at the places of the samples as the radius, the angles and the depths give them."""
    (tmp_path / "fan.yaml").write_text("kind: convex\nradius_mm: 50\nfov_deg: 60\ndepth_mm: 120\n")
    probe = ConvexProbe(50, 60, 120)
    shape = square_pixels(probe, 256)
    mask, (x, z) = fan_mask(probe, shape), pixel_coordinates_mm(probe, shape)

    def wave(x: np.ndarray, z: np.ndarray) -> np.ndarray:
        return 128 + 100 * np.sin(x / 15) * np.cos(z / 12)

    image = np.rint(wave(x, z[:, None])).astype(np.uint8) * mask
    labels = np.where(np.hypot(x, z[:, None] + 50) < 110, 1, 2) * mask
    for name in NAMES:
        save(tmp_path / "image" / f"{name}.png", image)
        save(tmp_path / "segmentation" / f"{name}.png", labels.astype(np.uint8))
        save(tmp_path / "attenuation" / f"{name}.png", np.uint16(257) * image)
    checked = validate_png_folder(tmp_path)
    placed = PlacedFrames(np.zeros((5, 4, 4)), np.arange(5), np.zeros(5, np.uint8), mask)
    stored_as = StoredAs(2, ["x"] * 2, Space.image, checked.probe, checked.beam_shape)
    pairs = create_pairs(tmp_path / "set", placed, stored_as, {})
    import_pairs(checked, checked.names, pairs, checked.maps)
    assert pairs.beam_shape == (384, 128)
    beam = {name: pairs.read(name, [0], Space.beam)[0] for name in checked.maps}
    angle, depth = np.deg2rad(np.linspace(-30, 30, 128)), (np.arange(384)[:, None] + 0.5) * (120 / 384)
    expected = wave((50 + depth) * np.sin(angle), (50 + depth) * np.cos(angle) - 50)
    assert psnr(beam["target"], expected) > 40
    assert psnr(255 * beam["attenuation"], expected) > 40
    assert psnr(pairs.converter.to_image(beam["target"])[mask], image[mask]) > 40
    assert (beam["segmentation"][:190] == 1).all()  # 60 mm is row 192, and a pixel 1.6 rows
    assert (beam["segmentation"][194:] == 2).all()
    np.testing.assert_array_equal(pairs.read("target", [0])[0], image)


def psnr(image: np.ndarray, expected: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((image.astype(float) - expected) ** 2)))


def repainted(folder: Path, name: str, where: tuple[int, int], value: int) -> None:
    path = folder / "segmentation" / f"{name}.png"
    image = imread(path).copy()
    image[where] = value
    save(path, image)


def test_labels_and_fans_are_checked_before_anything_is_written(folder: Path) -> None:
    mask, labels = read_fan(validate_png_folder(folder))
    assert (mask == FAN).all()
    assert labels == 3
    repainted(folder, "b_0", (10, 10), 9)
    assert read_fan(validate_png_folder(folder))[1] == 9
    (folder / "labels.csv").write_text("label,tissue\n1,fat\n2,liver\n3,blood\n")
    with pytest.raises(ValueError, match=r"b_0\.png: has label 9; allowed are 0, outside the fan, to 3, those that"):
        read_fan(validate_png_folder(folder))
    repainted(folder, "b_0", (10, 10), 1)
    repainted(folder, "c_0", (0, 0), 1)
    with pytest.raises(ValueError, match=r"c_0\.png: its fan, .*differs at 1 of 600 pixels from that of .*a_0\.png"):
        read_fan(validate_png_folder(folder))


def test_a_mask_of_255_is_no_segmentation(folder: Path) -> None:
    for name in NAMES:
        save(folder / "segmentation" / f"{name}.png", (255 * FAN).astype(np.uint8))
    with pytest.raises(ValueError, match=r"a_0\.png: has label 255; allowed are 0, outside the fan, to 254"):
        read_fan(validate_png_folder(folder))
    for name in NAMES:
        save(folder / "segmentation" / f"{name}.png", np.zeros((H, W), np.uint8))
    with pytest.raises(ValueError, match=r"a_0\.png: all its pixels are 0"):
        read_fan(validate_png_folder(folder))


def test_a_truncated_file_or_a_flipped_byte_is_named_or_changes_nothing_but_pixels(folder: Path) -> None:
    path = folder / "segmentation" / "a_0.png"
    good, rng = path.read_bytes(), np.random.default_rng(0)
    messages = []
    flipped = [good[:k] + bytes([rng.integers(256)]) + good[k + 1 :] for k in rng.integers(0, len(good), 100)]
    for damaged in (good[:60], *flipped):
        path.write_bytes(damaged)
        try:
            read_fan(validate_png_folder(folder))
        except (ValueError, FileNotFoundError) as error:
            messages.append(str(error))
    assert all("a_0.png" in message and "\n" not in message for message in messages)
    assert len(messages) > 60
