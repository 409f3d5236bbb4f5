"""Pictures of a study in MLflow's pages, from headless Chromium: what docs/mlflow.md shows.

pip install selenium          # and Debian's packages chromium and chromium-driver
python scripts/screenshots.py --runs runs --study quick-fetal --out /tmp/pages
"""

import argparse
import json
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

WIDTH, HEIGHT = 1500, 1000
TALL = 1400  # of pages that are longer than a screen
RENDER_S = 12  # MLflow's pages fetch and draw for about as long, and tell nobody when they are done
# What a user has after choosing "Model training" at the top left and closing the assistant.
PREFERENCES = {"mlflow.workflowType_v1": '"machine_learning"', "mlflow.assistant.panelOpen_v1": "false"}
FIRST_ROW = "[role=row][row-index='0'] button"  # in a list of runs, what unfolds the newest


@contextmanager
def served(runs: Path) -> Iterator[str]:
    """Address of MLflow's pages while they are served from `runs`/mlflow.db, as `make ui` does."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    store = f"sqlite:///{(runs / 'mlflow.db').resolve()}"
    command = ["mlflow", "ui", "--backend-store-uri", store, "--host", "127.0.0.1", "--port", str(port)]
    server = subprocess.Popen([*command, "--workers", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = f"http://127.0.0.1:{port}"
    try:
        for _ in range(240):
            try:
                urllib.request.urlopen(f"{address}/health", timeout=2)
                break
            except OSError:
                time.sleep(0.5)
        yield address
    finally:
        server.terminate()
        server.wait()


@contextmanager
def browser() -> Iterator[webdriver.Chrome]:
    """Debian's Chromium without a window."""
    options = Options()
    options.binary_location = "/usr/bin/chromium"
    for flag in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", f"--window-size={WIDTH},{HEIGHT}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options, Service("/usr/bin/chromedriver"))
    try:
        yield driver
    finally:
        driver.quit()


def ask(address: str, call: str, **content: Any) -> dict[str, Any]:
    """What MLflow's REST interface answers."""
    body = json.dumps(content).encode()
    request = urllib.request.Request(f"{address}/api/2.0/mlflow/{call}", body, {"Content-Type": "application/json"})
    answer: dict[str, Any] = json.loads(urllib.request.urlopen(request).read())
    return answer


def pages(address: str, study: str) -> dict[str, str]:
    """Addresses of the pages by the name of their picture."""
    found = ask(address, "experiments/search", max_results=100)["experiments"]
    experiment = next(e["experiment_id"] for e in found if e["name"] == "ablate")
    runs = ask(address, "runs/search", experiment_ids=[experiment], filter=f"tags.study = '{study}'")["runs"]
    tags = {run["info"]["run_id"]: {t["key"]: t["value"] for t in run["data"]["tags"]} for run in runs}
    parent = next(r for r, t in tags.items() if t["kind"] == "study")
    children = [r for r, t in sorted(tags.items(), key=lambda i: i[1].get("variant", "")) if t["kind"] == "job"][:3]
    child = next((r for r in children if tags[r]["variant"] == "sa2h"), children[0])
    compared = "&".join(f"{k}={quote(json.dumps(v))}" for k, v in (("runs", children), ("experiments", [experiment])))
    root = f"{address}/#/experiments/{experiment}/runs"
    return {
        "experiment": root,
        "charts": f"{root}?compareRunsMode=CHART",
        "study": f"{root}/{parent}",
        "report": f"{root}/{parent}/artifacts/report.html",
        "run": f"{root}/{child}",
        "run_metrics": f"{root}/{child}/model-metrics",
        "run_artifacts": f"{root}/{child}/artifacts/provenance",
        "compare": f"{address}/#/compare-runs?{compared}",
    }


def photograph(driver: webdriver.Chrome, page: str, unfold: bool, path: Path) -> None:
    """Open a page, unfold its first run if asked to, and write what is seen of it."""
    driver.get("about:blank")  # a page that differs behind the # alone would not be loaded anew
    driver.get(page)
    time.sleep(RENDER_S)
    if unfold and not driver.find_elements(By.CSS_SELECTOR, "[role=row][row-index='1']"):
        driver.find_element(By.CSS_SELECTOR, FIRST_ROW).click()
        time.sleep(RENDER_S)
    driver.save_screenshot(str(path))


def main() -> None:
    """Photograph every page, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"))
    parser.add_argument("--study", default="quick-fetal")
    parser.add_argument("--out", type=Path, default=Path("pages"))
    parser.add_argument("--only", nargs="*", default=(), help="names of pages")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    with served(chosen.runs) as address, browser() as driver:
        driver.get(address)
        time.sleep(RENDER_S)  # the first visit sets these itself
        for key, value in PREFERENCES.items():
            driver.execute_script("localStorage.setItem(arguments[0], arguments[1])", key, value)
        for name, page in pages(address, chosen.study).items():
            if chosen.only and name not in chosen.only:
                continue
            driver.set_window_size(WIDTH, HEIGHT if name in ("experiment", "run") else TALL)
            photograph(driver, page, name in ("experiment", "charts"), chosen.out / f"{name}.png")
            print(chosen.out / f"{name}.png", flush=True)


if __name__ == "__main__":
    main()
