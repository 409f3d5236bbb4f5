"""Runs in MLflow; the only room that knows it."""

from ablate.tracking.provenance import environment, git_state, hardware, packages
from ablate.tracking.store import RunLog, Status, Store, child_run, default_uri, open_store, parent_run

__all__ = [
    "RunLog",
    "Status",
    "Store",
    "child_run",
    "default_uri",
    "environment",
    "git_state",
    "hardware",
    "open_store",
    "packages",
    "parent_run",
]
