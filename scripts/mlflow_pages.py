"""Photograph what MLflow shows of the studies in a folder of runs, at 1440 x 900: the list, the charts, a study, a run.

python scripts/mlflow_pages.py runs --study quick-fetal --into pictures

Needs selenium, of the extra `dev`, and a browser: apt install chromium chromium-driver.
"""

import argparse
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.request import urlopen

from mlflow import MlflowClient
from selenium import webdriver

from ablate.publish import default_uri

SIZE = (1440, 900)
SETTLE_S = 6.0  # pages ask for more after they are loaded
# As after a first visit: its assistant is closed, and *Model training* is chosen.
SEEN = {
    "mlflow.assistant.fab.autoOpenedOnFirstLoad_v1": "true",
    "mlflow.assistant.panelOpen_v1": "false",
    "mlflow.workflowType_v1": '"machine_learning"',
}
FLAGS = ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars")


def main() -> None:
    """Write a PNG for each page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--study", required=True)
    parser.add_argument("--into", type=Path, default=Path("pictures"))
    parser.add_argument("--only", nargs="*")
    asked = parser.parse_args()
    asked.into.mkdir(parents=True, exist_ok=True)
    uri = default_uri(asked.runs.resolve())
    addresses = pages(MlflowClient(uri), asked.study)
    with server(uri) as address, browser() as driver:
        driver.get(address)
        for key, value in SEEN.items():
            driver.execute_script("localStorage.setItem(arguments[0], arguments[1])", key, value)
        for name, page in addresses.items():
            if not asked.only or name in asked.only:
                driver.get("about:blank")
                driver.get(f"{address}/{page}")
                time.sleep(SETTLE_S)
                driver.save_screenshot(str(asked.into / f"{name}.png"))
                print(asked.into / f"{name}.png")


def pages(client: MlflowClient, study: str) -> dict[str, str]:
    """The pages of a study by name, relative to MLflow's address."""
    experiment = client.get_experiment_by_name("ablate")
    shown = client.search_runs([experiment.experiment_id], f"tags.study = '{study}'", max_results=1000)
    parent = next(run for run in shown if run.data.tags["kind"] == "study")
    children = sorted((run for run in shown if run.data.tags["kind"] == "job"), key=lambda run: run.info.run_name)
    first, top = f"#/experiments/{experiment.experiment_id}", f"#/experiments/{experiment.experiment_id}/runs"
    note = client.get_experiment(experiment.experiment_id).tags["mlflow.note.content"]
    return {
        "experiments": "#/experiments",
        "list": top,
        "charts_default": f"{top}?compareRunsMode=CHART",
        "study": f"{top}/{parent.info.run_id}",
        "study_metrics": f"{top}/{parent.info.run_id}/model-metrics",
        "study_files": f"{top}/{parent.info.run_id}/artifacts",
        "run": f"{top}/{children[0].info.run_id}",
        "run_metrics": f"{top}/{children[0].info.run_id}/model-metrics",
        "run_files": f"{top}/{children[0].info.run_id}/artifacts",
        "models": f"{first}/models",
        **dict(linked(f"{note} {parent.data.tags['mlflow.note.content']}")),
    }


def linked(description: str) -> Iterator[tuple[str, str]]:
    """The names and addresses of the links of a description."""
    for name, link in re.findall(r"\[([^]]+)\]\((#[^)]+)\)", description):
        yield name.lower().replace(" ", "_"), link


@contextmanager
def server(uri: str) -> Iterator[str]:
    """MLflow's pages on a free port."""
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    mlflow = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", uri, "--port", str(port), "--workers", "1"]
    with subprocess.Popen(mlflow, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            until = time.monotonic() + 120
            while time.monotonic() < until:
                try:
                    urlopen(f"http://127.0.0.1:{port}/health", timeout=5).close()
                    break
                except OSError:
                    time.sleep(0.5)
            yield f"http://127.0.0.1:{port}"
        finally:
            process.terminate()


@contextmanager
def browser() -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in FLAGS:
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": SIZE[0], "height": SIZE[1], "deviceScaleFactor": 1, "mobile": False},
    )
    try:
        yield driver
    finally:
        driver.quit()


if __name__ == "__main__":
    main()
