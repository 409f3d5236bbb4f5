"""The page in a real browser, drawn without a graphics card: `apt install chromium chromium-driver`."""

import base64
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from PIL import Image

_CHROMIUM, _DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if _CHROMIUM is None or _DRIVER is None:
    pytest.skip("needs a browser: apt install chromium chromium-driver", allow_module_level=True)
pytest.importorskip("viser", reason="needs the extra: pip install 'ablate-ultrasound[view]'")
webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium, of the extra `dev`")

from ablate.command.compose import jobs_of  # noqa: E402
from ablate.viewer.calipers import in_plane  # noqa: E402
from ablate.viewer.server import HOST  # noqa: E402
from ablate.viewer.session import Quality  # noqa: E402
from ablate.viewer.task import Viewer  # noqa: E402
from support import viewed_body  # noqa: E402

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")]
_FLAGS = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_SIZE = "--window-size=1366,768"
until = partial(viewed_body.until, within_s=240.0)


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Viewer]:
    words = ["task=view", "preset=tiny", "scene.triangles=20000", f"runs_dir={tmp_path_factory.mktemp('runs')}"]
    (job,) = jobs_of([*words, f"viewer.port={viewed_body.free_port()}"])
    made = Viewer(job.settings)
    yield made
    made.close()


@pytest.fixture(scope="module")
def browser(viewer: Viewer) -> Iterator[Any]:
    """A browser with the page open and its first picture shown."""
    options = webdriver.ChromeOptions()
    options.binary_location = _CHROMIUM
    options.page_load_strategy = "none"
    for flag in (*_FLAGS, _SIZE, "--disable-dev-shm-usage"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(_DRIVER))
    driver.get(_address(viewer))
    until(lambda: viewer.page.shown is not None and shown(driver) is not None)
    settle(viewer)
    yield driver
    driver.quit()


def _address(viewer: Viewer) -> str:
    return f"http://{HOST}:{viewer.page.settings.viewer.port}"


def settle(viewer: Viewer) -> None:
    """Wait until the probe has rested and its image is shown."""
    time.sleep(0.5)
    until(lambda: viewer.worker.idle and viewer.page.drawn)
    time.sleep(1.0)


def shown(driver: Any) -> str | None:
    """The address of the picture of all images, another one for each picture."""
    address: str | None = driver.execute_script(
        "const i = [...document.images].find(i => i.src.startsWith('blob:') && i.naturalWidth > 400);"
        "return i ? i.src : null"
    )
    return address


def press(driver: Any, key: str) -> None:
    code = f"Digit{key}" if key.isdigit() else f"Key{key.upper()}"
    script = "for (const t of ['keydown', 'keyup']) document.documentElement.dispatchEvent(new KeyboardEvent(t, {"
    driver.execute_script(script + "key: arguments[0], code: arguments[1], bubbles: true}))", key, code)


def screenshot(driver: Any) -> np.ndarray:
    """The page as it is drawn, (h, w, 3) uint8."""
    taken = driver.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})
    return np.array(Image.open(BytesIO(base64.b64decode(taken["data"]))).convert("RGB"))


