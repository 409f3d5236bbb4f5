"""What a store does not take stops no training: it is told once, not waited for long, and published later, once."""

import http.server
import logging
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from ablate.publish import following, mark_study, published_end, timer
from ablate.publish.waiting import in_time
from ablate.study.log import Status
from support.published import active_runs, another_process, client_of, content_of, finish, job_in, train

NAME = "sa2h/seed0"


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timer, "_EVERY_S", 0.05)


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


@pytest.fixture
def frozen() -> Iterator[str]:
    """Address of a server that takes connections and never answers."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(64)
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


def shown_within(runs: Path, status: Status, seconds: float = 60.0) -> bool:
    """Whether the run of the training gets a state in time."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        run = active_runs(runs).get(NAME)
        if run is not None and run.info.status == status:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.usefixtures("often")
def test_a_training_is_shown_while_it_goes_on_and_whole_when_it_has_ended(runs: Path) -> None:
    job = job_in(runs)
    mark_study(job.settings, Status.running)
    with following(job):
        train(job, range(2), None)
        assert shown_within(runs, Status.running)
        finish(job)
    assert active_runs(runs)["study"].info.status == "RUNNING"
    shown = content_of(runs)[NAME]
    assert (shown["status"], shown["parent"]) == ("FINISHED", "study")
    assert {point[1] for point in shown["points"] if point[0] == "train/l1"} == {0, 1, 2, 3}


@pytest.mark.usefixtures("often")
def test_what_stops_a_training_is_raised_and_its_run_says_so(runs: Path) -> None:
    job = job_in(runs)

    def stopped() -> None:
        with following(job):
            train(job, range(2), Status.failed)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        stopped()
    assert shown_within(runs, Status.failed, 0.5)


@pytest.mark.usefixtures("often")
def test_a_training_whose_process_was_killed_is_shown_as_killed_by_what_started_it(runs: Path) -> None:
    job = job_in(runs)
    with following(job):
        train(job, range(2), None)
        assert shown_within(runs, Status.running)
    client_of(runs).update_run(active_runs(runs)[NAME].info.run_id, status="RUNNING")  # as nobody told of the end
    client_of(runs).delete_tag(active_runs(runs)[NAME].info.run_id, "mlflow.ablate.published")
    published_end(job)
    assert active_runs(runs)[NAME].info.status == "KILLED"


def test_a_job_that_was_stopped_before_it_began_is_not_shown(runs: Path) -> None:
    with following(job_in(runs)):
        pass
    assert not active_runs(runs)


def test_a_server_that_takes_another_user_is_told_once_and_how_to_be_let_in(
    refusing: tuple[int, str], runs: Path, caplog: pytest.LogCaptureFixture
) -> None:
    status, uri = refusing
    job = job_in(runs, uri=uri)
    mark_study(job.settings, Status.running)
    for _ in range(2):  # as two jobs of a sweep
        with following(job):
            finish(job)
    (line,) = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert line.startswith("not published to MLflow for now, work goes on (")
    assert ("MLFLOW_TRACKING_PASSWORD" if status == 401 else "tracking.experiment=<name>") in line
    assert "\n" not in line


@pytest.mark.usefixtures("often")
def test_a_silent_server_is_not_waited_for_and_all_is_published_later_once(
    runs: Path, frozen: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "60")
    monkeypatch.setattr(timer, "_LAST_S", 0.5)
    started = time.monotonic()
    with following(job_in(runs, uri=frozen)):
        finish(job_in(runs))
    assert time.monotonic() - started < 20
    (line,) = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert "(TimeoutError: no end after 0.5 s)" in line
    monkeypatch.setattr(timer, "_LAST_S", 60.0)
    for _ in range(2):
        another_process()
        with following(job_in(runs)):
            pass
    shown = content_of(runs)
    assert shown[NAME]["status"] == "FINISHED"
    assert [point[1] for point in shown[NAME]["points"] if point[0] == "train/l1"] == [0, 1, 2, 3]


def test_work_that_takes_longer_is_not_waited_for() -> None:
    assert in_time(10, lambda: 3) == 3
    with pytest.raises(ZeroDivisionError):
        in_time(10, lambda: 1 // 0)
    started = time.perf_counter()
    with pytest.raises(TimeoutError, match=r"^no end after 0\.1 s$"):
        in_time(0.1, lambda: time.sleep(5))
    assert time.perf_counter() - started < 4
