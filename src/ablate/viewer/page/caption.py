"""The lines under the images: where they were taken, which tissues are in them, and what is to be known of them."""

from collections.abc import Sequence
from html import escape

import numpy as np

from ablate.analysis.figures.tissue_colours import Colour
from ablate.anatomy import Scene
from ablate.viewer.state import State, Views

GOOD, BAD, DIM = "#2f9e44", "#e8590c", "#868e96"
_LEAST_SHARE = 0.002  # of the fan, or a tissue is not named


def line(words: str, colour: str) -> str:
    """A line of HTML; the words are shown as they are."""
    style = f"color:{colour};font-size:0.85em;line-height:1.35;padding:0 0.8em 0.2em;overflow-wrap:anywhere"
    return f'<div style="{style}">{escape(words)}</div>'


def caption(state: State, views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    """Pose and probe in words, a legend of the tissues of the segmentation, and reservations."""
    words = [f"{state.probe.depth_mm:g} mm deep", f"{state.probe.frequency_mhz:g} MHz", f"speckle {state.seed}"]
    if (hold := state.hold) is not None:
        place = [f"height {hold.height_mm:.1f} mm", f"around {hold.angle_deg:.1f}°", f"turn {hold.roll_deg:.1f}°"]
        words = [*place, f"rock {hold.rock_deg:.1f}°", f"tilt {hold.tilt_deg:.1f}°", *words]
    notes = "".join(line(note, BAD) for note in dict.fromkeys(views.notes.values()))
    return line(" · ".join([*words, views.quality.value]), DIM) + notes + _legend(views, scene, colours)


def _legend(views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    counts = np.bincount(views.segmentation.ravel(), minlength=len(scene.tissues) + 1)[1:]
    chips = []
    for index in np.argsort(-counts, kind="stable"):
        if counts[index] > _LEAST_SHARE * counts.sum():
            red, green, blue = (round(255 * c) for c in colours[index])
            box = f'<span style="background:rgb({red},{green},{blue});padding:0 0.5em;border-radius:2px"></span>'
            name = escape(scene.tissues[index].name.replace("_", " "))
            chips.append(f'<span style="white-space:nowrap;margin-right:0.9em">{box} {name}</span>')
    return f'<div style="font-size:0.8em;line-height:1.6;padding:0.2em 1em">{" ".join(chips)}</div>'
