"""What viser's page has no call for, as a script in it: keys after a click, clicks on the images, the window's width.

viser puts HTML into the page as it is, and a browser runs the handler of an image that cannot be loaded. The script
answers through a text box that is not drawn, as if somebody typed into it: all of it is viser's public interface.
"""

import json
from collections.abc import Callable
from html import escape
from typing import Any

_BOX = "page:"  # what the text in the box begins with, by which script and style find it
_STYLE = f"<style>div:has(> div > div > div > div > input[value^='{_BOX}']) {{display: none}}</style>"
_SCRIPT = """
if (!window.ablate) {
  window.ablate = true;
  const tell = (what) => {
    const box = document.querySelector("input[value^='page:']");
    if (!box) return setTimeout(() => tell(what), 200);
    const text = "page:" + JSON.stringify({...what, at: Date.now()});
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set.call(box, text);
    box.dispatchEvent(new Event("input", {bubbles: true}));
  };
  // A box that has been ticked, and a list that has been chosen from, give the keys back to the probe.
  document.addEventListener("click", (event) => {
    const chosen = event.target.closest("[role=option]");
    setTimeout(() => {
      const active = document.activeElement;
      if (active && (active.type === "checkbox" || chosen)) active.blur();
    }, 50);
    if (event.target.matches("img[src^='blob:']")) {
      const {left, top, width, height} = event.target.getBoundingClientRect();
      const place = [(event.clientX - left) / width, (event.clientY - top) / height];
      tell({place, shift: event.shiftKey});
    }
  });
  let waiting;
  const size = () => { clearTimeout(waiting); waiting = setTimeout(() => tell({width: innerWidth}), 300); };
  window.addEventListener("resize", size);
  size();
}
"""
_NARROW_PX = 1200
_BODY_PX = 130  # at least so wide is the view of the body


def widths(window_px: float) -> tuple[int, int]:
    """Widths of the controls and of the images in a window, px."""
    controls = 290 if window_px >= _NARROW_PX else 270
    return controls, round(max(240, min(0.52 * window_px, window_px - controls - _BODY_PX)))


def add_script(
    gui: Any,
    listens: Callable[[Callable[[str], object]], Callable[..., Any]],
    clicked: Callable[[tuple[float, float], bool], object],
    resized: Callable[[float], object],
) -> None:
    """Add the script to a page.

    Parameters
    ----------
    gui : viser.GuiApi
        Of the page.
    listens : callable
        Makes a callback of viser from what is done with the new text.
    clicked : callable
        Called with a place in the picture of all images, as shares of its width and height, and whether Shift is held.
    resized : callable
        Called with the width of the window, px.
    """

    def hear(text: str) -> None:
        message = json.loads(text.removeprefix(_BOX) or "{}")
        if "place" in message:
            x, y = map(float, message["place"])
            clicked((x, y), bool(message.get("shift")))
        if "width" in message:
            resized(float(message["width"]))

    gui.add_text("page", _BOX).on_update(listens(hear))
    gui.add_html(f'{_STYLE}<img alt="" style="display: none" src="data:," onerror="{escape(_SCRIPT)}">')
