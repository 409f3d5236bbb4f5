"""The tab View: which images are shown, how large and which way round, and what is measured on them."""

from dataclasses import replace
from typing import Any

import numpy as np

from ablate.viewer.calipers import MOST_POINTS, in_plane, measured, on_plane
from ablate.viewer.fetal_age import Biometry, dated
from ablate.viewer.page.page import Page
from ablate.viewer.pictures import Sides, label_at, place_of
from ablate.viewer.screen import Shown, point_at
from ablate.viewer.session import Views
from ablate.viewer.words import in_markdown

_INVITES = "**Measure:** click an image, or the fan in 3-D: tissue, distance, angle, and with four clicks an ellipse."
_NOTHING = "-"
_MOST_ZOOM = 4.0


def add_view_tab(page: Page) -> None:
    """Add what images are shown and how, and the calipers."""
    gui = page.server.gui

    def look(**changes: Any) -> None:
        page.lay_out(window=replace(page.layout.window, **changes))

    shown = gui.add_dropdown("Show", tuple(map(str, Shown)), hint="one image is larger than four")
    shown.on_update(page.does(lambda name: page.lay_out(shown=Shown(name))))
    hint = "Shift and a click on an image bring that place to its middle"
    page.add_slider("Zoom", (1.0, _MOST_ZOOM, 0.5), lambda: page.layout.window.zoom, lambda zoom: look(zoom=zoom), hint)
    sides = gui.add_dropdown("Sides", tuple(map(str, Sides)), hint="of the images; the green dot is the probe's mark")
    sides.on_update(page.does(lambda name: look(sides=Sides(name))))
    _add_calipers(page)


def _add_calipers(page: Page) -> None:
    """Measure between clicks on the images, or on the fan in 3-D."""
    gui = page.server.gui
    measure = gui.add_dropdown("Fetus", (_NOTHING, *map(str, Biometry)), hint="weeks of gestation by Hadlock 1984")
    answer = gui.add_markdown(_INVITES)

    def add(point: np.ndarray, views: Views) -> None:
        """Add a point of the world, (3,) mm; a fifth one, and one on another plane, begins anew."""
        points = page.layout.points
        if len(points) == MOST_POINTS or not len(in_plane(points, views.state.pose)):
            points = np.empty((0, 3))
        page.lay_out(points=np.vstack([points, point]))

    def click_fan(origin: np.ndarray, direction: np.ndarray) -> None:
        if (views := page.shown) is not None:
            held = page.session.state.pose  # there the fan is drawn, also with a frozen frame of another place
            point = views.state.pose @ np.linalg.inv(held) @ (*on_plane(held, origin, direction), 1)
            add(point[:3], views)

    def click_image(place: tuple[float, float], shift: bool) -> None:
        views = page.shown
        point = None if views is None else point_at(views, page.layout, place)
        if views is None or point is None:
            return
        if shift:
            x, y = place_of(point, views.state.probe).tolist()
            page.lay_out(window=replace(page.layout.window, middle=(x, y)))
        else:
            add((views.state.pose @ (point[0], 0.0, point[1], 1.0))[:3], views)

    def clear() -> None:
        answer.content = _INVITES
        page.lay_out(points=np.empty((0, 3)))

    def follow(views: Views) -> None:
        points = in_plane(page.layout.points, views.state.pose)
        if len(points):
            label = label_at(views.segmentation, points[-1], views.state.probe)
            tissue = page.scene.tissues[label - 1].name.replace("_", " ") if label else "outside the fan"
            words = measured(points, in_markdown(tissue), views.state.probe)
            answer.content = words + ("" if measure.value == _NOTHING else dated(Biometry(measure.value), points))
        elif len(page.layout.points):
            answer.content = "The points are not on this plane."

    measure.on_update(page.does(lambda _: page.lay_out()))
    page.painters.append(follow)
    page.body.clicked = page.in_turn(click_fan)
    page.image_clicked = click_image
    page.add_button("Clear the points", clear)
