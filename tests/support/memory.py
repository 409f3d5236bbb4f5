"""How much memory a piece of code takes."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def taking_at_most(megabytes: float) -> Iterator[None]:
    """Check how far the memory of this process rises; Linux alone tells."""
    if sys.platform != "linux":
        yield
        return
    Path("/proc/self/clear_refs").write_text("5")  # the peak is now what is held
    before = _peak_mb()
    yield
    assert _peak_mb() - before < megabytes


def _peak_mb() -> float:
    status = Path("/proc/self/status").read_text()
    return float(re.search(r"VmHWM:\s*(\d+)", status)[1]) / 1024
