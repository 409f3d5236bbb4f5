"""The words under the images, and how words that a stranger may have chosen are put on the page."""

import re
from collections.abc import Sequence
from html import escape

import numpy as np

from ablate.analysis.figures.scene_parts import Colour
from ablate.anatomy import Scene
from ablate.viewer.session import Views

GOOD = "#2f9e44"
BAD = "#e8590c"
DIM = "#868e96"
_LEAST_SHARE = 0.002  # of the fan, or a tissue is not named


def caption(views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    """The lines under the images: pose and probe in words, reservations, and a legend of the tissues that are seen."""
    state = views.state
    words = []
    if state.hold is not None:
        words += [
            f"height {state.hold.height_mm:z.1f} mm",
            f"around {state.hold.angle_deg:z.1f}°",
            f"turn {state.hold.roll_deg:z.1f}°",
            f"rock {state.hold.rock_deg:z.1f}°",
            f"tilt {state.hold.tilt_deg:z.1f}°",
        ]
    words += [
        f"{state.probe.depth_mm:g} mm deep",
        f"{state.probe.frequency_mhz:g} MHz",
        f"speckle {state.seed}",
        views.quality.value,
    ]
    notes = [line(note, BAD) for note in dict.fromkeys(views.notes.values())]
    return "".join([line(" · ".join(words), DIM), *notes, _legend(views, scene, colours)])


def line(words: str, colour: str) -> str:
    """A line of HTML; the words are shown as they are."""
    style = f"color:{colour};font-size:0.85em;line-height:1.35;padding:0 0.8em 0.2em;overflow-wrap:anywhere"
    return f'<div style="{style}">{escape(words)}</div>'


def in_markdown(words: str) -> str:
    """Words as they are in Markdown, in which viser runs even scripts: a run or a tissue may be a stranger's."""
    return re.sub(r"[^\w\s.,:+-]", lambda sign: f"&#{ord(sign[0])};", " ".join(words.split()))


def _legend(views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    counts = np.bincount(views.segmentation.ravel(), minlength=len(scene.tissues) + 1)[1:]
    chips = []
    for index in np.argsort(-counts, kind="stable"):
        if counts[index] > _LEAST_SHARE * counts.sum():
            red, green, blue = (round(255 * c) for c in colours[index])
            look = f"background:rgb({red},{green},{blue});padding:0 0.5em;margin-right:0.3em;border-radius:2px"
            name = escape(scene.tissues[index].name.replace("_", " "))
            chips.append(f'<span style="white-space:nowrap;margin-right:1em"><span style="{look}"></span>{name}</span>')
    return f'<div style="font-size:0.8em;line-height:1.6;padding:0.2em 1em">{" ".join(chips)}</div>'
