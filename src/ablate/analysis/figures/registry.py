"""Every figure of a study, found in the modules that declare them.

A new figure is one module beside this one with a function and its `StudyFigure`, and its text in `captions.jinja`.
"""

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from ablate.analysis import figures as package
from ablate.analysis.figures.study_figure import DrawnFigure, Section, StudyFigure
from ablate.analysis.results import StudyResults
from ablate.analysis.templates import caption


def study_figures() -> list[StudyFigure]:
    """The entries of all modules beside this one, in the order in which they are shown."""
    modules = [import_module(f"{package.__name__}.{module.name}") for module in iter_modules(package.__path__)]
    entries = [value for module in modules for value in vars(module).values() if isinstance(value, StudyFigure)]
    return sorted(entries, key=lambda figure: figure.place)


def draw_figures(results: StudyResults, folder: Path) -> list[DrawnFigure]:
    """Draw every figure for which there are numbers or pictures; its PNG and PDF are written into `folder`."""
    drawn = []
    for figure in study_figures():
        for drawing in figure.draw(results, folder):
            if not drawing.files:
                continue
            text = caption(figure.name, drawing.metrics, results.reference, results.resimulated, **drawing.facts)
            section = Section.folded if drawing.folded else figure.section
            drawn.append(DrawnFigure(path=drawing.files[0], caption=text, section=section))
    return drawn
