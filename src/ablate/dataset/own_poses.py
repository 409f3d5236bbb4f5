"""Probe poses of the user's own, read from a file."""

import math
from pathlib import Path

import numpy as np

from ablate.anatomy.scene_values import csv_rows
from ablate.dataset.split import Part
from ablate.setting import naming, shown
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import check_pose, fan_of

NEAR_MM = 2.0  # about the thickness of the slice that a probe images
COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")


def read_poses(path: str | Path, key: str = "dataset.poses") -> tuple[np.ndarray, np.ndarray]:
    """Poses, (n, 4, 4) float64, probe to world, mm, and the site of each, (n,) int64, of a .npy or .csv file.

    A .npy file holds (n, 4, 4), and every pose is a site of its own. A .csv file has the columns x, y, z of the middle
    of the face, mm, and qw, qx, qy, qz, a unit quaternion; a column `site` is optional.
    `key` stands in messages. A FileNotFoundError or ValueError, when the file is missing or holds something else, or a
    pose is not rigid, names file and row.
    """
    path = Path(path)
    where = f"{key}={path}"
    if path.suffix.lower() not in (".npy", ".csv"):
        raise ValueError(f"{where}: allowed are .npy and .csv")
    if not path.is_file():
        raise FileNotFoundError(f"{where}: no such file")
    if path.suffix.lower() == ".csv":
        with naming(f"{key}="):
            poses, sites = _of_csv(path)
    else:
        # of any kind: NumPy raises its own for each part of a header
        with naming(f"{where}: not readable as .npy: ", Exception), path.open("rb") as stream:
            poses = np.load(stream, allow_pickle=False)
        if not isinstance(poses, np.ndarray):
            raise ValueError(f"{where}: is an archive (.npz), allowed is one array (.npy)")
        poses = poses[None] if poses.shape == (4, 4) else poses  # one, as the viewer saves it
        sites = np.arange(len(poses) if poses.ndim else 0, dtype=np.int64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or len(poses) == 0 or poses.dtype.kind not in "fiu":
        raise ValueError(f"{where}: must hold poses of shape (n, 4, 4), not {poses.dtype} of {poses.shape}")
    for i, pose in enumerate(poses):
        with naming(f"{where}: pose {i}: "):
            check_pose(pose)
    return poses.astype(np.float64), sites


def _of_csv(path: Path) -> tuple[np.ndarray, np.ndarray]:
    from scipy.spatial.transform import Rotation

    rows = csv_rows(path, COLUMNS, ("site",))
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    sites = np.arange(len(rows), dtype=np.int64)
    for i, (line, row) in enumerate(rows):
        try:
            x, y, z, *quaternion = (float(row[name]) for name in COLUMNS)
            sites[i] = np.int32(row.get("site", i))
        except (ValueError, OverflowError):
            values = shown(", ".join(f"{name}={value}" for name, value in row.items()))
            allowed = "numbers, and whole ones of 32 bits as site"
            raise ValueError(f"{line}: allowed are {allowed}, not {values}") from None
        length = math.hypot(*quaternion)
        if not abs(length - 1) < 1e-3:
            raise ValueError(f"{line}: the quaternion must have length 1, not {length:.4g}")
        poses[i, :3, :3] = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        poses[i, :3, 3] = x, y, z
    return poses, sites


def near_training(poses: np.ndarray, split: np.ndarray, probe: Probe) -> str:
    """Which frames of validation and test see nearly what a training frame sees; empty where none does.

    The distance of two frames is that of three points of their fans, the middle of the face and the two ends of the
    deepest line, as the root of the mean square.

    Parameters
    ----------
    poses : (n, 4, 4) float64, mm
        Of the frames.
    split : (n,) uint8 of `Part`
        Their parts.
    probe : Probe
        Whose fan it is.
    """
    from scipy.spatial import cKDTree

    width, depth = fan_of(probe).size_mm[1], probe.depth_mm
    points = np.array([[0, 0, 0, 1], [-width / 2, 0, depth, 1], [width / 2, 0, depth, 1]]).T
    places = (poses @ points)[:, :3].reshape(len(poses), -1) / math.sqrt(points.shape[1])
    training = split == Part.train
    if not training.any():
        return ""
    distances = cKDTree(places[training]).query(places)[0]
    found = []
    for part in (Part.validation, Part.test):
        near = distances[(split == part)] < NEAR_MM
        if near.any():
            found.append(f"{int(near.sum())} of {len(near)} {part.name} frames")
    if not found:
        return ""
    nearest = distances[~training].min()
    return f"{' and '.join(found)} are within {NEAR_MM:g} mm of a training frame (the nearest {nearest:.2g} mm)"
