"""A quiz: find this plane."""

from typing import Any

from ablate.viewer.page.controls import add_button
from ablate.viewer.page.page import Page
from ablate.viewer.quiz import Quiz

_RULES = (
    "Find a plane with the probe, then let it be judged. The score falls with the distance of the probe's face and "
    "with the angle to the plane; found is what is within 15 mm and 12 degrees."
)


def add_learn_tab(page: Page) -> None:
    """Ask, judge, show."""
    quiz, points = Quiz(page.session.presets), list[int]()
    said = page.server.gui.add_markdown(_RULES)

    def ask(_: Any) -> None:
        said.content = f"Find: **{quiz.ask()}**"

    def judge(_: Any) -> None:
        miss = quiz.judge(page.session.state.pose)
        points.append(miss.points)
        found = "found" if miss.found else "not yet"
        how = f"{miss.distance_mm:.0f} mm and {miss.angle_deg:.0f} degrees away"
        mean = sum(points) / len(points)
        said.content = (
            f"**{quiz.wanted}**: {found}, {how}: **{miss.points} of 100** points. Mean of {len(points)}: {mean:.0f}."
        )

    def show(_: Any) -> None:
        if quiz.wanted is None:
            raise ValueError("no plane has been asked for yet")
        page.session.to_preset(quiz.wanted)

    add_button(page, "Ask for a plane", ask)
    add_button(page, "Judge the probe", judge)
    add_button(page, "Show the plane", show)
