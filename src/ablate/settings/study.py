"""All settings of a job as one frozen dataclass; the rooms' own settings are groups of it.

Each key, its type, default, range and what it decides stand at its field (`ablate.setting`). This module knows nothing
of Hydra; `command.schema` makes Hydra's schema from it.
"""

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from ablate.anatomy.scene import FEWEST_TRIANGLES
from ablate.anatomy.site_grid import MOST_POSES
from ablate.dataset.encoding import Encoding
from ablate.dataset.split import SplitBy
from ablate.evaluation.settings import EvaluationSettings
from ablate.networks.spec import GeneratorSpec
from ablate.setting import LONGEST_NAME, Checked, check_name, composed_letters, cut_name, setting, shown
from ablate.training.settings import TrainingSettings
from ablate.ultrasound.settings import MOST_GAIN_DB, ConvexProbe, Probe, SimulatorSettings

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


class Verbosity(StrEnum):
    """What the terminal shows of a run's log: warnings alone, all of it, or also what libraries tell."""

    quiet = "quiet"
    normal = "normal"
    debug = "debug"


class ExportFormat(StrEnum):
    """`png`: what `scene=pairs` reads; `nnunet`: raw data of nnU-Net 2; `dicom`: ultrasound images and DICOM SEG."""

    png = "png"
    nnunet = "nnunet"
    dicom = "dicom"


class ClassesBy(StrEnum):
    """Classes of an exported segmentation: `structures` by the scene's names of them; `tissues` as in S."""

    structures = "structures"
    tissues = "tissues"


@dataclass(frozen=True)
class SceneSettings(Checked):
    """Which anatomy."""

    kind: str = setting("fetal", "Where scene or pairs come from: a file of conf/scene.")
    folder: str | None = setting(None, "Folder of your own scene, or of your pairs.", is_path=True)
    triangles: int = setting(675_000, "Triangles of the built-in anatomy.", least=FEWEST_TRIANGLES)
    anatomy_seed: int = setting(0, "Which patient the built-in anatomy is.", least=0)
    target: str | None = setting(None, "Simulator of your own, a function, as `my_package.my_simulator`.")


