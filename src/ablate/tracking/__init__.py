"""Runs in MLflow; the only room that knows it."""

from ablate.tracking.pages import artifact_page, comparison_page
from ablate.tracking.provenance import environment, git_state, hardware, packages
from ablate.tracking.store import RunLog, Status, Store, child_run, default_uri, open_store, parent_run, task_run

__all__ = [
    "RunLog",
    "Status",
    "Store",
    "artifact_page",
    "child_run",
    "comparison_page",
    "default_uri",
    "environment",
    "git_state",
    "hardware",
    "open_store",
    "packages",
    "parent_run",
    "task_run",
]
