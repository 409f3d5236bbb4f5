"""Views of MLflow's list of runs that links open: which runs, which columns, and which charts.

MLflow keeps such a view, as its button *Share* makes them, in a tag of the experiment.
"""

import base64
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any
from urllib.parse import quote, urlencode

from ablate.analysis import best_first, ordered_metrics, ranked_by
from ablate.analysis.tables import ARROWS
from ablate.metrics import Direction, Shown, metric_of, shown_in
from ablate.metrics.metric import FRAME_TIME
from ablate.publish.results_view import EXAMPLES
from ablate.publish.store import Store
from ablate.storage import digest
from ablate.study.opened import Study

_TAG = "mlflow.sharedViewState."
_STUDIES = "studies"
#: MLflow shows the images of no more runs.
MOST_SHOWN = 10
_IMAGES_A_ROW = 3
_CURVES = ("val/psnr_fan_curve", "val/pchi2_tissue_curve", "val/fd_speckle_curve", "train/l1")
# What MLflow makes of the names of metrics and images; below the charts of a view, and closed.
_OTHER_SECTIONS = ("examples", "frames", "test", "train", "val", "Model metrics", "System metrics")


def share_studies(store: Store) -> str:
    """Link to a table of all studies with the best network of each and its scores."""
    columns = [_column("tags", "best"), *(_column("metrics", f"test/{name}") for name in shown_in(Shown.headline))]
    state = {"searchFilter": "tags.kind = 'study'", "selectedColumns": columns, "columnOrder": columns}
    return _shared(store, _STUDIES, state, "TABLE")


def share_leaderboard(store: Store, study: Study) -> str:
    """Link to a table of the variants of a study, best first, with the means over their seeds; they unfold to runs."""
    by, order = ranked_by(study.table), best_first(study.table)
    names = [name for name in ordered_metrics(list(study.table["metric"])) if name in shown_in(Shown.screen)]
    names.sort(key=lambda name: name != by)
    columns = [_column("metrics", name if name == FRAME_TIME else f"test/{name}") for name in names]
    state = {
        "searchFilter": _of_study(store, study),
        "selectedColumns": columns,
        "columnOrder": columns,
        "groupBy": {"aggregateFunction": "average", "groupByKeys": [{"mode": "param", "groupByData": "variant"}]},
        "groupsExpanded": {f"param.variant.{name}": False for name in order},
        **_ordered(by),
    }
    return _shared(store, f"{study.folder.name} leaderboard", state, "TABLE")


def share_charts(store: Store, study: Study, run_ids: Sequence[str]) -> str:
    """Link to some runs of a study side by side: their test frames, scores and curves."""
    by = ranked_by(study.table)
    scored = [name for name in ordered_metrics(list(study.table["metric"])) if metric_of(name).computed]
    shown = [name for name in scored if name == by or name in shown_in(Shown.report)]
    charts: dict[str, list[dict[str, Any]]] = {
        "Test frames, generated and target": [{"type": "IMAGE", "imageKeys": [EXAMPLES], "step": 0}],
        "Scores": [_bars(name) for name in sorted(shown, key=lambda name: name != by)],
        "Curves by images seen": [{"type": "LINE", "metricKey": key, "displayName": key} for key in _CURVES],
    }
    charts["Test frames, generated and target"][0] |= {"showRunParams": False, "displayName": "Best first"}
    sections = [
        {"uuid": name, "name": name, "display": name in charts, "isReordered": True}
        for name in (*charts, *_OTHER_SECTIONS)
    ]
    sections[0] |= {"columns": 1, "cardHeight": 100 + 430 * math.ceil(min(len(run_ids), MOST_SHOWN) / _IMAGES_A_ROW)}
    cards = [
        {"uuid": f"{name} {k}", "metricSectionId": name, "runsCountToCompare": MOST_SHOWN, "deleted": False, **card}
        for name, section in charts.items()
        for k, card in enumerate(section)
    ]
    among = ", ".join(f"'{run_id}'" for run_id in run_ids[:MOST_SHOWN])
    state = {
        "searchFilter": f"attributes.run_id IN ({among})",
        "compareRunCharts": cards,
        "compareRunSections": sections,
        "isAccordionReordered": True,
        "runListHidden": True,
        **_ordered(by, best_first=False),  # charts show the last run first
    }
    return _shared(store, f"{study.folder.name} charts", state, "CHART")


def _of_study(store: Store, study: Study) -> str:
    tags = {"kind": "job", "study": study.folder.name, **store.owner}
    return " and ".join(f"tags.{tag} = '{value}'" for tag, value in tags.items())


def _bars(name: str) -> dict[str, Any]:
    metric = metric_of(name)
    return {
        "type": "BAR",
        "metricKey": f"test/{name}",
        "displayName": f"{metric.title} {ARROWS[metric.better]}".strip(),
    }


def _column(kind: str, name: str) -> str:
    return f"{kind}.`{name}`"


def _ordered(metric: str | None, best_first: bool = True) -> Mapping[str, Any]:
    if metric is None:
        return {}
    ascending = (metric_of(metric).better is not Direction.higher) is best_first
    return {"orderByKey": _column("metrics", f"test/{metric}"), "orderByAsc": ascending}


def _shared(store: Store, name: str, state: Mapping[str, Any], mode: str) -> str:
    """Keep a view in a tag of the experiment; returns a link to it, relative to MLflow's address."""
    key = digest([name, dict(store.owner)])
    content = base64.b64encode(zlib.compress(json.dumps(state).encode(), 9)).decode()
    store.client.set_experiment_tag(store.experiment_id, f"{_TAG}{key}", f"deflate;{content}")
    query = urlencode(
        {"compareRunsMode": mode, "viewStateShareKey": key, "workflowType": "machine_learning"}, quote_via=quote
    )
    return f"#/experiments/{store.experiment_id}/runs?{query}"
