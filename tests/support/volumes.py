"""Small volumes of labels, and how other programs name what is in them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import nibabel
import numpy as np

MM = 4.0  # a voxel
AFFINE = np.array([[MM, 0, 0, -80], [0, MM, 0, -70], [0, 0, MM, 100], [0, 0, 0, 1.0]])


def blocks(numbers: Sequence[int]) -> np.ndarray:
    """Up to 25 labels, each a block of its own."""
    labels = np.zeros((22, 22, 10), np.uint8)
    for k, number in enumerate(numbers):
        labels[1 + 4 * (k // 5) : 4 + 4 * (k // 5), 1 + 4 * (k % 5) : 4 + 4 * (k % 5), 2:8] = number
    return labels


def save(path: Path, values: np.ndarray, affine: np.ndarray | None = AFFINE) -> None:
    image = nibabel.Nifti1Image(values, affine)
    nibabel.save(image, path)


def save_named(path: Path, values: np.ndarray, names: Mapping[int, str], code: int = 0) -> None:
    """As TotalSegmentator (code 0) and Connectome Workbench (30) write names of labels into NIfTI."""
    rows = "".join(f'<Label Key="{n}" Red="1" Green="0"><![CDATA[{name}]]></Label>\n' for n, name in names.items())
    text = f'<?xml version="1.0" encoding="UTF-8"?> <CaretExtension><LabelTable>{rows}</LabelTable></CaretExtension>'
    image = nibabel.Nifti1Image(values, AFFINE)
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension(code, text.encode()))
    nibabel.save(image, path)
