"""What a scorer knows of a data set's frames besides its maps: which tissues labels are, and whose fan the mask is."""

from collections.abc import Collection

import numpy as np

from ablate.anatomy import Tissue, TissueKind
from ablate.ultrasound import Probe, fan_mask

_SAME_FAN = 0.98  # of the pixels of two fans together lie in both


def tissue_labels(
    tissues: tuple[Tissue, ...], kinds: Collection[TissueKind] = (TissueKind.soft, TissueKind.bone)
) -> np.ndarray:
    """Labels of some kinds of tissue, uint8; those of soft tissue and bone leave out gas and fluid."""
    return np.array([label for label, tissue in enumerate(tissues, start=1) if tissue.kind in kinds], np.uint8)


def describes_fan(probe: Probe, mask: np.ndarray) -> bool:
    """Whether a fan is that of a probe, up to a few pixels; only then are the depths of the pixels known."""
    expected = fan_mask(probe, (mask.shape[0], mask.shape[1]))
    return bool((expected & mask).sum() >= _SAME_FAN * (expected | mask).sum())
