"""What the operator does: the row above the tabs, the tabs Move and Scan, the keys, and the probe by hand."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ablate.command.compose import job_of
from ablate.settings.conf import conf_folder
from ablate.ultrasound import Display, PhasedProbe
from ablate.viewer.page.page import Bounds, Page
from ablate.viewer.session import MOST_TURNED_DEG, Moving, Quality, Views
from ablate.viewer.words import DIM, line

Change = Callable[..., object]
_PLACE = "a plane ..."
#: Keys of the probe, what each does, and its step of the hold, mm or degrees.
_KEYS = (
    ("I", "towards the head", {"height_mm": 4.0}),
    ("K", "towards the feet", {"height_mm": -4.0}),
    ("J", "around the body, to the left on the page", {"angle_deg": -3.0}),
    ("L", "around the body, to the right on the page", {"angle_deg": 3.0}),
    ("U", "turn anticlockwise", {"roll_deg": -5.0}),
    ("O", "turn clockwise", {"roll_deg": 5.0}),
    ("Y", "rock the beam to the left", {"rock_deg": -3.0}),
    ("H", "rock the beam to the right", {"rock_deg": 3.0}),
    ("T", "tilt the beam down", {"tilt_deg": -3.0}),
    ("G", "tilt the beam up", {"tilt_deg": 3.0}),
)
_HINTS = (
    '<div style="font-size:0.8em;color:#868e96;padding:0.3em 0.8em;line-height:1.5">'
    "<b>By hand:</b> drag the probe over the skin; drag elsewhere to turn the body, wheel to come closer.<br>"
    "<b>Keys:</b> I K up and down, J L around, U O turn, Y H rock, T G tilt, F freeze, N new speckle, "
    "R reset, 1 to 9 planes.</div>"
)
_TGC_SLIDERS = 5
_ANGLES = (1, 3, 5, 7)
_FIRST_PROBE = "as started"


def add_row(page: Page) -> None:
    """Add what is at hand whatever tab is open: freeze, new speckle, reset; also by keys."""
    session, gui = page.session, page.server.gui
    frozen = gui.add_checkbox("Freeze (F)", initial_value=False, hint="holds the picture; the probe moves on")
    frozen.on_update(page.does(session.freeze))
    page.keep_equal(frozen, lambda: session.frozen)
    actions = {"Speckle": session.new_speckle, "Reset": session.reset}
    group = gui.add_button_group("New (N, R)", tuple(actions), hint="other scatterers; settings as at first")
    group.on_click(page.does(lambda name: actions[name]()))
    page.add_key("F", "Freeze, or let the picture move", lambda: session.freeze(not session.frozen))
    page.add_key("N", "New speckle", session.new_speckle)
    page.add_key("R", "Reset", session.reset)


def add_move_tab(page: Page) -> None:
    """Add presets, a slider for each degree of freedom, and views of the body."""
    session, gui = page.session, page.server.gui
    planes = gui.add_dropdown("Plane", (_PLACE, *session.presets), initial_value=_PLACE, hint="goes there at once")

    def go(name: str) -> None:
        if name in session.presets:
            session.to_preset(name)

    def held() -> str:
        names = (name for name, pose in session.presets.items() if np.array_equal(pose, session.state.pose))
        return next(names, _PLACE)

    planes.on_update(page.does(go))
    page.keep_equal(planes, held)

    low, high = session.hand.heights_mm
    for name, label, lowest, highest, hint in (
        ("height_mm", "Height (mm)", round(low), round(high), "along the body: keys I and K"),
        ("angle_deg", "Around (°)", -180, 180, "about the body's axis, from the front: keys J and L"),
        ("roll_deg", "Turn (°)", -180, 180, "0 is transverse, 90 sagittal: keys U and O"),
        ("rock_deg", "Rock (°)", -MOST_TURNED_DEG, MOST_TURNED_DEG, "within the image plane: keys Y and H"),
        ("tilt_deg", "Tilt (°)", -MOST_TURNED_DEG, MOST_TURNED_DEG, "out of the image plane: keys T and G"),
    ):
        _add_slider(page, label, (lowest, highest, 1.0), name, lambda: session.hold, session.move, hint)
    views = {"plane": lambda client: page.body.face(client, session.state), "body": page.body.face_body}
    look_at = gui.add_button_group("Look at", tuple(views), hint="turns the 3-D view")
    look_at.on_click(page.tells(lambda event: views[event.target.value](event.client)))
    with gui.add_folder("See through (1 is opaque, 0 hidden)", expand_by_default=False):
        for name in page.body.tissues:
            label = name.replace("_", " ")
            page.add_slider(
                label, (0.0, 1.0, 0.1), partial(page.body.opacity_of, name), partial(page.body.see_through, name)
            )
    gui.add_html(_HINTS)


def _add_slider(
    page: Page, label: str, bounds: Bounds, name: str, holder: Callable[[], object], change: Change, hint: str = ""
) -> None:
    """Add a slider of an attribute of what `holder` gives; `change` takes the new value by the attribute's name."""
    page.add_slider(label, bounds, lambda: getattr(holder(), name), lambda value: change(**{name: value}), hint)


