"""What the tests of several rooms share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
torch.set_num_threads(1)


@pytest.fixture(scope="session")
def cases() -> Path:
    """Scene folders made by others; they are not part of the project, and tests that need them skip without."""
    root = Path(__file__).resolve().parents[1]
    folder = Path(os.environ.get("ABLATE_CASES", root.parent / "shared" / "cases"))
    if not folder.is_dir():
        pytest.skip(f"no scene folders at {folder}; ABLATE_CASES names another place")
    return folder
