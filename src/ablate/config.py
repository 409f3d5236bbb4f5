"""Every value of conf/ as frozen dataclasses, and the way from plain values to them and back.

The rooms' own settings are fields of these, so a key, its type and its default stand in one place. This module knows
nothing of Hydra; `studies.jobs.schema` makes Hydra's schema from it.
"""

import dataclasses
import math
import re
import types
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum, StrEnum
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from ablate.anatomy.fetal.parts import FEWEST_TRIANGLES
from ablate.anatomy.site_grid import MOST_POSES
from ablate.dataset.encoding import Encoding
from ablate.dataset.own_poses import Sweep
from ablate.dataset.split import SplitBy
from ablate.evaluation.settings import EvaluationSettings
from ablate.networks.spec import GeneratorSpec
from ablate.training.settings import TrainingSettings
from ablate.ultrasound.probe_kinds import ConvexProbe, Probe, probe_from, probe_values
from ablate.ultrasound.settings import SimulatorSettings
from ablate.validation import LONGEST_NAME, check_name, check_number, check_store, shown

T = TypeVar("T")
#: What else lies in `runs_dir`; `mlflow` is the database and its journals.
_NO_STUDIES = frozenset({"artifacts", "data", "export", "mlflow", "precision", "render", "slurm", "stability", "view"})
_LONGEST_SCENE_NAME = 100


class ConfigurationError(ValueError):
    """What the user asked for cannot be run; the message is one line and says what is allowed."""


