"""Whatever lies in a folder: what `task=describe` proposes loads, and every file is in it or named with the reason."""

import gzip
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import nibabel
import nrrd
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from ablate.anatomy import load_scene, load_sites, proposed_scene
from ablate.anatomy.volumes import labelled_structures
from support.volumes import AFFINE, blocks, save

Made = Callable[[Path], object]
SHAPE = blocks([1]).shape
RGB = [("R", "u1"), ("G", "u1"), ("B", "u1")]


def organ(number: int) -> np.ndarray:
    return (blocks(range(1, 26)) == number).astype(np.uint8)


def torn(path: Path) -> None:
    content = bytearray(gzip.compress(nibabel.Nifti1Image(blocks([4, 5]), AFFINE).to_bytes()))
    content[-8] ^= 1
    path.write_bytes(content)


def outside(path: Path) -> None:
    """A link to a file that does not lie in the folder."""
    other = Path(f"{path.parent}-beside{''.join(path.suffixes)}")
    nibabel.save(nibabel.Nifti1Image(blocks([7, 8]), AFFINE), other)
    path.symlink_to(other)


def layers(path: Path) -> None:
    directions = np.vstack([np.full(3, np.nan), AFFINE[:3, :3]])
    header = {"space": "RAS", "space directions": directions, "space origin": AFFINE[:3, 3]}
    nrrd.write(str(path), np.zeros((2, *SHAPE), np.uint8), header)


def ball(path: Path, radius: float, head: str = "") -> None:
    path.write_text(head + trimesh.creation.icosphere(2, radius=radius).export(file_type="obj"))


def volume(values: np.ndarray, affine: np.ndarray | None = AFFINE) -> Made:
    return lambda path: save(path, values, affine)


BALL = trimesh.creation.icosphere(0, radius=2)
NOISE = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)
INSIDE = np.pad(np.ones(np.array(SHAPE) - 2, bool), 1)
ANYTHING: dict[str, Made] = {
    "seg.nii.gz": volume(blocks([1, 2, 3])),
    "other.nii": volume(blocks([3, 9, 12, 40])),
    "elsewhere.nii.gz": volume(blocks([1, 2]), np.diag([2, 2, 2, 1])),
    "ct.nii.gz": volume(np.where(INSIDE, 40, -1000).astype(np.int16)),
    "mr.nii.gz": volume(NOISE + 20 * INSIDE),
    "flat.nii.gz": volume(np.full(SHAPE, -3.0)),
    "nowhere.nii.gz": volume(np.full(SHAPE, np.nan)),
    "dark.nii.gz": volume(-1000 + 5 * blocks([1, 2]).astype(np.float32)),
    "liver.nii.gz": volume(organ(7)),
    "rib_left_1.nii.gz": volume(255 * organ(9)),
    "spleen.nii.gz": volume(organ(9)),  # all of it is in the rib
    "aorta.nii.gz": volume(0 * organ(1)),
    "liver.nrrd": lambda path: nrrd.write(
        str(path), organ(8), {"space": "RAS", "space directions": AFFINE[:3, :3], "space origin": AFFINE[:3, 3]}
    ),
    "colour.nii.gz": volume(np.zeros(SHAPE, RGB)),
    "complex.nii.gz": volume(np.zeros(SHAPE, np.complex64)),
    "nearly.nii.gz": volume(blocks([1, 2]) * np.float32(0.9999999)),
    "series.nii.gz": volume(np.stack([blocks([1, 2])] * 2, -1)),
    "sheared.nii.gz": volume(blocks([1, 2]), np.array([[2, 1, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1.0]])),
    "lost.nii.gz": volume(blocks([1, 2]), None),
    "coarse.nii.gz": volume(blocks([1, 2]), np.diag([20, 20, 20, 1])),
    "layers.seg.nrrd": layers,
    "torn.nii.gz": torn,
    "words.nii": lambda path: path.write_text("not a volume"),
    "nothing.nrrd": lambda path: path.touch(),
    "folder.nii.gz": lambda path: path.mkdir(),
    "gone.nii": lambda path: path.symlink_to("nothing there"),
    "stranger.nii.gz": outside,
    "._seg.nii.gz": lambda path: path.write_bytes(b"\x00\x05\x16\x07"),
    "kidney left.obj": lambda path: ball(path, 40),
    "inRAS.obj": lambda path: ball(path, 30, "# 3D Slicer output. SPACE=RAS\n"),
    "inLPS.obj": lambda path: ball(path, 20, "# 3D Slicer output. SPACE=LPS\n"),
    "huge.obj": lambda path: ball(path, 1e6),
    "metres.obj": lambda path: ball(path, 0.2),
    "torn.stl": lambda path: path.write_text("solid"),
    "empty.off": lambda path: path.touch(),
    "folder.ply": lambda path: path.mkdir(),
    "buffers.gltf": lambda path: path.write_text('{"buffers": [{"uri": "../away.bin"}]}'),
    "spleen.mha": lambda path: path.touch(),
    "inner": lambda path: (path.mkdir(), ball(path / "a.obj", 9)),
    "notes.txt": lambda path: path.write_text("1 2 3"),
}


@given(st.sets(st.sampled_from(sorted(ANYTHING)), min_size=1, max_size=7))
@settings(max_examples=25, deadline=None)
@pytest.mark.filterwarnings("ignore")
def test_what_is_proposed_for_any_files_loads_and_the_others_are_named(names: set[str]) -> None:
    with TemporaryDirectory() as place:
        folder = Path(place) / "body"
        folder.mkdir()
        for name in sorted(names):
            ANYTHING[name](folder / name)
        text, refusal = "", ""
        try:
            text = proposed_scene(folder)
        except (ValueError, FileNotFoundError) as error:
            refusal = str(error)
        if refusal:
            usable = {"seg.nii.gz", "other.nii", "elsewhere.nii.gz", "liver.nii.gz", "liver.nrrd", "kidney left.obj"}
            assert not names & usable, "one file does not spoil the others"
            assert refusal.startswith("scene.folder: ")
            assert "\n" not in refusal
            return
        (folder / "scene.yaml").write_text(text)
        with (
            pytest.MonkeyPatch.context() as patch
        ):  # of any voxels there is a surface, as other tests show; it takes long
            patch.setattr(labelled_structures, "label_surface", lambda *_: (BALL.vertices, BALL.faces))
            assert len(load_scene(folder).structures) >= 1
        assert load_sites(folder).heights_mm
        for name in names - {"notes.txt"}:
            assert name in text, "used, or left out with the reason"