def test_the_page_loads_without_errors_and_its_3d_view_is_not_blank(browser: Any) -> None:
    until(lambda: browser.execute_script("return document.querySelectorAll('canvas').length") >= 1)
    left, top, width, height = browser.execute_script(
        "const c = [...document.querySelectorAll('canvas')].map(c => c.getBoundingClientRect())"
        ".sort((a, b) => b.width * b.height - a.width * a.height)[0];"
        "return [c.left, c.top, c.width, c.height]"
    )
    until(lambda: np.ptp(_part(screenshot(browser), left, top, width, height)) > 100)
    errors = [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert [entry for entry in errors if "favicon" not in entry["message"]] == []


def _part(picture: np.ndarray, left: float, top: float, width: float, height: float) -> np.ndarray:
    """The middle of the lower half of a rectangle, which nothing lies over, as grey levels."""
    rows = slice(int(top + 0.55 * height), int(top + 0.9 * height))
    middle: np.ndarray = picture[rows, int(left + 0.4 * width) : int(left + 0.6 * width)].mean(axis=-1)
    return middle


def test_a_key_moves_the_probe_and_changes_the_image(browser: Any, viewer: Viewer) -> None:
    before, angle = shown(browser), viewer.session.hold.angle_deg
    press(browser, "l")
    until(lambda: viewer.session.hold.angle_deg == pytest.approx(angle + 3.0))
    until(lambda: shown(browser) not in (before, None))
    press(browser, str(list(viewer.session.presets).index("head") + 1))
    until(lambda: np.array_equal(viewer.session.state.pose, viewer.session.presets["head"]))


def test_keys_move_the_probe_after_a_box_was_ticked(browser: Any, viewer: Viewer) -> None:
    box = browser.find_element("xpath", "//label[contains(., 'Freeze')]/ancestor::*[.//input][1]//input")
    for frozen in (True, False):
        browser.execute_script("arguments[0].focus(); arguments[0].click()", box)
        until(lambda frozen=frozen: viewer.session.frozen is frozen)
        time.sleep(0.3)
        angle = viewer.session.hold.angle_deg
        browser.switch_to.active_element.send_keys("l")
        until(lambda angle=angle: viewer.session.hold.angle_deg == pytest.approx(angle + 3.0))
    settle(viewer)


def test_a_click_on_an_image_marks_the_place_that_was_clicked(browser: Any, viewer: Viewer) -> None:
    image = next(i for i in browser.find_elements("tag name", "img") if i.get_attribute("src").startswith("blob:"))
    webdriver.ActionChains(browser).move_to_element_with_offset(
        image, -image.size["width"] // 4, -image.size["height"] // 4
    ).click().perform()
    until(lambda: len(viewer.page.layout.points) == 1)
    x, z = in_plane(viewer.page.layout.points, viewer.session.state.pose)[0]
    assert abs(x) < 10, "the middle of the first of four images"
    assert 50 < z < 100
    viewer.page.lay_out(points=np.empty((0, 3)))


def test_every_box_shows_what_holds_after_typing(browser: Any, viewer: Viewer) -> None:
    """On the way to 80 stands an 8, which is below the least depth: the box once stayed at what that was made of."""
    boxes = "return [...document.querySelectorAll('input.mantine-NumberInput-input')].filter(i => i.offsetParent)"
    for tab, least in (("Scan", 5), ("Move", 5)):
        browser.find_element("xpath", f"//*[@role='tab'][normalize-space()='{tab}']").click()
        until(lambda least=least: len(browser.execute_script(boxes)) >= least)
        for box in browser.execute_script(boxes):
            typed = str(round(float(box.get_attribute("value"))) - 1)
            browser.execute_script("arguments[0].focus(); arguments[0].select()", box)
            for character in typed:
                box.send_keys(character)
                time.sleep(0.1)
            box.send_keys("\t")
            settle(viewer)
            viewer.page.refresh()  # shows what holds, where that is something else
            time.sleep(0.5)
            assert float(box.get_attribute("value")) == float(typed), tab


def test_pictures_fill_the_panel_and_stay_as_large_while_the_probe_moves(browser: Any, viewer: Viewer) -> None:
    page, width = viewer.page, "return [...document.images].find(i => i.src.startsWith('blob:')).clientWidth"
    browser.set_window_size(1920, 1080)
    until(lambda: browser.execute_script(width) > 900)  # of half of the window
    views, widths = page.shown, {}
    assert views is not None
    for quality in Quality:
        page.paint(replace(views, quality=quality))
        until(lambda: browser.execute_script("return [...document.images].every(i => i.complete)"))
        time.sleep(1.0)
        widths[quality] = browser.execute_script(width)
    browser.set_window_size(1366, 768)
    until(lambda: browser.execute_script(width) < 750)
    assert 900 < widths[Quality.full] == widths[Quality.coarse]


def test_a_second_tab_sees_the_same_probe_and_closing_frees_the_worker(browser: Any, viewer: Viewer) -> None:
    first = browser.current_window_handle
    browser.switch_to.new_window("tab")
    browser.get(_address(viewer))
    until(lambda: len(viewer.server.get_clients()) == 2 and shown(browser) is not None)
    height = str(round(viewer.session.hold.height_mm))
    until(lambda: height in browser.execute_script("return [...document.querySelectorAll('input')].map(i => i.value)"))
    browser.close()
    until(lambda: len(viewer.server.get_clients()) == 1)
    assert not viewer.worker.paused
    browser.switch_to.window(first)
    browser.switch_to.new_window("tab")
    last = browser.current_window_handle
    browser.switch_to.window(first)
    browser.close()
    browser.switch_to.window(last)
    until(lambda: viewer.worker.paused)
