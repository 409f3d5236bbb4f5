"""The page from its parts: the controls on the left, the body in the middle, the images on the right."""

from pathlib import Path
from typing import Any

from ablate.analysis.figures.tissue_colours import tissue_colours
from ablate.anatomy import Scene
from ablate.settings.study import StudySettings
from ablate.viewer.page.body import Body
from ablate.viewer.page.compare_tab import add_compare_tab
from ablate.viewer.page.keep_tab import add_keep_tab
from ablate.viewer.page.learn_tab import add_learn_tab
from ablate.viewer.page.move_tab import add_hands, add_keys, add_move_tab
from ablate.viewer.page.page import IMAGES_PX, Page
from ablate.viewer.page.scan_tab import add_scan_row, add_scan_tab
from ablate.viewer.session import Session
from ablate.viewer.state import State, Views
from ablate.viewer.worker import Worker

_CONTROLS_PX = 290


def build_page(
    server: Any,
    settings: StudySettings,
    scene: Scene,
    session: Session,
    worker: Worker[State, Views],
    offered: dict[str, Path],
) -> Page:
    """Add everything to an empty page; it follows the session from then on."""
    gui = server.gui
    gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
    gui.set_panel_label(f"ablate: {settings.scene_name}")
    body = Body(server, scene, tissue_colours(scene.tissues), session.hand.axis, session.hand.front)
    page = Page(server, settings, scene, session, worker, body)
    page.add_screen()
    page.add_status()
    add_scan_row(page)
    tabs = gui.add_tab_group()
    with tabs.add_tab("Move"):
        add_move_tab(page)
    with tabs.add_tab("Scan"):
        add_scan_tab(page)
    with tabs.add_tab("Compare"):
        add_compare_tab(page, offered)
    with tabs.add_tab("Keep"):
        add_keep_tab(page)
    with tabs.add_tab("Learn"):
        add_learn_tab(page)
    add_keys(page)
    add_hands(page)
    gui.main_panel.dock_left()
    gui.main_panel.set_width(_CONTROLS_PX)
    page.images.dock_right()
    page.images.set_width(IMAGES_PX)
    page.refresh()
    return page
