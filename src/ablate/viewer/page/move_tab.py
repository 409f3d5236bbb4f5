"""Moving the probe: presets, sliders, keys, and by hand in 3-D."""

from functools import partial
from typing import Any

import numpy as np

from ablate.viewer.page.controls import add_slider
from ablate.viewer.page.page import Page

_PLACE = "a plane ..."
_LOOKS = ("plane", "body")
#: Key, what it does, and the step of the hold, mm or degrees.
KEYS = (
    ("I", "towards the head", {"height_mm": 4.0}),
    ("K", "towards the feet", {"height_mm": -4.0}),
    ("J", "around the body, to the left on the page", {"angle_deg": -3.0}),
    ("L", "around the body, to the right on the page", {"angle_deg": 3.0}),
    ("U", "turn anticlockwise", {"roll_deg": -5.0}),
    ("O", "turn clockwise", {"roll_deg": 5.0}),
    ("Y", "rock to the left", {"rock_deg": -3.0}),
    ("H", "rock to the right", {"rock_deg": 3.0}),
    ("T", "tilt up", {"tilt_deg": -3.0}),
    ("G", "tilt down", {"tilt_deg": 3.0}),
)


def add_move_tab(page: Page) -> None:
    """Presets, and a slider for each degree of freedom."""
    session, gui = page.session, page.server.gui
    chosen = gui.add_dropdown("Plane", (_PLACE, *session.presets), initial_value=_PLACE, hint="goes there at once")

    def here() -> str:
        at = (name for name, pose in session.presets.items() if np.array_equal(pose, session.state.pose))
        return next(at, _PLACE)

    def go(_: Any) -> None:
        if chosen.value in session.presets:
            session.to_preset(chosen.value)

    def refresh() -> None:
        chosen.value = here()

    chosen.on_update(page.does(go))
    page.refreshers.append(refresh)
    low, high = session.hand.heights_mm
    bounds = {
        "height_mm": ("Height (mm)", (round(low), round(high), 1.0), "along the body: keys I and K"),
        "angle_deg": ("Around (°)", (-180.0, 180.0, 1.0), "about the body's axis, from the front: keys J and L"),
        "roll_deg": ("Turn (°)", (-180.0, 180.0, 1.0), "0 is transverse, 90 sagittal: keys U and O"),
        "rock_deg": ("Rock (°)", (-60.0, 60.0, 1.0), "within the image plane: keys Y and H"),
        "tilt_deg": ("Tilt (°)", (-60.0, 60.0, 1.0), "out of the image plane: keys T and G"),
    }
    for name, (label, ends, hint) in bounds.items():
        _add_degree(page, name, label, ends, hint)
    look = gui.add_button_group("Look at", _LOOKS, hint="turns the 3-D view")
    look.on_click(page.does(lambda event: _look(page, event.client, look.value)))
    rings = gui.add_checkbox("Rings to turn the probe", initial_value=False)
    rings.on_update(page.does(lambda _: _show_rings(page, rings.value)))
    page.body.rings.visible = False
    gui.add_html(_hints())


def add_keys(page: Page) -> None:
    """The keys of the probe, and those of the row above the tabs."""
    for key, words, step in KEYS:
        command = page.server.gui.add_command(f"Probe: {words}", hotkey=key)
        command.on_trigger(page.does(partial(_nudge, page, step)))
    for number, name in enumerate(list(page.session.presets)[:9], start=1):
        command = page.server.gui.add_command(f"Plane: {name}", hotkey=str(number))
        command.on_trigger(page.does(partial(_go, page, name)))


def add_hands(page: Page) -> None:
    """The probe is dragged over the skin, and turned by its rings."""
    session = page.session
    start: dict[str, float] = {}

    def grab(phase: str, point: np.ndarray) -> None:
        height, angle = session.hand.site_of(point)
        if phase == "start" or not start:
            start.update(
                height_mm=session.hold.height_mm - height,
                angle_deg=session.hold.angle_deg - angle,
            )
        session.move(height_mm=start["height_mm"] + height, angle_deg=_wrapped(start["angle_deg"] + angle))
        if phase == "end":
            start.clear()

    page.body.on_grab(page.tells(grab))
    page.body.on_turn(page.tells(session.turn_to))


def _nudge(page: Page, step: dict[str, float], _: Any) -> None:
    page.session.nudge(**step)


def _go(page: Page, name: str, _: Any) -> None:
    page.session.to_preset(name)


def _wrapped(angle_deg: float) -> float:
    return (angle_deg + 180) % 360 - 180


def _add_degree(page: Page, name: str, label: str, ends: tuple[float, float, float], hint: str) -> None:
    session = page.session
    add_slider(page, label, ends, lambda: getattr(session.hold, name), lambda v: session.move(**{name: v}), hint)


def _look(page: Page, client: Any, what: str) -> None:
    if what == _LOOKS[0]:
        page.body.face(client, page.session.state.pose)
    else:
        page.body.face_body(client)


def _show_rings(page: Page, visible: bool) -> None:
    page.body.rings.visible = visible


def _hints() -> str:
    style = "font-size:0.8em;color:#868e96;padding:0.3em 0.8em;line-height:1.5"
    keys = (
        "<b>By hand:</b> drag the probe over the skin; drag elsewhere to turn the body, wheel to come closer.<br>"
        "<b>Keys:</b> I K up and down, J L around, U O turn, Y H rock, T G tilt, F freeze, N new speckle, "
        "R reset, 1 to 9 planes."
    )
    return f'<div style="{style}">{keys}</div>'
