"""How each map of a data set is stored: its type, its order of bytes or bits, and attenuation in 16 bits."""

from dataclasses import dataclass

import numpy as np

ATTENUATION_SCALE = np.float32(65535)
_ATTENUATION_BITS = 9


@dataclass(frozen=True)
class FrameFormat:
    """How the frames of one map are stored: NumPy's name of the dtype, Blosc's name of the shuffle."""

    dtype: str
    shuffle: str


# Labels repeat as whole bytes; grey levels and 16-bit values pack better with bits, or bytes, of like place together.
FORMATS = {
    "segmentation": FrameFormat("uint8", "noshuffle"),
    "attenuation": FrameFormat("uint16", "shuffle"),
    "target": FrameFormat("uint8", "bitshuffle"),
    "low": FrameFormat("uint8", "bitshuffle"),
    "resimulation": FrameFormat("uint8", "bitshuffle"),
}
#: What is not stored but made from a stored map when it is read, by the name of that map.
DERIVED = {"compensated": "attenuation"}


def encode_attenuation(values: np.ndarray) -> np.ndarray:
    """Attenuation in [0, 1] as uint16, of which the 9 leading bits are kept: within 0.2 % or half a step of 65535.

    The bits below are noise to zstd and to nobody else; without them a frame of attenuation takes about half the
    space (`make bench-dataset`), and small values are as fine as before.
    """
    scaled = np.multiply(np.clip(values, 0, 1), ATTENUATION_SCALE, dtype=np.float32)
    bits = scaled.view(np.uint32)
    dropped = np.uint32(24 - _ATTENUATION_BITS)  # of the 24 significant bits of a float32
    bits += np.uint32(1) << (dropped - np.uint32(1))
    bits >>= dropped
    bits <<= dropped
    np.minimum(scaled, ATTENUATION_SCALE, out=scaled)
    return np.rint(scaled, out=scaled).astype(np.uint16)


def decode_attenuation(stored: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """The inverse of `encode_attenuation`, float32."""
    return np.divide(stored, ATTENUATION_SCALE, out=out, dtype=np.float32)
