"""One worker with one slot: the latest state wins, and what is stale is dropped."""

import threading
import time
from collections.abc import Callable

from ablate.viewer.session import Quality, ViewerState, Views

#: A probe that has not moved for so long is at rest.
REST_S = 0.15


class Worker:
    """Computes views in a thread of its own.

    A new state is computed coarsely at once, and in full when no other has come for `rest_s` seconds. A state that is
    replaced before its turn is never computed, and views in full of a state that has been replaced are dropped. States
    may be submitted before it is started.
    """

    def __init__(self, compute: Callable[[ViewerState, Quality], Views], rest_s: float = REST_S) -> None:
        self._compute = compute
        self._rest_s = rest_s
        self._changed = threading.Condition()
        self._slot: ViewerState | None = None
        self._last: ViewerState | None = None
        self._asked = 0.0
        self.paused = False
        self._closed = False
        self._waits = False
        self.computed = dict.fromkeys(Quality, 0)
        self._thread = threading.Thread(target=self._run, name="viewer", daemon=True)

    def start(self, show: Callable[[Views], object], fail: Callable[[Exception], object]) -> None:
        """Start the thread, which calls `show` with the views of a state.

        It calls `fail` when computing or showing raises, and goes on with the next state.
        """
        self._show = show
        self._fail = fail
        self._thread.start()

    def submit(self, state: ViewerState) -> None:
        """Ask for the views of a state in place of the one that waits."""
        with self._changed:
            self._slot = self._last = state
            self._asked = time.monotonic()
            self._changed.notify_all()

    def pause(self) -> None:
        """Compute nothing until `resume`, whatever is submitted."""
        with self._changed:
            self.paused = True

    def resume(self) -> None:
        """Go on, with the last state that was submitted."""
        with self._changed:
            self.paused = False
            self._slot = self._last
            self._changed.notify_all()

    @property
    def idle(self) -> bool:
        """Whether nothing is computed, and nothing is to be."""
        with self._changed:
            return self._waits and (self._slot is None or self.paused)

    def close(self) -> None:
        """End the thread, after what it computes now."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        state = self._next()
        while state is not None:
            if self._render(state, Quality.coarse) and self._rests():
                self._render(state, Quality.full)
            state = self._next()

    def _next(self) -> ViewerState | None:
        """Wait for a state and take it; None when closed."""
        with self._changed:
            self._waits = True
            self._changed.wait_for(lambda: self._closed or (self._slot is not None and not self.paused))
            self._waits = False
            state, self._slot = self._slot, None
            return None if self._closed else state

    def _rests(self) -> bool:
        """Wait until the state has rested; False when another has come, or nothing is to be computed."""
        with self._changed:
            left = self._asked + self._rest_s - time.monotonic()
            return not self._changed.wait_for(self._interrupted, max(left, 0.0)) and not self.paused

    def _interrupted(self) -> bool:
        return self._closed or self._slot is not None

    def _render(self, state: ViewerState, quality: Quality) -> bool:
        """Compute and show; whether it could be done."""
        try:
            views = self._compute(state, quality)
            self.computed[quality] += 1
            if quality is Quality.coarse or not self._interrupted():
                self._show(views)
        except Exception as error:
            self._fail(error)
            return False
        return True
