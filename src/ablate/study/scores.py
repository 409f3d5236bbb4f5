"""The scores of a training: one file a metric, known by what the values were computed with, and never changed.

A metric of another version, edited code, another number of noise draws or other test frames is another score, in a file
of its own.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ablate.evaluation import Scores
from ablate.evaluation.settings import EvaluationSettings
from ablate.metrics import METRIC_SETS, METRICS, METRICS_VERSION, FeatureKind, choose_metrics
from ablate.setting import shown
from ablate.storage import check_unpacked, remove_partial, written_whole
from ablate.study.parquet_pages import check_pages
from ablate.user_code import code_digest

_METADATA = b"ablate"
_BYTES_OF_A_VALUE = 8
_SHORT = 8  # hexadecimal digits of digests in the names of files
#: How a file is written: its table is so short that what Parquet tells of it would be most of the file.
_AS_SMALL: Mapping[str, Any] = {
    "compression": "zstd",
    "use_dictionary": ["metric", "source", "split"],
    "write_statistics": False,
    "store_schema": False,
}


@dataclass(frozen=True)
class ScoreKey:
    """What a score is known by."""

    metric: str  # the name that its values have
    source: str  # `v2`, the version of the package's metrics, or the digest of the code of a user's own
    draws: int  # renderings of a frame with other noise
    pixels: str  # the digest of the test frames; empty where they are not known
    asked: str = field(default="", compare=False)  # what names it in `metrics=`: its name, or a dotted path

    @property
    def file_name(self) -> str:
        return f"{self.metric}@{self.source}-draws{self.draws}-{self.pixels[:_SHORT]}.parquet"


def metric_in(file_name: str) -> str:
    """The name of the metric whose values a file of this name holds."""
    return file_name.partition("@")[0]


def definition_in(file_name: str) -> str:
    """What the name of a file says of how a metric is computed: its version or code, and the number of draws."""
    return file_name.partition("@")[2].rpartition("-")[0]


@dataclass(frozen=True)
class Score:
    """One metric of one training.

    `values` has columns frame, site, metric, value, source (`model` or `resimulation`) and split, a row for each frame
    that has a value. `scalars` have names such as `test/psnr`, `test/floor_psnr`, `test/fd_speckle_lower` and
    `val/psnr`. `notes` say what was left out or is wrong with the images.
    """

    values: pd.DataFrame
    scalars: dict[str, float]
    notes: tuple[str, ...]
    scored: str  # when, as ISO 8601


def names_of(asked: str | Iterable[str]) -> list[str]:
    """Names of metrics, and paths of a user's own, behind names and sets; nothing is imported."""
    entries = [asked] if isinstance(asked, str) else asked
    return list(dict.fromkeys(name for entry in entries for name in METRIC_SETS.get(entry, (entry,))))


def wanted_scores(asked: str | Iterable[str], evaluation: EvaluationSettings, pixels: str) -> tuple[ScoreKey, ...]:
    """The scores that are `asked` for, as by `metrics=` of the command line; a user's own metrics are imported.

    Without `evaluation.inception` no distance of Inception's features is wanted. `pixels` is the digest of the test
    frames.
    """
    keys = []
    for name in names_of(asked):
        (metric,) = choose_metrics([name]).values()
        source = f"v{METRICS_VERSION}" if name in METRICS else code_digest(name)[:_SHORT]
        if metric.uses(FeatureKind.inception) and evaluation.inception is None:
            continue
        keys.append(ScoreKey(metric.name, source, evaluation.noise_draws, pixels, asked=name))
    return tuple(keys)


def by_metric(scores: Scores, keys: Iterable[ScoreKey]) -> dict[ScoreKey, Score]:
    """What an evaluation computed, metric by metric; a metric that no frame has a value for has an empty score."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    found = {}
    for key in keys:
        own = scores.of_metric(key.metric)
        found[key] = Score(own.per_image, own.scalars, own.notes, now)
    return found


def write_score(folder: Path, key: ScoreKey, score: Score) -> None:
    """Write a score whole; a file of the same name has the same values, and is replaced where it was damaged."""
    folder.mkdir(exist_ok=True)
    path = folder / key.file_name
    remove_partial(path)
    about = {"scalars": score.scalars, "notes": score.notes, "scored": score.scored, "pixels": key.pixels}
    table = pa.Table.from_pandas(score.values, preserve_index=False).replace_schema_metadata()
    with written_whole(path) as partial, pq.ParquetWriter(partial, table.schema, **_AS_SMALL) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({_METADATA: json.dumps(about)})


def is_whole(path: Path) -> bool:
    """Whether there is a score that can be read."""
    try:
        _about(_checked(path).metadata)
    except (OSError, ValueError):  # pyarrow's are ValueErrors
        return False
    return True


def read_score(path: Path) -> Score:
    """Read a score; a ValueError that names the file where it is damaged, or holds other metrics than its name says."""
    try:
        schema = _checked(path)
        about = _about(schema.metadata)
        texts = [column.name for column in schema if pa.types.is_string(column.type)]
        table = pq.read_table(path, read_dictionary=texts)  # a text that is long is held once
        values = table.to_pandas().astype(dict.fromkeys(texts, object))
        metrics = set(values["metric"])
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    if metrics - {metric_in(path.name)}:
        raise ValueError(f"{path}: holds values of {shown(', '.join(sorted(map(str, metrics))))}")
    return Score(values, about["scalars"], tuple(about["notes"]), about["scored"])


def _checked(path: Path) -> pa.Schema:
    """The columns of a file that declares, in its footer and its pages, no more than may be unpacked; all are plain."""
    with pq.ParquetFile(path) as file:
        about, schema = file.metadata, file.schema_arrow
    plain = (pa.types.is_string, pa.types.is_integer, pa.types.is_floating)
    for column in schema:
        if not any(is_kind(column.type) for is_kind in plain):
            raise ValueError(f"{column.name} is {column.type}; allowed are numbers and text")
    stored = sum(about.row_group(number).total_byte_size for number in range(about.num_row_groups))
    check_unpacked(path, max(stored, about.num_rows * about.num_columns * _BYTES_OF_A_VALUE))
    check_pages(path, about)
    return schema


def _about(metadata: Mapping[bytes, bytes] | None) -> dict[str, Any]:
    """What is kept beside the values; a ValueError where it is not what a score has."""
    about = json.loads((metadata or {}).get(_METADATA, b""))
    kinds = {"scalars": dict, "notes": list, "scored": str}
    if not isinstance(about, dict) or not all(isinstance(about.get(key), kind) for key, kind in kinds.items()):
        raise ValueError("it is no score")
    if not all(isinstance(value, int | float) for value in about["scalars"].values()):
        raise ValueError("a scalar is no number")
    return about
