"""Which code of this package runs: the files as they were when this process loaded them, whatever they are now."""

from pathlib import Path

import ablate
from ablate.storage import digest_of_files

PACKAGE = Path(ablate.__file__).parent
_SOURCES = (".py", ".csv", ".jinja", ".mplstyle")


def package_digest(package: Path = PACKAGE) -> str:
    """Digest of the names and contents of the package's code, tables and templates, which may lie in no repository."""
    return digest_of_files(sorted(path for path in package.rglob("*") if path.suffix in _SOURCES))


_LOADED = package_digest()  # a process imports this file as it begins, and most of the others with it


def loaded_digest() -> str:
    """The `package_digest` of the files when this process loaded them, which is what it trains and scores by."""
    return _LOADED


def said_of_change(began: str, loaded: str, now: str) -> str:
    """A sentence where the code of a job is not that of its command, or its files are no longer those that run.

    Parameters
    ----------
    began, loaded, now : str
        The `package_digest` that the command began with, that the process of the job has loaded, and of the files now.
    """
    told = []
    if loaded != began:
        told.append(f"this job runs by source {loaded}, and its command began with {began}")
    if now != loaded:
        told.append(f"the files are of source {now} now, and this job runs by {loaded}")
    return f"the code of ablate changes while the command runs: {'; '.join(told)}" if told else ""
