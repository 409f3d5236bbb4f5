"""Where MLflow's pages are, as links from one of them to another."""

from __future__ import annotations

import json
from collections.abc import Sequence
from urllib.parse import quote

from ablate.tracking.store import Store


def artifact_page(store: Store, run_id: str, path: str) -> str:
    """The artifact viewer, with a file of a run open."""
    return f"#/experiments/{store.experiment_id}/runs/{run_id}/artifacts/{quote(path)}"


def comparison_page(store: Store, run_ids: Sequence[str]) -> str:
    """Some runs side by side: parallel coordinates, parameters, metrics."""
    runs, experiments = (quote(json.dumps(list(ids))) for ids in (run_ids, [store.experiment_id]))
    return f"#/compare-runs?runs={runs}&experiments={experiments}"
