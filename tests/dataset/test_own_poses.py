"""Poses of the user's own, against SciPy's rotations."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from nibabel.affines import from_matvec
from scipy.spatial.transform import Rotation

from ablate.dataset import Part
from ablate.dataset.own_poses import near_training, read_poses
from ablate.ultrasound import ConvexProbe

ROW = "x,y,z,qw,qx,qy,qz\n0,0,0,1,0,0,0\n"


def poses(count: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    turns = Rotation.random(count, rng=random).as_matrix()
    return np.stack([from_matvec(turn, random.normal(size=3) * 50) for turn in turns])


def test_npy_and_csv_hold_the_same_poses(tmp_path: Path) -> None:
    np.save(tmp_path / "p.npy", expected := poses(7))
    quaternions = Rotation.from_matrix(expected[:, :3, :3]).as_quat()  # x, y, z, w
    rows = [f"{p[0, 3]},{p[1, 3]},{p[2, 3]},{q[3]},{q[0]},{q[1]},{q[2]},{i // 2}"
            for i, (p, q) in enumerate(zip(expected, quaternions, strict=True))]  # fmt: skip
    (tmp_path / "p.csv").write_text("\n".join(["x,y,z,qw,qx,qy,qz,site", *rows]))
    loaded, sites = read_poses(tmp_path / "p.npy")
    assert np.array_equal(loaded, expected)
    assert sites.tolist() == list(range(7))
    np.save(tmp_path / "one.npy", expected[3])
    assert np.array_equal(read_poses(tmp_path / "one.npy")[0], expected[3:4])
    loaded, sites = read_poses(f"{tmp_path}/p.csv")
    assert loaded == pytest.approx(expected, abs=1e-9)
    assert sites.tolist() == [0, 0, 1, 1, 2, 2, 3]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.diag([1.0, 1, 2, 1])[None], r": pose 0: pose must be rigid: the columns"),
        (np.stack([np.eye(4), np.diag([1.0, 1, -1, 1])]), ": pose 1: pose must be rigid: .* a mirror image"),
        (np.full((1, 4, 4), np.nan), ": pose 0: pose must be finite"),
        (np.eye(3), r": must hold poses of shape \(n, 4, 4\), not float64 of \(3, 3\)"),
        ("", r": its first line must be x,y,z,qw,qx,qy,qz and, if wanted, site, not empty$"),
        ("x,y,z,qw,qx,qy,qz\n", r": must hold poses of shape \(n, 4, 4\), not float64 of \(0, 4, 4\)"),
        ("x,y,z,qw,qx,qy\n0,0,0,1,0,0\n", ": its first line must be .*, not x,y,z,qw,qx,qy$"),
        ("x,y,z,qw,qx,qy,qz\n0,0,0,1,1,0,0\n", ", line 2: the quaternion must have length 1, not 1.414"),
        (
            f"{ROW}0,0,far,1,0,0,0\n",
            ", line 3: allowed are numbers, and whole ones of 32 bits as site, not 'x=0, y=0, z=far",
        ),
        ("x,y,z,qw,qx,qy,qz\n0,0,nan,1,0,0,0\n", ": pose 0: pose must be finite"),
        ("x,y,z,qw,qx,qy,qz,Site\n0,0,0,1,0,0,0,1\n", ": its first line must be .*, not .*,Site$"),
        ("x,y,z,qw,qx,qy,qz,x\n0,0,0,1,0,0,0,1\n", ": its first line must be .*, not .*,qz,x$"),
        ("x,y,z,qw,qx,qy,qz,site\n0,0,0,1,0,0,0,1\n0,0,0,1,0,0,0\n", ", line 3: allowed are numbers, and whole ones"),
        ("x,y,z,qw,qx,qy,qz,site\n0,0,0,1,0,0,0,4294967297\n", ", line 2: allowed are .* whole ones of 32 bits"),
    ],
)
def test_what_holds_no_poses_is_named_in_one_line(tmp_path: Path, values: np.ndarray | str, message: str) -> None:
    path = tmp_path / ("p.csv" if isinstance(values, str) else "p.npy")
    path.write_text(values) if isinstance(values, str) else np.save(path, values)
    with pytest.raises(ValueError, match=rf"dataset\.poses=.*{path.name}{message}") as caught:
        read_poses(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_absent_or_of_another_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_poses(tmp_path / "p.npy")
    with pytest.raises(ValueError, match=r"allowed are \.npy and \.csv"):
        read_poses(tmp_path / "p.mat")


@pytest.mark.parametrize(
    "changed",
    [
        lambda content: content[:10] + content[10:].replace(b")", b" ", 1),
        lambda content: content.replace(b"(2,", b"(9" + b"9" * 20 + b",").replace(b" " * 20, b"", 1),
        lambda content: b"PK\x03\x04" + content,
    ],
)
def test_a_damaged_npy_file_is_one_line_whatever_numpy_raises(
    tmp_path: Path, changed: Callable[[bytes], bytes]
) -> None:
    np.save(tmp_path / "p.npy", poses(2))
    content = changed((tmp_path / "p.npy").read_bytes())
    (tmp_path / "p.npy").write_bytes(content)
    with pytest.raises(ValueError, match=r"dataset\.poses=.*p\.npy: not readable as \.npy: .") as caught:
        read_poses(tmp_path / "p.npy")
    assert "\n" not in str(caught.value)


def at(*, x: float = 0.0, roll_deg: float = 0.0, tilt_deg: float = 0.0) -> np.ndarray:
    turn = Rotation.from_euler("zx", [roll_deg, tilt_deg], degrees=True).as_matrix()
    return from_matvec(turn, [x, 0, 0])


@pytest.mark.parametrize(
    ("test", "nearest_mm"),
    [
        (at(x=0.3), 0.3),  # all three points move as far
        (at(x=1.9), 1.9),
        (at(x=2.1), None),
        (at(), 0.0),
        (at(tilt_deg=0.5), 2 / 3**0.5 * 150 * np.sin(np.deg2rad(0.5)) / 2**0.5),  # two of three points, 150 mm deep
        (at(tilt_deg=5), None),
        (at(roll_deg=90), None),
    ],
)
def test_a_frame_of_test_that_sees_what_training_saw_is_said(test: np.ndarray, nearest_mm: float | None) -> None:
    poses = np.stack([at(), at(x=30), at(x=60), test])
    said = near_training(poses, np.array([Part.train, Part.train, Part.validation, Part.test]), ConvexProbe())
    if nearest_mm is None:
        assert said == ""
    else:
        assert said.startswith("1 of 1 test frames are within 2 mm of a training frame (the nearest ")
        assert float(said.split("nearest ")[1].split()[0]) == pytest.approx(nearest_mm, abs=0.06)


def test_without_training_frames_none_is_near() -> None:
    assert near_training(np.stack([at(), at()]), np.full(2, Part.test), ConvexProbe()) == ""
