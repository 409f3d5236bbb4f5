"""The `labels` of a scene.yaml proposed for volumes: which file holds them, the tissue of each, and the body."""

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from skimage.filters import threshold_otsu

from ablate.anatomy.volumes.label_map import TABLE
from ablate.anatomy.volumes.volume_file import VolumeFile, check_volume, slabs

_MOST = 128  # different whole numbers in a volume of labels; TotalSegmentator has 118
_OF_TABLE = 20  # so many labels within its classes, and without names, are taken for TotalSegmentator's
_AIR, _SKIN = -500, -300  # Hounsfield units: what reaches down to the first is a CT, and a body is above the second


def proposed_labels(paths: Sequence[Path], tissue_of_name: Callable[[str], tuple[str, str]]) -> dict[str, Any]:
    """Guess which volume holds labels, and what they are, as scene.yaml.jinja shows it; heights are in mm.

    A ValueError says which file is not a volume, or that none holds labels.
    """
    volumes = [check_volume(path, "scene.folder") for path in paths]
    counts = {volume.path: _counts(volume) for volume in volumes}
    counts = {path: count for path, count in counts.items() if count}
    if not counts:
        raise ValueError(f"scene.folder: {paths[0].parent} has no labels; allowed are up to {_MOST} whole numbers")
    labels = max((v for v in volumes if v.path in counts), key=lambda v: len(counts[v.path]))
    count, names = counts[labels.path], _segment_names(labels.path)
    tissues = [(n, *tissue_of_name(names.get(n, ""))) for n in sorted(count) if n]
    images = (v for v in volumes if v.path not in counts and v.shape == labels.shape)
    same = [image for image in images if np.allclose(image.affine, labels.affine, atol=1e-3)]
    body = None
    if same:
        values = np.concatenate([part[::4, ::4][np.isfinite(part[::4, ::4])] for _, part in slabs(same[0])])
        is_ct = values.min() < _AIR
        body = same[0].path.name, *((_SKIN, "a CT") if is_ct else (threshold_otsu(values), "by Otsu's threshold"))
    corners = [labels.affine @ [*corner, 1] for corner in product(*((0, n - 1) for n in labels.shape))]
    return {
        "file": labels.path.name,
        "tissues": tissues,
        "table": TABLE if len(tissues) >= _OF_TABLE and tissues[-1][0] <= 117 and not names else "",
        "body": body,
        "share": 1 - count[0] / count.total(),
        "z_mm": (min(corner[2] for corner in corners), max(corner[2] for corner in corners)),
    }


def _counts(volume: VolumeFile) -> Counter[int]:
    """How many voxels each label has; empty where the values are not labels."""
    count = Counter[int]()
    for _, values in slabs(volume):
        numbers, voxels = np.unique(values, return_counts=True)
        if len(numbers) > _MOST or numbers[0] < 0 or (numbers != np.rint(numbers)).any():
            return Counter()
        count.update(dict(zip(map(int, numbers), map(int, voxels), strict=True)))
    return count if 1 < len(count) <= _MOST else Counter()


def _segment_names(path: Path) -> dict[int, str]:
    """The names that 3D Slicer writes into an NRRD, by label."""
    if path.suffix.lower() != ".nrrd":
        return {}
    import nrrd

    header = nrrd.read_header(str(path))
    ends = [key.removesuffix("LabelValue") for key in header if key.endswith("_LabelValue")]
    return {int(header[f"{end}LabelValue"]): str(header.get(f"{end}Name")) for end in ends}
