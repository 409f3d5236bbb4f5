"""Files that are written whole or not at all, that are bounded before they are read, and the digest of JSON."""

import glob
import hashlib
import json
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

import numpy as np
from filelock import FileLock, Timeout

#: Bytes that a file of results may unpack to, however small it is: one picture of 16384 x 16384 px, the largest that
#: the simulator makes, or 190 of the paper's; tables of scores and arrays of poses are far smaller.
MOST_UNPACKED = 2**28


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give the name of a new file beside `path`, which replaces `path` when the block ends without an error.

    The name is different each time, so several processes may write `path` at once, and readers find the old file or
    a new one. The new file has the suffix of `path`. An error removes it and leaves `path` as it was; a full disk is
    an OSError.
    """
    partial = path.with_name(f"{path.stem}.{uuid4().hex}.partial{path.suffix}")
    try:
        yield partial
        with partial.open("r+b") as file:
            os.fsync(file.fileno())  # some file systems notice only here that the disk is full
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def held(path: Path, what: str) -> Iterator[None]:
    """Hold the lock at `path`; where another process has it, say at once that `what` is waited for."""
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        sys.stderr.write(f"waiting for another process, which {what} ({path.parent})\n")
        lock.acquire()
    try:
        yield
    finally:
        lock.release()


def remove_partial(path: Path) -> None:
    """Remove what killed processes left of `path`; only where no other process may be writing it."""
    for left in path.parent.glob(f"{glob.escape(path.stem)}.*.partial{glob.escape(path.suffix)}"):
        left.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text whole or not at all."""
    with written_whole(path) as partial:
        partial.write_text(text, "utf-8")


def write_image(path: Path, values: np.ndarray) -> None:
    """Write grey levels or colours, in the format that the suffix names, whole or not at all."""
    from PIL import Image  # only here: the settings of a command line load without it

    with written_whole(path) as partial:
        Image.fromarray(values).save(partial)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write JSON whole or not at all."""
    write_text(path, json.dumps(content, indent=2, sort_keys=True))


def read_json(path: Path) -> dict[str, Any]:
    """Read the JSON object of a file; a ValueError that names the file where it holds something else, or nothing."""
    try:
        content = json.loads(path.read_text("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} cannot be read: it holds no JSON object")
    return content


def known_json(path: Path) -> dict[str, Any]:
    """The JSON object of a file; empty where there is no file, or it is damaged."""
    with suppress(OSError, ValueError):
        return read_json(path)
    return {}


def check_unpacked(path: Path | str, declared: int, most: int = MOST_UNPACKED) -> None:
    """Refuse, by a ValueError, a file whose header declares more bytes than may be unpacked; it may be a stranger's."""
    if declared > most:
        raise ValueError(f"{path}: unpacks to {declared:,} bytes; allowed are {most:,}")


def check_archive(path: Path, most: int | None = None) -> None:
    """Refuse a zip archive, as those of NumPy and torch are, for what its directory says of its parts.

    Parameters
    ----------
    path : Path
        Of the file.
    most : int, optional
        Bytes that all parts together may have; without it those of the file, as nothing in it is compressed.

    Raises
    ------
    ValueError
        Where it is no whole archive, its parts have more bytes, or they are compressed in another way than by deflate:
        Python unpacks these whole, whatever the directory says.
    """
    try:
        with ZipFile(path) as archive:
            parts = archive.infolist()
    except BadZipFile as error:
        raise ValueError(f"{path}: not a whole archive ({error})") from error
    for part in parts:
        if part.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
            raise ValueError(
                f"{path}: {part.filename} is compressed by method {part.compress_type}; allowed is deflate"
            )
    check_unpacked(path, sum(part.file_size for part in parts), path.stat().st_size if most is None else most)


def digest_of_files(paths: Iterable[Path]) -> str:
    """First 16 hexadecimal digits of the SHA-256 of the names and contents of the files that exist among `paths`."""
    total = hashlib.sha256()
    for path in paths:
        if path.is_file():
            with path.open("rb") as file:
                total.update(path.name.encode() + hashlib.file_digest(file, "sha256").digest())
    return total.hexdigest()[:16]


def digest(value: Any) -> str:
    """First 16 hexadecimal digits of the SHA-256 of a JSON value."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]