def add_hands(page: Page) -> None:
    """Let the probe be moved by keys and dragged over the skin."""
    session = page.session
    for key, words, step in _KEYS:
        page.add_key(key, f"Probe: {words}", partial(session.nudge, **step))
    for number, name in enumerate(list(session.presets)[:9], start=1):
        page.add_key(str(number), f"Plane: {name}", partial(session.to_preset, name))
    offset: dict[str, float] = {}  # from the point that was grabbed to the hold of the probe

    def grab(phase: str, point: np.ndarray) -> None:
        height_mm, angle_deg = session.hand.site_of(point)
        if phase == "start" or not offset:
            offset["height_mm"] = session.hold.height_mm - height_mm
            offset["angle_deg"] = session.hold.angle_deg - angle_deg
        session.move(height_mm=offset["height_mm"] + height_mm, angle_deg=offset["angle_deg"] + angle_deg)
        if phase == "end":
            offset.clear()

    page.body.grabbed = page.in_turn(grab)


def _add_probes(page: Page) -> None:
    """Add a list of probes, each with the pulse and the depth of its own file."""
    session, settings = page.session, page.settings
    first = session.start
    names = sorted(path.stem for path in (conf_folder() / "probe").glob("*.yaml"))
    taken = page.server.gui.add_dropdown(
        "Probe", (_FIRST_PROBE, *names), hint="another one is pressed on the skin in its place"
    )

    def take(name: str) -> None:
        if name == _FIRST_PROBE:
            session.take(first.probe, first.simulator, settings.dataset.press_mm)
        else:
            composed = job_of([f"preset={settings.preset}", f"probe={name}", "task=describe"]).settings
            session.take(composed.probe, composed.simulator, composed.dataset.press_mm)

    taken.on_update(page.does(take))


def add_scan_tab(page: Page) -> None:
    """Add sliders of the probe, of the simulator and of the picture."""
    session, gui = page.session, page.server.gui

    def display() -> Display:
        return session.state.display or Display()

    def show(**changes: Any) -> None:
        session.show(display=replace(display(), **changes))

    def levels() -> tuple[float, ...]:
        return display().tgc_db or (0.0,) * _TGC_SLIDERS

    def level(number: int) -> float:
        return levels()[number]

    def set_level(number: int, level: float) -> None:
        show(tgc_db=(*levels()[:number], level, *levels()[number + 1 :]))

    def dynamic_range_db() -> float:
        return display().dynamic_range_db or session.state.simulator.dynamic_range_db

    _add_probes(page)
    _add_slider(page, "Depth (mm)", (40, 240, 5), "depth_mm", lambda: session.state.probe, session.scan)
    _add_slider(page, "Frequency (MHz)", (1.0, 12.0, 0.5), "frequency_mhz", lambda: session.state.probe, session.scan)
    _add_slider(page, "Rays", (1, 64, 1), "rays", lambda: session.state.simulator, session.simulate)
    if not isinstance(session.state.probe, PhasedProbe):
        _add_compounding(page)
    _add_slider(page, "Gain (dB)", (-30.0, 30.0, 1.0), "gain_db", display, show)
    page.add_slider("Dynamic range (dB)", (20.0, 100.0, 5.0), dynamic_range_db, lambda db: show(dynamic_range_db=db))
    with gui.add_folder("Time gain (dB), by depth", expand_by_default=False):
        for number in range(_TGC_SLIDERS):
            label = f"at {round(100 * number / (_TGC_SLIDERS - 1))} %"
            page.add_slider(label, (-20.0, 20.0, 1.0), partial(level, number), partial(set_level, number))
    moving = gui.add_dropdown("Moving", tuple(map(str, Moving)), hint="what is rendered while the probe moves")
    moving.on_update(page.does(lambda mode: session.show(moving=Moving(mode))))
    page.keep_equal(moving, lambda: str(session.state.moving))


def _add_compounding(page: Page) -> None:
    """Add a choice of how many steered sets of scanlines a frame is averaged of, and what each costs."""
    session, gui = page.session, page.server.gui

    def angles() -> int:
        return session.state.simulator.compound_angles

    offered = sorted({*_ANGLES, angles()})
    hint = "steered directions that a frame at rest is averaged of; while the probe moves it is one"
    chosen = gui.add_dropdown("Compounding", tuple(map(str, offered)), initial_value=str(angles()), hint=hint)
    chosen.on_update(page.does(lambda count: session.simulate(compound_angles=int(count))))
    page.keep_equal(chosen, lambda: str(angles()))
    price = gui.add_html("")

    def paint(views: Views) -> None:
        if views.quality is Quality.full and "target" in views.ms:
            ms_of_one = views.ms["target"] / views.state.simulator.compound_angles
            words = (f"{count}: {'' if count == angles() else 'about '}{count * ms_of_one:.0f} ms" for count in offered)
            price.content = line(" · ".join(words), DIM)

    page.painters.append(paint)