@contextmanager
def refusing(before: str = "") -> Iterator[None]:
    """Turn what a check of values or files raises inside into a ConfigurationError, with some words before it."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise ConfigurationError(f"{before}{error}") from error


class Task(StrEnum):
    """What one call of the program does; see README."""

    study = "study"
    simulate = "simulate"
    describe = "describe"
    plan = "plan"
    compare = "compare"
    preview = "preview"
    render = "render"
    view = "view"
    export = "export"
    precision = "precision"
    stability = "stability"


class SceneKind(StrEnum):
    """`fetal`: the built-in anatomy; `folder`: meshes and a scene.yaml; `pairs`: no scene, but PNGs made elsewhere."""

    fetal = "fetal"
    folder = "folder"
    pairs = "pairs"


class ExportFormat(StrEnum):
    """`png`: what `scene=pairs` reads; `nnunet`: the raw data of nnU-Net 2; `dicom`: one ultrasound image a frame."""

    png = "png"
    nnunet = "nnunet"
    dicom = "dicom"


def _at_least(prefix: str, values: object, **lowest: int) -> None:
    for name, allowed in lowest.items():
        if getattr(values, name) < allowed:
            raise ValueError(f"{prefix}{name}={getattr(values, name)}: allowed are {allowed} and more")


@dataclass(frozen=True)
class SceneSettings:
    """Which anatomy; `triangles` and `anatomy_seed` shape the built-in one, `folder` holds your own, or your pairs."""

    kind: SceneKind = SceneKind.fetal
    folder: str | None = None
    triangles: int = 675_000
    anatomy_seed: int = 0

    def __post_init__(self) -> None:
        _at_least("scene.", self, triangles=FEWEST_TRIANGLES, anatomy_seed=0)


@dataclass(frozen=True)
class DatasetSettings:
    """Which pairs are simulated and how they are split; the paper's 6,669 frames, 6,000 of them for training.

    There are fewer `frames` where the probe sites offer fewer usable poses. `grid` replaces the counts of the scene's
    heights, angles, tilts and rolls; `validation` and `test` are shares of the sites (`split=site`) or frames;
    `press_mm` is how far the probe is pressed in; `workers` 0 is one a core.
    `poses` is a file of your own poses instead of the scene's grid; of a `sweep` it holds the first and the last.
    `format` is what `task=export` writes.
    """

    frames: int = 6669
    grid: tuple[int, int, int, int] | None = (13, 19, 9, 3)
    split: SplitBy = SplitBy.site
    validation: float = 0.05
    test: float = 0.1
    seed: int = 0
    press_mm: float = 8.0
    shard: int = 16
    workers: int = 0
    poses: str | None = None
    sweep: Sweep | None = None
    format: ExportFormat = ExportFormat.png

    def __post_init__(self) -> None:
        _at_least("dataset.", self, frames=1, seed=0, shard=1, workers=0)
        check_number("dataset.press_mm", self.press_mm, 0, 1000)
        if self.grid is not None and (len(self.grid) != 4 or min(self.grid) < 1):
            given = f"dataset.grid={list(self.grid)}"
            raise ValueError(f"{given}: four counts of at least 1 (heights, angles, tilts, rolls)")
        if self.grid is not None and math.prod(self.grid) > MOST_POSES:
            raise ValueError(f"dataset.grid={list(self.grid)}: at most {MOST_POSES} poses in all")
        if self.sweep is not None and self.poses is None:
            raise ValueError(f"dataset.sweep={self.sweep}: needs dataset.poses, a file of the first and the last pose")
        if not (self.validation > 0 and self.test > 0 and self.validation + self.test < 1):
            given = f"dataset.validation={self.validation}, dataset.test={self.test}"
            raise ValueError(f"{given}: each above 0, together below 1")


@dataclass(frozen=True)
class CropChoice:
    """How crops are drawn, besides `training.crop` and `training.batch_size`; see `dataset.CropSettings`.

    `workers` threads prepare batches ahead; 0 prepares each when it is asked for.
    """

    fan_fraction: float = 0.0
    flip: bool = False
    workers: int = 2

    def __post_init__(self) -> None:
        _at_least("crops.", self, workers=0)
        check_number("crops.fan_fraction", self.fan_fraction, 0, 1)


class Provenance(StrEnum):
    """What a run stores of what it was made with; `minimal` leaves out uncommitted changes and installed packages."""

    full = "full"
    minimal = "minimal"


@dataclass(frozen=True)
class TrackingSettings:
    """Where runs are tracked; `uri` null is the SQLite file `mlflow.db` in `runs_dir`.

    Settings are stored and shown, so `uri` may hold no password: MLflow takes it from the environment.
    `register` names the model in MLflow's registry that the reference variant's generator becomes a version of.
    `system_metrics` logs processor, memory, disk, network and GPU through each training.
    """

    uri: str | None = None
    experiment: str = "ablate"
    register: str | None = None
    provenance: Provenance = Provenance.full
    system_metrics: bool = False

    def __post_init__(self) -> None:
        if self.uri is not None:
            check_store("tracking.uri", self.uri)
        if not re.fullmatch(r"[\w/]([\w.+@/ -]*[\w.+@-])?", self.experiment) or len(self.experiment) > LONGEST_NAME:
            allowed = f"at most {LONGEST_NAME} letters, digits, blanks and _.+-@/, the first a letter, a digit, _ or /"
            raise ValueError(f"tracking.experiment={shown(self.experiment)}: allowed are {allowed}")
        if self.register is not None and not re.fullmatch(r"\w[\w.+ -]*", self.register):
            raise ValueError(f"tracking.register={self.register}: allowed are letters, digits, blanks and _.+-")


@dataclass(frozen=True)
class ViewerSettings:
    """Where `task=view` shows its page, always on this machine alone; `open` starts a browser."""

    port: int = 8090
    open: bool = True

    def __post_init__(self) -> None:
        if not 1 <= self.port <= 65535:
            raise ValueError(f"viewer.port={self.port}: allowed are 1 to 65535")


@dataclass(frozen=True)
class StudySettings:
    """A whole job, as the rooms take it. `model` is the composed generator; see conf/ for every value.

    `metrics` is a name or a list of names, see `metrics.choose_metrics`; `frame` is the one that `task=preview`
    shows. `task=render` shows the poses of the file `pose`, the standard `plane`, or else `frame`; `task=view` starts
    at the first of `pose`, or at `plane`. `runs` has the generators that it offers: a run, a study or studies.
    """

    task: Task = Task.study
    preset: str = "paper"
    variant: str = "sa2h"
    seed: int = 0
    encoding: Encoding = Encoding.echogenicity
    encoding_seed: int = 0
    reference: str = "sa2h"
    scene: SceneSettings = SceneSettings()
    probe: Probe = ConvexProbe()
    simulator: SimulatorSettings = SimulatorSettings()
    dataset: DatasetSettings = DatasetSettings()
    model: GeneratorSpec = GeneratorSpec()
    crops: CropChoice = CropChoice()
    training: TrainingSettings = TrainingSettings()
    metrics: Any = "all"
    evaluation: EvaluationSettings = EvaluationSettings()
    tracking: TrackingSettings = TrackingSettings()
    study_name: str | None = None
    runs_dir: str = "runs"
    frame: int = 0
    pose: str | None = None
    plane: str | None = None
    runs: str | None = None
    viewer: ViewerSettings = ViewerSettings()

    def __post_init__(self) -> None:
        _at_least("", self, seed=0, encoding_seed=0)
        shown_at = self.task in (Task.render, Task.view)
        if (self.pose or self.plane) and (not shown_at or (self.pose and self.plane)):
            raise ValueError(f"pose={self.pose}, plane={self.plane}: allowed is one of them, with task=render or view")
        if self.runs and self.task is not Task.view:
            raise ValueError(f"runs={self.runs}: allowed with task=view; where results lie is runs_dir")
        check_name("study_name", self.study, _NO_STUDIES)  # so it is a folder of its own directly below `runs`

    @property
    def scene_name(self) -> str:
        """The name of the scene's folder, cut, and with `_` for what cannot stand in the name of a study."""
        if self.scene.kind is SceneKind.fetal:
            return "fetal"
        name = re.sub(r"[^\w.+ -]", "_", Path(self.scene.folder or "").resolve().name)
        return name.encode()[:_LONGEST_SCENE_NAME].decode(errors="ignore")

    @property
    def study(self) -> str:
        return self.study_name or f"{self.preset}-{self.scene_name}"

    @property
    def results(self) -> Path:
        return Path(self.runs_dir).resolve()

    @property
    def study_dir(self) -> Path:
        return self.results / self.study


def build(cls: type[T], values: dict[str, Any]) -> T:
    """A frozen dataclass from plain values: dicts become dataclasses, lists tuples, strings enums."""
    hints = get_type_hints(cls)
    unknown = sorted(values.keys() - hints.keys())
    if unknown:
        raise ValueError(f"unknown key '{unknown[0]}'; allowed: {', '.join(sorted(hints))}")
    return cls(**{name: _convert(hints[name], value) for name, value in values.items()})


def _convert(hint: Any, value: Any) -> Any:
    if hint == Probe:
        return probe_from(value) if isinstance(value, dict) else value
    if get_origin(hint) in (Union, types.UnionType):
        if value is None:
            return None
        hint = next(a for a in get_args(hint) if a is not type(None))
    if dataclasses.is_dataclass(hint) and isinstance(hint, type) and isinstance(value, dict):
        return build(hint, value)
    if get_origin(hint) is tuple:
        return tuple(value)
    if isinstance(hint, type) and issubclass(hint, Enum) and not isinstance(value, Enum):
        return hint[value]
    return value


def json_ready(value: Any) -> Any:
    """The inverse of `build`, as JSON can hold it: dataclasses as dicts, tuples as lists, enums by name."""
    if isinstance(value, Probe):
        return probe_values(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_ready(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, (list, tuple)):
        return [json_ready(v) for v in value]
    return value
