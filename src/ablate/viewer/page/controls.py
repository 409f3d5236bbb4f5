"""Sliders that cannot be set beyond their ends, whatever a browser sends."""

import math
from collections.abc import Callable
from typing import Any

from ablate.viewer.page.page import Page


def add_slider(
    page: Page,
    label: str,
    bounds: tuple[float, float, float],
    read: Callable[[], float],
    write: Callable[[float], object],
    hint: str | None = None,
) -> Any:
    """A slider with bounds (lowest, highest, step) that shows what `read` gives and calls `write` when it is moved."""
    lowest, highest, step = bounds
    whole = all(isinstance(value, int) for value in bounds)

    def shown() -> float:
        value = min(max(read(), lowest), highest)
        return round(value) if whole else round(value / step) * step  # as many digits as a step has

    slider = page.server.gui.add_slider(label, min=lowest, max=highest, step=step, initial_value=shown(), hint=hint)

    def moved(_: Any) -> None:
        value = slider.value
        if not math.isfinite(value) or not lowest - step <= value <= highest + step:
            raise ValueError(f"{label}: allowed are {lowest:g} to {highest:g}, not {value:g}")
        write(min(max(value, lowest), highest))

    def refresh() -> None:
        slider.value = shown()

    slider.on_update(page.does(moved))
    page.refreshers.append(refresh)
    return slider


def add_button(page: Page, label: str, work: Callable[[Any], object], hint: str | None = None, icon: Any = None) -> Any:
    """A button that calls `work` with the event."""
    button = page.server.gui.add_button(label, hint=hint, icon=icon)
    button.on_click(page.does(work))
    return button
