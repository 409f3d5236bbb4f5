"""What there is to know of a figure of a study: its name, its place in the report, and how it is drawn."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from ablate.analysis.results import StudyResults


class Section(StrEnum):
    """Where the report shows a figure."""

    verdicts = "verdicts"  # above the table of verdicts
    figures = "figures"
    folded = "folded"  # at the end, closed until somebody asks for it


@dataclass(frozen=True)
class Drawing:
    """One picture of a figure, as files, and what its caption says of it."""

    files: Sequence[Path]  # a PNG and a PDF, from `save_figure`; none where there was nothing to draw
    metrics: Sequence[str] = ()  # that it shows
    facts: Mapping[str, object] = field(default_factory=dict)  # other names that its text in `captions.jinja` uses
    folded: bool = False  # whether it is of less interest than the others of its figure


@dataclass(frozen=True)
class StudyFigure:
    """One figure of a study, which may be several drawings.

    A figure of the package is a constant of this type in the module of its function, which `draw_figures` finds there.
    Its text stands in `captions.jinja` under its name.

    Attributes
    ----------
    name : str
        Of its caption.
    section : Section
        Where the report shows its drawings, but for the folded ones.
    draw : callable
        Takes the results of a study and a folder for the files.
    place : float
        Figures are in rising order of it.
    """

    name: str
    section: Section
    draw: Callable[[StudyResults, Path], Iterable[Drawing]]
    place: float


@dataclass(frozen=True)
class DrawnFigure:
    """A drawing on disk as the report shows it; its PDF lies beside the PNG at `path`."""

    path: Path
    caption: str
    section: Section = Section.figures
