"""What MLflow's run of a training shows when it has ended: scores, a picture, the network, and how to load it."""

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from mlflow.entities import Metric
from PIL import Image, ImageDraw

from ablate import pretrained
from ablate.analysis.scored import BASELINES
from ablate.analysis.tables import ARROWS
from ablate.metrics import Shown, metric_of, shown_in
from ablate.metrics.metric import BASELINE_PREFIXES, FORMULA, RESIMULATED, SCALAR_PREFIXES, is_bound
from ablate.publish.store import Store
from ablate.storage import written_whole
from ablate.study.network import renderer_of
from ablate.study.scores import read_score
from ablate.study.training import Training

NOTE = "mlflow.note.content"
#: The image of a run that its charts begin with: MLflow sorts them by these words.
EXAMPLES = "examples/test"
NETWORK = "network.pt"
_FRAMES, _FRAME_PX, _HEAD_PX = 3, 512, 16
_SHOWN_PX = 400  # MLflow shows 256, which is too little to judge speckle by
_LEGEND = (
    "**Model metrics**: `examples/` are test frames beside their targets; `test/` was measured at the end, and "
    "`test/floor_` is what the same frames score, simulated with other scatterers and paths, and `test/formula_` "
    "what a formula without weights makes of the maps; `frames/` "
    "are validation frames above their targets as training went on; `train/` and `val/` are curves. The step of "
    f"all these is the number of images seen. **Artifacts**: the trained network in `{NETWORK}`, every metric of "
    "every frame in `per_image.parquet`; configuration, code and environment in `provenance`."
)


def publish_results(store: Store, run_id: str, training: Training, scores: Sequence[str], time_ms: int) -> None:
    """The scores of a training, the values of all frames as one table, some frames, and its network.

    Its data set may have been deleted; then there are no frames, and no network.

    Parameters
    ----------
    store : Store
        Where the run is.
    run_id : str
        Of the run.
    training : Training
        What is shown.
    scores : sequence of str
        Names of the files of its scores.
    time_ms : int
        When it ended, of the metrics.
    """
    read = [read_score(training.scores / name) for name in scores]
    scalars = dict(training.result["scalars"])
    for score in read:
        scalars |= score.scalars
    shown = sorted(filter(_is_shown, scalars), key=_in_order)
    store.log_metrics(run_id, [Metric(key, scalars[key], time_ms, 0) for key in shown])
    values = [score.values for score in read if len(score.values)]
    with tempfile.TemporaryDirectory() as folder:
        table, network = Path(folder) / "per_image.parquet", Path(folder) / NETWORK
        if values:
            with written_whole(table) as partial:
                pd.concat(values, ignore_index=True).to_parquet(partial)
        try:
            _publish_examples(store, run_id, training)
            pretrained.save(renderer_of(training), network)
        except (OSError, ValueError, LookupError):  # files are missing or damaged, or it is a network of the user's own
            network.unlink(missing_ok=True)
        store.log_files(run_id, [path for path in (table, network) if path.exists()])
        loads = _how_to_load(store, run_id) if network.exists() else ""
    store.client.set_tag(run_id, NOTE, "\n\n".join(filter(None, [_in_words(scalars), loads, _LEGEND])))


def _is_shown(scalar: str) -> bool:
    """Whether MLflow shows a scalar.

    No bound of an interval is shown, and of the validation frames, whose curves are there, the main metrics alone.
    """
    part, _, name = scalar.rpartition("/")
    return not is_bound(scalar) and (part != "val" or name in shown_in(Shown.headline))


def _in_order(scalar: str) -> tuple[bool, bool, bool]:
    """A key of sorting: test frames first, floors behind, and then validation; MLflow keeps the order."""
    part, _, name = scalar.rpartition("/")
    return part != "test", name.startswith(BASELINE_PREFIXES), part != "val"


def _in_words(scalars: Mapping[str, float]) -> str:
    """The main scores in a line, beside those of the baselines."""
    said = []
    for name in shown_in(Shown.headline):
        metric, value = metric_of(name), scalars.get(f"test/{name}")
        if value is None:
            continue
        known = {source: scalars.get(f"test/{SCALAR_PREFIXES[source]}{name}") for source in (FORMULA, RESIMULATED)}
        beside = [f"{BASELINES[s]} {score:.{metric.decimals}f}" for s, score in known.items() if score is not None]
        others = f" ({', '.join(beside)})" if beside else ""
        said.append(f"{metric.label} {ARROWS[metric.better]} **{value:.{metric.decimals}f}**{others}")
    return " · ".join(said)


def _how_to_load(store: Store, run_id: str) -> str:
    where = f'"runs:/{run_id}/{NETWORK}", tracking_uri="{store.uri}"'
    lines = [f"path = mlflow.artifacts.download_artifacts({where})", "renderer = ablate.load(path)"]
    return "Load it in Python: " + " ".join(f"`{line}`" for line in lines)


def _publish_examples(store: Store, run_id: str, training: Training) -> None:
    """Some test frames as the network renders them, each beside its target, as one image."""
    pictures = training.pictures
    numbers = sorted(pictures)[:_FRAMES]
    if not numbers:
        return
    targets = training.data_set.pairs.read("target", numbers)
    rows = []
    for number, target in zip(numbers, targets, strict=True):
        pair = [_headed(pictures[number], f"frame {number}, generated"), _headed(target, "target")]
        rows.append(np.concatenate(pair, axis=1))
    image = Image.fromarray(np.concatenate(rows))
    if not _smaller_copy(store, run_id):  # publishing may have been stopped after it
        store.client.log_image(run_id, image, key=EXAMPLES, step=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / _smaller_copy(store, run_id)
        image.thumbnail((_SHOWN_PX, _SHOWN_PX), Image.Resampling.LANCZOS)
        image.save(path, quality=90)
        store.client.log_artifact(run_id, str(path), "images")


def _smaller_copy(store: Store, run_id: str) -> str:
    """The name of the file of the examples that MLflow's charts show, or nothing; MLflow decides it."""
    names = [Path(file.path).name for file in store.client.list_artifacts(run_id, "images")]
    examples = (n for n in names if n.startswith(EXAMPLES.replace("/", "~")) and n.endswith("compressed.webp"))
    return next(examples, "")


def _headed(frame: np.ndarray, head: str) -> np.ndarray:
    """A frame, shrunk where it is large, below a line of text."""
    image = Image.fromarray(frame)
    image.thumbnail((_FRAME_PX, _FRAME_PX), Image.Resampling.LANCZOS)
    canvas = Image.new("L", (image.width, image.height + _HEAD_PX))
    canvas.paste(image, (0, _HEAD_PX))
    ImageDraw.Draw(canvas).text((4, 2), head, fill=255)
    return np.asarray(canvas)
