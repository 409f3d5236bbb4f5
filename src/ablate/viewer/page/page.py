"""The page as a whole: what the browsers send goes to the session, what the worker renders goes to the browsers."""

import math
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from ablate.analysis.figures.scene_parts import tissue_colours
from ablate.anatomy import Scene
from ablate.settings.study import StudySettings
from ablate.viewer.page.body import Body
from ablate.viewer.pictures import empty_picture
from ablate.viewer.records import CineLoop, Sweep
from ablate.viewer.screen import Layout, screen
from ablate.viewer.session import FROZEN, Quality, Session, Views
from ablate.viewer.words import BAD, GOOD, caption, line

Bounds = tuple[float, float, float]
_FIRST = "The first picture is on its way:\nthe simulator is being compiled,\nwhich takes up to a minute."


class Page:
    """What all parts of the page share; it follows the session.

    `image_clicked` is called with a place in the picture of all images, as shares of its width and height, and whether
    Shift is held.

    Parameters
    ----------
    server : viser.ViserServer
        The server of the page.
    settings : StudySettings
        Those that the viewer was started with.
    scene : Scene
        The body.
    session : Session
        What the operator has set.
    """

    image_clicked: Callable[[tuple[float, float], bool], object]

    def __init__(self, server: Any, settings: StudySettings, scene: Scene, session: Session) -> None:
        self.server = server
        self.settings = settings
        self.scene = scene
        self.session = session
        self.folder = settings.results / "view"  # where frames and sweeps are kept
        self.colours = tissue_colours(scene.tissues)
        self.body = Body(server, scene, self.colours, session.hand.axis, session.hand.front)
        self.layout = Layout()
        self.loop = CineLoop()
        self.sweep: Sweep | None = None  # that is being recorded
        self.shown: Views | None = None  # the last frame, or one of the cine loop
        self.refreshers: list[Callable[[], object]] = []  # called when a setting has changed
        self.painters: list[Callable[[Views], object]] = []  # called with every frame that is shown
        self.lock = threading.RLock()  # held while a wish is met
        self._paper = threading.RLock()  # held while a frame is drawn
        self._pencil = ThreadPoolExecutor(1, "pencil")
        self._drawing = self._pencil.submit(lambda: None)
        self._hand = ThreadPoolExecutor(1, "hand")  # answers what browsers send, in the order in which it came
        self._waiting: tuple[object, Future[None]] | None = None  # of a slider, and what it may still wait for
        self._words = ""
        self.images = server.gui.add_panel()
        with self.images.add_tab("Images"):
            empty = empty_picture(_FIRST, session.state.simulator.image_shape, Quality.full)
            first = np.tile(np.asarray(empty), (2, 2, 1))
            self._screen = server.gui.add_image(first, format="jpeg", jpeg_quality=88)
            self._caption = server.gui.add_html("")
            server.gui.add_html("<style>img {width: 100%}</style>")  # else a picture is no wider than its pixels
        self._status = server.gui.add_html("")
        session.listeners.append(self.refresh)

    def add_slider(
        self, label: str, bounds: Bounds, read: Callable[[], float], write: Callable[[float], object], hint: str = ""
    ) -> None:
        """Add a slider.

        Parameters
        ----------
        label : str
            Its label.
        bounds : (float, float, float)
            Lowest and highest value and step; wider where its first value lies beyond, because a control shows what is
            so. Of whole numbers they are integers.
        read : callable
            Gives the value that it shows.
        write : callable
            Called with the new value when it is moved.
        hint : str
            Shown beside it; empty for none.
        """
        lowest, highest, step = bounds
        lowest = min(lowest, math.floor(read()))
        highest = max(highest, math.ceil(read()))
        is_whole = all(isinstance(value, int) for value in bounds)
        digits = None if is_whole else len(f"{step:g}".partition(".")[2])

        def shown() -> float:
            return round(min(max(read(), lowest), highest), digits)

        slider = self.server.gui.add_slider(label, lowest, highest, step, shown(), hint=hint or None)
        # The 8 of a typed 80 may be out of range and is not meant; when the box is left, the browser clamps its number.
        move = self.does(lambda value: lowest <= value <= highest and write(round(value, digits)), streams=True)
        slider.on_update(move)
        self.keep_equal(slider, shown)

    def add_button(self, label: str, work: Callable[[], object]) -> None:
        """Add a button that does some work."""
        self.server.gui.add_button(label).on_click(self.in_turn(lambda _: work()))

    def add_key(self, key: str, words: str, work: Callable[[], object]) -> None:
        """Add a key that does some work."""
        self.server.gui.add_command(words, hotkey=key).on_trigger(self.in_turn(lambda _: work()))

    def keep_equal(self, control: Any, read: Callable[[], object]) -> None:
        """Have a control show what `read` gives."""
        self.refreshers.append(lambda: setattr(control, "value", read()))

    def does(self, work: Callable[[Any], object], streams: bool = False) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """Make a callback for changes of a control, which gives its new value to `work`, as `in_turn` does.

        The value is read when it arrives, because the answer to an earlier change sets all controls to the state before
        it. Of a control that `streams` values, one that still waits gives way to the next. Changes that the program
        makes itself call it too, and are left out.
        """
        answer = self.tells(work)

        async def take(event: Any) -> None:  # async, so that the thread that received the value calls it at once
            if event.client is not None:
                if self._waiting is not None and self._waiting[0] is answer and streams:
                    self._waiting[1].cancel()
                self._waiting = answer, self._hand.submit(answer, event.target.value)

        return take

    def in_turn(self, work: Callable[..., object]) -> Callable[..., None]:
        """Do the same work after all that was asked for before, in a thread that may take its time, as in `tells`."""
        answer = self.tells(work)

        def ask(*arguments: Any) -> None:
            self._waiting = answer, self._hand.submit(answer, *arguments)

        return ask

    def tells(self, work: Callable[..., object]) -> Callable[..., None]:
        """Do the same work, one at a time; what goes wrong is shown in a sentence and not raised."""

        def answer(*arguments: Any) -> None:
            with self.lock:
                try:
                    self.say("")
                    work(*arguments)
                except Exception as error:  # the viewer lives on, whatever it is
                    self.fail(error)
                    self.refresh()

        return answer

    def say(self, words: str) -> None:
        """Show some words in the status; empty words take back the last ones."""
        self._words = " ".join(words.split())
        self._write_status()

    def fail(self, error: Exception) -> None:
        """Show why a state could not be rendered, or why a wish could not be met."""
        self.say(str(error) or type(error).__name__)

    def refresh(self) -> None:
        """Bring the probe and all controls to the state of the session."""
        self.body.hold(self.session.state)
        for refresher in self.refreshers:
            refresher()
        self._write_status()

    def show(self, views: Views) -> None:
        """Keep a frame that the worker rendered, and have it drawn while the worker renders the next one.

        While the operator looks back in the cine loop, the frame that he looks at stays.
        """
        looks_back = self.session.frozen and bool(self.loop) and self.shown is not self.loop[-1]
        self.loop.add(views)
        if (sweep := self.sweep) is not None:  # it is switched off by another thread
            sweep.add(views)
        if looks_back:
            return
        self.shown = views

        def draw() -> None:
            try:
                self.paint(views)
            except Exception as error:  # as for what the worker itself cannot do
                self.fail(error)

        self._drawing.result()  # of two frames none is left out, so the last one is drawn last
        self._drawing = self._pencil.submit(draw)

    def close(self) -> None:
        """End the threads that answer and draw, after what they do now."""
        self._hand.shutdown(cancel_futures=True)
        self._pencil.shutdown()

    @property
    def drawn(self) -> bool:
        """Whether all that was shown has been drawn."""
        return self._drawing.done()

    def paint(self, views: Views) -> None:
        """Draw a frame, a new one or one of the cine loop."""
        with self._paper:
            picture = screen(views, self.colours, self.layout)
            with self.server.atomic():
                self._screen.image = picture
                self._caption.content = caption(views, self.scene, self.colours)
            self.body.show(views)
            for painter in self.painters:
                painter(views)

    def lay_out(self, **changes: Any) -> None:
        """Change the layout of the images, and draw the last frame again."""
        self.layout = replace(self.layout, **changes)
        if self.shown is not None:
            self.paint(self.shown)

    def _write_status(self) -> None:
        contact = self.session.words
        lines = [line(contact, BAD) if contact else line("the probe lies on the skin", GOOD)]
        if self.session.frozen:
            lines.append(line(FROZEN, BAD))
        if self._words:
            lines.append(line(self._words, BAD))
        self._status.content = "".join(lines)
