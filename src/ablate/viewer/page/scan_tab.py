"""The scanner's controls: depth, frequency, gain, dynamic range, time gain, rays, and what is frozen."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from ablate.ultrasound import Display
from ablate.viewer.page.controls import add_button, add_slider
from ablate.viewer.page.page import Page
from ablate.viewer.state import Moving

_TGC_SLIDERS = 5
_MOVING = {"simulator and generator": Moving.both, "generator alone": Moving.alone}


def add_scan_row(page: Page) -> None:
    """What is at hand whatever tab is open: freeze, new speckle, reset; also by keys."""
    session, gui = page.session, page.server.gui
    frozen = gui.add_checkbox("Freeze (F)", initial_value=False, hint="holds the picture; the probe moves on")
    frozen.on_update(page.does(lambda _: session.freeze(frozen.value)))

    def refresh() -> None:
        frozen.value = session.frozen

    page.refreshers.append(refresh)
    actions = {"Speckle": session.new_speckle, "Reset": session.reset}
    group = gui.add_button_group("New (N, R)", tuple(actions), hint="other scatterers; everything as at first")
    group.on_click(page.does(lambda _: actions[group.value]()))
    toggle = gui.add_command("Freeze, or let the picture move", hotkey="F")
    toggle.on_trigger(page.does(lambda _: session.freeze(not session.frozen)))
    for key, words, work in (("N", "New speckle", session.new_speckle), ("R", "Reset", session.reset)):
        gui.add_command(words, hotkey=key).on_trigger(page.does(partial(_do, work)))


def add_scan_tab(page: Page) -> None:
    """Sliders of the probe, of the simulator and of the picture."""
    session, gui = page.session, page.server.gui
    _add(page, "Depth (mm)", (40, 240, 5), lambda: session.state.probe.depth_mm, lambda v: session.scan(depth_mm=v))
    _add(
        page,
        "Frequency (MHz)",
        (1.0, 12.0, 0.5),
        lambda: session.state.probe.frequency_mhz,
        lambda v: session.scan(frequency_mhz=v),
    )
    _add(page, "Rays", (1, 64, 1), lambda: session.state.simulator.rays, lambda v: session.simulate(rays=round(v)))
    _add(page, "Gain (dB)", (-30.0, 30.0, 1.0), lambda: _display(page).gain_db, lambda v: _show(page, gain_db=v))
    _add(
        page,
        "Dynamic range (dB)",
        (20.0, 100.0, 5.0),
        lambda: _display(page).dynamic_range_db or session.state.simulator.dynamic_range_db,
        lambda v: _show(page, dynamic_range_db=v),
    )
    with gui.add_folder("Time gain (dB), by depth", expand_by_default=False):
        for number in range(_TGC_SLIDERS):
            _add_tgc(page, number)
    moving = gui.add_dropdown("Moving", tuple(_MOVING), hint="what is rendered while the probe moves")
    moving.on_update(page.does(lambda _: session.show(moving=_MOVING[moving.value])))
    add_button(page, "Scanner as at first", lambda _: _reset_scanner(page))


def _do(work: Callable[[], object], _: Any) -> None:
    work()


def _add(page: Page, label: str, ends: tuple[float, float, float], read: Any, write: Any) -> None:
    add_slider(page, label, ends, read, write)


def _add_tgc(page: Page, number: int) -> None:
    share = round(100 * number / (_TGC_SLIDERS - 1))

    def write(value: float) -> None:
        levels = list(_levels(page))
        levels[number] = value
        _show(page, tgc_db=tuple(levels))

    _add(page, f"at {share} %", (-20.0, 20.0, 1.0), lambda: _levels(page)[number], write)


def _display(page: Page) -> Display:
    return page.session.state.display or Display()


def _levels(page: Page) -> tuple[float, ...]:
    return _display(page).tgc_db or (0.0,) * _TGC_SLIDERS


def _show(page: Page, **changes: Any) -> None:
    page.session.show(display=replace(_display(page), **changes))


def _reset_scanner(page: Page) -> None:
    start = page.session.start
    page.session.scan(depth_mm=start.probe.depth_mm, frequency_mhz=start.probe.frequency_mhz)
    page.session.simulate(rays=start.simulator.rays)
    page.session.show(display=start.display)
