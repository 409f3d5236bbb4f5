"""Generators beside the simulator: which ones, how far they are from it, and what lies under a click."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from ablate.metrics import patch_chi2, psnr, rms
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import point_polar
from ablate.viewer.generators import is_shipped, pickable
from ablate.viewer.page.controls import add_button
from ablate.viewer.page.page import Page
from ablate.viewer.pictures import label_at
from ablate.viewer.state import State, Views

_NONE = "none"
_MOST_POINTS = 2
_TRAINS = "No trained run yet. `make sweep` trains three, and `python -m ablate variant=sa2h` trains one."


def add_compare_tab(page: Page, offered: dict[str, Path]) -> None:
    """Two pickers, the difference, the numbers, and the point that was clicked on the fan."""
    session, gui = page.session, page.server.gui
    names = dict(offered)
    picked = [_name_of(names, path) for path in session.state.runs] + [_NONE, _NONE]
    pickers = [
        gui.add_dropdown(label, (_NONE, *names), initial_value=start)
        for label, start in zip(("Generator", "A second one"), picked, strict=False)
    ]

    def pick(_: Any) -> None:
        chosen = dict.fromkeys(p.value for p in pickers if p.value in names)
        page.layout_names(tuple(chosen))
        session.show(runs=tuple(names[name] for name in chosen))

    def look_again(_: Any) -> None:
        names.clear()
        names.update(find_generators(page))
        for picker in pickers:
            picker.options = (_NONE, *names)
        trained.content = "" if _has_runs(names) else _TRAINS

    for picker in pickers:
        picker.on_update(page.does(pick))
    add_button(page, "Look for new runs", look_again)
    trained = gui.add_markdown("" if _has_runs(names) else _TRAINS)
    difference = gui.add_checkbox("Difference to the simulated image", initial_value=False)
    difference.on_update(page.does(lambda _: page.lay_out(difference=difference.value)))
    numbers = gui.add_markdown("")

    def paint(state: State, views: Views) -> None:
        content = _numbers(page.layout.names, views)
        if numbers.content != content:
            numbers.content = content
        del state

    page.painters.append(paint)
    page.layout_names(tuple(name for name in picked if name != _NONE))
    _add_calipers(page)


def find_generators(page: Page) -> dict[str, Path]:
    """What can be picked now, by name."""
    runs = page.settings.runs
    return pickable(Path(runs) if runs else page.settings.results)


def _name_of(names: dict[str, Path], path: Path) -> str:
    return next((name for name, other in names.items() if other == path), _NONE)


def _has_runs(names: dict[str, Path]) -> bool:
    return any(not is_shipped(path) for path in names.values())


def _numbers(names: tuple[str, ...], views: Views) -> str:
    """Distances of the generated images to the simulated one, as a table."""
    if views.target is None:
        return ""
    lines = []
    for name, image in zip(names, views.generated, strict=False):
        if image is not None:
            near = psnr(views.target, image, mask=views.mask)
            chi2 = rms(patch_chi2(views.target, image))
            lines.append(f"| {name} | {near:.1f} | {chi2:.3f} |")
    if not lines:
        return ""
    return "\n".join(["| to the simulated image | PSNR (dB) | patch χ² |", "| --- | --- | --- |", *lines])


def _add_calipers(page: Page) -> None:
    said = page.server.gui.add_markdown(_INVITES)

    def click(origin: np.ndarray, direction: np.ndarray) -> None:
        shown = page.shown
        if shown is None:
            return
        point = on_plane(shown.state.pose, origin, direction)
        kept = page.layout.points if len(page.layout.points) < _MOST_POINTS else ()
        points = (*kept, point)
        said.content = " ".join(_told(page, shown.state, shown.views, points))
        page.lay_out(points=points)

    def clear(_: Any) -> None:
        said.content = _INVITES
        page.lay_out(points=())

    page.body.on_fan_click(page.tells(click))
    add_button(page, "Clear the points", clear)


_INVITES = "**Measure:** click the fan in the 3-D view for the tissue and its depth, and again for a distance."


def on_plane(pose: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[float, float]:
    """Where a line of sight meets the image plane, x and z of the probe, mm; a ValueError where it runs along it."""
    start, along = (origin - pose[:3, 3]) @ pose[:3, :3], direction @ pose[:3, :3]
    if abs(along[1]) < 1e-6:
        raise ValueError("the fan is seen edge on: turn the body, then click again")
    x, _, z = start - along * (start[1] / along[1])
    return float(x), float(z)


def depth_mm(point: tuple[float, float], probe: Probe) -> float:
    """How deep a point of the image plane is along its scanline, mm."""
    return float(point_polar(probe, np.asarray(point[0]), np.asarray(point[1]))[0])


def _told(page: Page, state: State, views: Views, points: tuple[tuple[float, float], ...]) -> list[str]:
    words = []
    for point in points:
        label = label_at(views.segmentation, point, state.probe)
        name = page.scene.tissues[label - 1].name.replace("_", " ") if label else "outside the fan"
        words.append(f"**{name}**, {depth_mm(point, state.probe):.0f} mm deep.")
    if len(points) == _MOST_POINTS:
        words.append(f"Between them **{math.dist(*points):.1f} mm**.")
    return words