@dataclass(frozen=True)
class DatasetSettings(Checked):
    """Which pairs are simulated and how they are split; the paper's 6,669 frames, 6,000 of them for training."""

    frames: int = setting(
        6669, "Frames of the data set; fewer where the probe sites offer fewer usable poses.", least=1
    )
    grid: tuple[int, int, int, int] | None = setting(
        (13, 19, 9, 3),
        "Counts of heights, angles, tilts and rolls of the probe sites; null takes the scene's own.",
        least=1,
    )
    split: SplitBy = setting(
        SplitBy.site, "What is kept on one side: probe sites, or (as the paper did) frames; `both` tests both ways."
    )
    validation: float = setting(0.05, "Share of the sites or frames that validate.", above=0, below=1)
    test: float = setting(0.1, "Share of the sites or frames that test.", above=0, below=1)
    seed: int = setting(0, "Seed of scatterers, chosen frames and split.", least=0)
    press_mm: float = setting(8.0, "How far the probe is pressed in.", least=0, most=1000, unit="mm")
    shard: int = setting(16, "Frames a file.", least=1, most=10_000, incidental=True)
    workers: int = setting(0, "Processes that simulate; 0 is one a core.", least=0, incidental=True)
    # Of poses, what they are decides, not the file's name: see `sources.simulated`.
    poses: str | None = setting(
        None, "File of your own poses instead of the scene's grid.", incidental=True, is_path=True
    )
    format: ExportFormat = setting(
        ExportFormat.png, "What `task=export` writes; with `dicom`, also a cine of `task=render`.", incidental=True
    )
    classes: ClassesBy = setting(
        ClassesBy.structures,
        "Classes of the segmentations that `task=export` writes; of `png` always tissues.",
        incidental=True,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.grid is not None and math.prod(self.grid) > MOST_POSES:
            raise ValueError(f"grid={list(self.grid)}: allowed are at most {MOST_POSES} poses in all")
        if self.validation + self.test >= 1:
            raise ValueError(f"validation={self.validation}: allowed is below 1 - dataset.test = {1 - self.test:g}")


@dataclass(frozen=True)
class CropChoice(Checked):
    """How crops are drawn, besides `training.crop` and `training.batch_size`; see `dataset.CropSettings`."""

    fan_fraction: float = setting(0.0, "Least share of a crop that lies in the fan.", least=0, most=1)
    flip: bool = setting(False, "Whether half of the crops are mirrored.")
    workers: int = setting(
        2, "Threads that prepare batches ahead; 0 prepares each when it is asked for.", least=0, incidental=True
    )


class Provenance(StrEnum):
    """What a run stores of what it was made with; `minimal` leaves out uncommitted changes and installed packages."""

    full = "full"
    minimal = "minimal"


@dataclass(frozen=True)
class TrackingSettings(Checked):
    """Where runs are tracked.

    Settings are stored and shown, so `uri` may hold no password: MLflow takes it from the environment.
    """

    uri: str | None = setting(
        None, "MLflow's store; null is the SQLite file `mlflow.db` in `runs_dir`.", incidental=True
    )
    experiment: str = setting("ablate", "MLflow's experiment.", incidental=True)
    provenance: Provenance = setting(Provenance.full, "What a run stores of what it was made with.", incidental=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.uri is not None:
            _check_store(self.uri)
        object.__setattr__(self, "experiment", composed_letters(self.experiment))
        if not re.fullmatch(r"[\w/]([\w.+@/ -]*[\w.+@-])?", self.experiment) or len(self.experiment) > LONGEST_NAME:
            allowed = f"at most {LONGEST_NAME} letters, digits, blanks and _.+-@/, the first a letter, a digit, _ or /"
            raise ValueError(f"experiment={shown(self.experiment)}: allowed are {allowed}")


def _check_store(uri: str) -> None:
    """Raise ValueError unless MLflow can track into `uri`: a server or a database, and no secret within."""
    if not re.match(r"(https?|(sqlite|postgresql|mysql|mssql)(\+\w+)?)://|databricks", uri):
        allowed = "http://, https://, sqlite:///, postgresql://, mysql:// and mssql:// with what follows"
        raise ValueError(f"uri={shown(uri)}: allowed are {allowed}")
    scheme, _, rest = uri.partition("://")
    named = re.search(r"[?&;](\w*passw\w*|pwd|\w*token|\w*secret)=", rest, re.IGNORECASE)
    user = r".*@" if scheme.startswith("http") else r"[^@]*:.*@"  # a user of a web server may be a token
    if not scheme.startswith("sqlite") and (named or re.match(user, rest)):
        where = "MLFLOW_TRACKING_USERNAME and MLFLOW_TRACKING_PASSWORD, or PGPASSWORD for a database"
        raise ValueError(f"uri: holds a user or a password; allowed is a URI without, and {where}")


@dataclass(frozen=True)
class ViewerSettings(Checked):
    """Where `task=view` shows its page, always on this machine alone."""

    port: int = setting(8090, "Port of the page.", least=1, most=65535, incidental=True)
    open: bool = setting(True, "Whether a browser is started.", incidental=True)


@dataclass(frozen=True)
class StudySettings(Checked):
    """A whole job, as the rooms take it. `model` is the composed generator; see conf/ for every value."""

    task: Task = setting(Task.study, "What the program does.", incidental=True)
    preset: str = setting("paper", "Sizes of frames, networks and training; a file of conf/preset.", incidental=True)
    variant: str = setting("sa2h", "The network; a file of conf/variant.", incidental=True)
    seed: int = setting(0, "Seed of the networks and crops.", least=0)
    encoding: Encoding = setting(Encoding.echogenicity, "How labels are read.")
    encoding_seed: int | None = setting(None, "Seed of the order of `encoding=arbitrary`; null is the run's.", least=0)
    reference: str = setting("sa2h", "The variant that all others are compared with.", incidental=True)
    scene: SceneSettings = SceneSettings()
    probe: Probe = ConvexProbe()
    simulator: SimulatorSettings = SimulatorSettings()
    dataset: DatasetSettings = DatasetSettings()
    model: GeneratorSpec = GeneratorSpec()
    crops: CropChoice = CropChoice()
    training: TrainingSettings = TrainingSettings()
    metrics: Any = setting("all", "A name or a list of names; see docs/metrics.md.", incidental=True)
    objective: str | None = setting(
        None, "Score that a sweeper minimises or maximises, as `val/psnr_fan`; see docs/own_study.md.", incidental=True
    )
    evaluation: EvaluationSettings = EvaluationSettings()
    tracking: TrackingSettings = TrackingSettings()
    study_name: str | None = setting(None, "Folder of the runs; null is <preset>-<scene name>.", incidental=True)
    runs_dir: str = setting("runs", "Folder of all results.", incidental=True, is_path=True)
    verbose: Verbosity = setting(
        Verbosity.normal, "What the terminal shows of the log of a run: with `quiet`, warnings alone.", incidental=True
    )
    frame: int = setting(0, "The frame that task=preview and task=render show.", incidental=True)
    pose: str | None = setting(
        None,
        "File of poses that task=render shows instead; task=view starts at the first.",
        incidental=True,
        is_path=True,
    )
    plane: str | None = setting(None, "Standard plane of scene=fetal to show or to start from.", incidental=True)
    gain_db: float = setting(
        0.0,
        "Gain of the picture that task=render shows and that task=view starts with; no data set has it.",
        least=-MOST_GAIN_DB,
        most=MOST_GAIN_DB,
        unit="dB",
        incidental=True,
    )
    runs: str | None = setting(
        None,
        "A run, a study or studies whose generators task=view offers; null is runs_dir.",
        incidental=True,
        is_path=True,
    )
    viewer: ViewerSettings = ViewerSettings()

    def __post_init__(self) -> None:
        super().__post_init__()
        shown_at = self.task in (Task.render, Task.view)
        if (self.pose or self.plane) and (not shown_at or (self.pose and self.plane)):
            raise ValueError(f"pose={self.pose}, plane={self.plane}: allowed is one of them, with task=render or view")
        if self.gain_db and not shown_at:
            what = "it is of a picture alone; a data set has simulator.reference_level"
            raise ValueError(f"gain_db={self.gain_db:g}: allowed with task=render or view, as {what}")
        if self.runs and self.task is not Task.view:
            raise ValueError(f"runs={self.runs}: allowed with task=view; where results lie is runs_dir")
        if self.study_name is not None:
            object.__setattr__(self, "study_name", composed_letters(self.study_name))
        check_name("study_name", self.study, _NO_STUDIES)  # so it is a folder of its own directly below `runs`

    @property
    def scene_name(self) -> str:
        """The kind of the scene, or the name of its folder, cut, and with `_` for what no name of a study may hold."""
        if self.scene.folder is None:
            return self.scene.kind
        name = re.sub(r"[^\w.+ -]", "_", composed_letters(Path(self.scene.folder).resolve().name))
        return cut_name(name, _LONGEST_SCENE_NAME)

    @property
    def label_seed(self) -> int:
        """Seed of the order of the labels."""
        return self.seed if self.encoding_seed is None else self.encoding_seed

    @property
    def study(self) -> str:
        return self.study_name or f"{self.preset}-{self.scene_name}"

    @property
    def results(self) -> Path:
        return Path(self.runs_dir).resolve()

    @property
    def study_dir(self) -> Path:
        return self.results / self.study
