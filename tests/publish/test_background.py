"""What a server refuses is said in one line that names what to do, and said once."""

import _thread
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from ablate.tracking import Background, local_log, open_store, reason


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


def test_a_thread_that_finds_no_memory_to_begin_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in ((_thread, "start_new_thread"), (threading, "_start_new_thread")):
        monkeypatch.setattr(module, name, lambda *_: None, raising=False)
    monkeypatch.setattr(local_log, "_WAIT_S", 0.01)
    assert not Background(lambda: None).close()
