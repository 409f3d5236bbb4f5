"""What a server refuses is said in one line that names what to do, and said once; how busy a machine is is logged."""

import http.server
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from ablate.jobs import preflight
from ablate.jobs.compose import jobs_of
from ablate.tracking import (
    Background,
    LocalLog,
    StoredRun,
    local_log,
    open_store,
    parent_run,
    read_log,
    reason,
    system_metrics,
)
from ablate.tracking.local_log import points


@pytest.fixture(params=[401, 403])
def refusing(request: pytest.FixtureRequest) -> Iterator[tuple[int, str]]:
    """The status that a server answers with whatever it is asked, and its address."""

    class Refuses(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_error(request.param)

        def log_message(self, *_: object) -> None: ...

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Refuses) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield request.param, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_server_that_takes_another_user_is_told_once_and_how_to_be_let_in(
    refusing: tuple[int, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    status, uri = refusing
    local_log._say.cache_clear()
    for _ in range(2):  # as two jobs of a sweep
        assert not Background(lambda: open_store(tmp_path, uri, "ablate")).close()
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith("not tracked for now, work goes on (")
    assert ("MLFLOW_TRACKING_PASSWORD" if status == 401 else "tracking.experiment=<name>") in line
    assert "\n" not in line


def test_any_other_reason_is_what_was_raised_in_one_line() -> None:
    assert reason(OSError("the disk\nis full")) == "OSError: the disk is full"
    assert len(reason(ValueError("x" * 5000))) < 250


def sampled(folder: Path, seconds: float) -> None:
    with system_metrics(folder, LocalLog(folder), every_s=0.05):
        time.sleep(seconds)


def test_samples_are_those_of_the_machine_and_a_resumed_run_goes_on_counting(runs: Path, tmp_path: Path) -> None:
    before = threading.active_count()
    sampled(tmp_path, 0.4)
    first = [p for p in points(read_log(tmp_path)[0]) if p.key == "system/system_memory_usage_percentage"]
    assert len(first) >= 2
    assert first[-1].value == pytest.approx(psutil.virtual_memory().percent, abs=20)
    sampled(tmp_path, 0.2)
    assert threading.active_count() == before, "a sampler that goes on"
    every = [p for p in points(read_log(tmp_path)[0]) if p.key == "system/cpu_utilization_percentage"]
    assert [p.step for p in every] == list(range(len(every)))
    assert len(every) > len(first)
    assert all(0 <= p.value <= 100 for p in every)
    store = open_store(runs, None, "ablate")
    run = StoredRun(store, parent_run(store, "study"))
    run.copy_log(tmp_path)
    kept = store.client.get_metric_history(run.run_id, "system/cpu_utilization_percentage")
    assert [(p.step, p.value) for p in kept] == [(p.step, p.value) for p in every]


def test_without_psutil_the_package_to_install_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    jobs = jobs_of(["preset=tiny", f"runs_dir={tmp_path}", "tracking.system_metrics=true"])
    preflight.check(jobs)
    monkeypatch.setattr(preflight, "find_spec", lambda _: None)
    with pytest.raises(ValueError, match=r"psutil: pip install -e '\.\[system\]'"):
        preflight.check(jobs)
