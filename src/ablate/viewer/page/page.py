"""The page as a whole: what the browsers send goes to the session, what the worker renders goes to the browsers."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ablate.analysis.figures.tissue_colours import tissue_colours
from ablate.anatomy import Scene
from ablate.settings.study import StudySettings
from ablate.viewer.page.body import Body
from ablate.viewer.page.caption import BAD, GOOD, caption, line
from ablate.viewer.page.screen import Layout, screen
from ablate.viewer.pictures import empty_picture
from ablate.viewer.records import CineLoop, Shown, Sweep
from ablate.viewer.session import FROZEN, Session
from ablate.viewer.state import State, Views
from ablate.viewer.worker import Worker

_JPEG_QUALITY = 88
IMAGES_PX = 640  # width of the images in a window of 1366 px
_BODY_PX, _MOST_SPARE_PX = 430, 400
_PLACING_S = 30.0
_FIRST = "The first picture is on its way:\nthe simulator is being compiled,\nwhich takes up to a minute."


@dataclass(eq=False)
class Page:
    """What all parts of the page share.

    `refreshers` are called when what is set has changed, `painters` with every frame that is shown.
    """

    server: Any
    settings: StudySettings
    scene: Scene
    session: Session
    worker: Worker[State, Views]
    body: Body
    layout: Layout = Layout()
    loop: CineLoop = field(default_factory=CineLoop)
    sweep: Sweep | None = None
    shown: Shown | None = None
    refreshers: list[Callable[[], object]] = field(default_factory=list)
    painters: list[Callable[[State, Views], object]] = field(default_factory=list)
    lock: threading.RLock = field(default_factory=threading.RLock)
    _words: str = ""
    _fitted: bool = False
    _images_px: float = IMAGES_PX

    def __post_init__(self) -> None:
        self.colours = tissue_colours(self.scene.tissues)
        self._paper = threading.RLock()
        self._pencil = ThreadPoolExecutor(1, "pencil")
        self._drawing = self._pencil.submit(lambda: None)
        self.session.listeners.append(self.refresh)

    @property
    def folder(self) -> Path:
        """Where frames and sweeps are kept."""
        return self.settings.results / "view"

    def add_screen(self) -> None:
        """The place of all images, in a window of its own."""
        self.images = self.server.gui.add_panel()
        with self.images.add_tab("Images"):
            shape = self.session.state.simulator.image_shape
            first = np.tile(empty_picture(_FIRST, shape), (2, 2, 1))
            self._screen = self.server.gui.add_image(first, format="jpeg", jpeg_quality=_JPEG_QUALITY)
            self._caption = self.server.gui.add_html("")

    def fit(self, client: Any) -> None:
        """Share the first window among body and images while the browser places the panels, and then leave it alone."""
        if not self._fitted:
            self._fitted, end = True, time.monotonic() + _PLACING_S

            def share(camera: Any) -> None:
                if time.monotonic() < end:
                    self._share(camera.image_width)

            client.camera.on_update(share)

    def _share(self, body_px: float) -> None:
        """Make the images as wide as both have room for, where the body has so many px now."""
        spare = body_px + self._images_px - _BODY_PX - IMAGES_PX
        width = IMAGES_PX + min(max(0.6 * spare, 0.0), _MOST_SPARE_PX)
        if round(width) != round(self._images_px):
            self._images_px = width
            self.images.set_width(width)

    def add_status(self) -> None:
        """The place of words: how the probe lies, and what could not be done."""
        self._status = self.server.gui.add_html("")

    def say(self, words: str) -> None:
        """Tell something; empty words take back what was told."""
        self._words = " ".join(words.split())
        self._write_status()

    def does(self, work: Callable[[Any], object]) -> Callable[[Any], None]:
        """A callback for what a browser sends; what cannot be done is told in a sentence.

        Changes that the program makes itself are no wish of anybody, and are not answered.
        """

        told = self.tells(work)

        def answer(event: Any) -> None:
            if event.client is not None:
                told(event)

        return answer

    def tells(self, work: Callable[..., object]) -> Callable[..., None]:
        """The same work, one at a time, which tells in a sentence what goes wrong and does not raise."""

        def answer(*arguments: Any) -> None:
            with self.lock:
                try:
                    self.say("")
                    work(*arguments)
                except Exception as error:  # the viewer lives on, whatever it is
                    self.say(str(error) or type(error).__name__)
                    self.refresh()

        return answer

    def refresh(self) -> None:
        """Bring the probe and all controls to what is set."""
        self.body.hold(self.session.state)
        for refresher in self.refreshers:
            refresher()
        self._write_status()

    def show(self, state: State, views: Views) -> None:
        """Keep a frame that the worker rendered, and have it drawn while the worker renders the next one."""
        frame = self.shown = Shown(state, views, 0.0)
        self.loop.add(state, views)
        if self.sweep is not None:
            self.sweep.add(state, views)
        self._drawing.result()  # of two frames none is left out, so the last one is drawn last
        self._drawing = self._pencil.submit(self._draw, frame)

    def _draw(self, frame: Shown) -> None:
        try:
            self.paint(frame.state, frame.views)
        except Exception as error:  # as for what the worker itself cannot do
            self.fail(frame.state, error)

    def close(self) -> None:
        """Draw no more."""
        self._pencil.shutdown()

    @property
    def drawn(self) -> bool:
        """Whether all that was shown has been drawn."""
        return self._drawing.done()

    def paint(self, state: State, views: Views) -> None:
        """Draw a frame, a new one or one of the cine loop."""
        with self._paper:
            picture = screen(state, views, self.colours, self.layout)
            with self.server.atomic():
                self._screen.image = picture
                self._caption.content = caption(state, views, self.scene, self.colours)
            self.body.show(state, views)
            for painter in self.painters:
                painter(state, views)

    def repaint(self) -> None:
        """Draw the last frame again, in another layout."""
        if self.shown is not None:
            self.paint(self.shown.state, self.shown.views)

    def lay_out(self, **changes: Any) -> None:
        """Change the layout of the images."""
        self.layout = replace(self.layout, **changes)
        self.repaint()

    def layout_names(self, names: tuple[str, ...]) -> None:
        """Say what the generators of the next states are called."""
        self.layout = replace(self.layout, names=names)

    def fail(self, _: State, error: Exception) -> None:
        """Tell why a state could not be rendered."""
        self.say(str(error) or type(error).__name__)

    def _write_status(self) -> None:
        contact = self.session.words
        colour = BAD if contact else GOOD
        lines = [(colour, contact or "the probe lies on the skin")]
        if self.session.frozen:
            lines.append((BAD, FROZEN))
        if self._words:
            lines.append((BAD, self._words))
        content = "".join(line(words, colour) for colour, words in lines)
        if content != self._status.content:
            self._status.content = content
