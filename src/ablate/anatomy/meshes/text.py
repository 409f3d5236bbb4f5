"""Text files of meshes."""

from pathlib import Path

import numpy as np


def mesh_text(path: Path) -> str:
    """A text file with lines that end with a line feed; a ValueError where it holds bytes that no text has.

    Names of materials may be in any encoding, what is read of a mesh is ASCII: every byte is one character.
    """
    content = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    if b"\0" in content:
        raise ValueError("it is no text of one byte a character")
    return content.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")


def rows_of_three(words: list[str]) -> np.ndarray:
    """Numbers (n, 3) float64 of 3n words; a ValueError names a word that is no number."""
    return np.fromiter(map(float, words), np.float64, len(words)).reshape(-1, 3)
