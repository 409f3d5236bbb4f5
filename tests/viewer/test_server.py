"""Who may use the page: this machine's own pages, no other site's, and nobody through a tunnel."""

import socket
import time
import tomllib
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

viser = pytest.importorskip("viser", reason="needs the extra: pip install 'ablate-ultrasound[view]'")

from packaging.requirements import Requirement  # noqa: E402
from packaging.version import Version  # noqa: E402

from ablate.settings.study import ConfigurationError  # noqa: E402
from ablate.viewer.server import HOST, check_server, open_server  # noqa: E402
from support.viewed_body import free_port, until  # noqa: E402
from support.viewer_client import Client, ConnectionClosed  # noqa: E402

# Threads of viser's server end a moment after it has been told to stop.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
BUTTON = "a part of the page"
ELSEWHERE = "http://example.org"
OTHER_ADDRESS = "127.0.0.2"  # of this machine too


@pytest.fixture
def server() -> Iterator[Any]:
    opened = open_server(free_port())
    opened.gui.add_button(BUTTON)
    yield opened
    opened.stop()


@pytest.fixture
def tunnels(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The hosts that viser opens a tunnel to, which is not opened in a test."""
    asked: list[str] = []

    class Tunnel:
        def __init__(self, host: str, _port: int) -> None:
            asked.append(host)

        def on_connect(self, call: Any) -> Any:
            return call

        on_disconnect = on_connect

        def get_status(self) -> str:
            return "failed"

        def close(self) -> None:
            pass

    monkeypatch.setattr("viser._viser.ViserTunnel", Tunnel)
    return asked


def sees_the_page(port: int, origin: str | None) -> bool:
    """Whether a client is sent the page; False where its connection is closed before."""
    client = Client(port, origin=origin)
    with suppress(ConnectionClosed), client:  # closed while it sends its first message
        until(lambda: BUTTON in client.labels or client.closed)
    return BUTTON in client.labels


def ask_for_a_tunnel(port: int) -> None:
    """Send what the button of viser's page sends, and wait until the server has read it."""
    with Client(port) as client:
        client.send({"type": "ShareUrlRequest"})
        client.send({"type": "ShareUrlDisconnect"})
        time.sleep(1.0)
        assert not client.closed


def test_it_listens_on_this_machine_alone(server: Any) -> None:
    """One that listens everywhere takes connections to any address of the machine."""
    everywhere = viser.ViserServer(host="0.0.0.0", port=free_port(), verbose=False)
    socket.create_connection((OTHER_ADDRESS, everywhere.get_port()), timeout=10).close()
    everywhere.stop()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection((OTHER_ADDRESS, server.get_port()), timeout=10)


def test_own_pages_and_programs_see_the_page_and_another_site_does_not(
    server: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    port = server.get_port()
    for origin in (f"http://127.0.0.1:{port}", f"http://localhost:{port}", None):
        assert sees_the_page(port, origin)
    others = (
        ELSEWHERE,
        f"http://example.org:{port}",  # a name that leads to this machine: DNS rebinding
        f"http://127.0.0.1:{port + 1}",
        f"http://127.0.0.1:{port}.example.org",
        f"https://127.0.0.1:{port}",
        "null",  # a page in a sandbox, or a file
    )
    for origin in others:
        assert not sees_the_page(port, origin)
    assert capsys.readouterr().err.count("was refused") == len(others)


def test_another_site_that_connects_while_the_server_starts_is_closed_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the start of viser's server and the first check a page that tries all the time may come in."""
    early = Client(port := free_port(), origin=ELSEWHERE)
    start = viser.ViserServer.__init__

    def start_and_let_in(self: Any, *args: Any, **keywords: Any) -> None:
        start(self, *args, **keywords)
        early.__enter__()
        until(lambda: early.kinds or early.seen or self._websock_server._live_connections)
        assert not early.closed

    monkeypatch.setattr(viser.ViserServer, "__init__", start_and_let_in)
    opened = open_server(port)
    until(lambda: early.closed)
    opened.stop()


def test_nobody_can_ask_for_a_tunnel(server: Any, tunnels: list[str]) -> None:
    ask_for_a_tunnel(server.get_port())
    assert not tunnels


def test_without_this_module_the_same_request_opens_a_tunnel(tunnels: list[str]) -> None:
    """Else the test above would pass for a message that viser has renamed."""
    bare = viser.ViserServer(host=HOST, port=free_port(), verbose=False)
    ask_for_a_tunnel(bare.get_port())
    until(lambda: tunnels)
    bare.stop()


def test_only_the_minor_release_that_was_tried_is_allowed() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    (asked,) = map(Requirement, project["optional-dependencies"]["view"])
    tried = Version(viser.__version__)
    assert tried in asked.specifier
    assert f"{tried.major}.{tried.minor + 1}" not in asked.specifier


def test_a_port_in_use_is_one_sentence(server: Any) -> None:
    port = server.get_port()
    sentence = rf"^viewer.port={port}: in use; give another one, such as {port + 1}$"
    with pytest.raises(ConfigurationError, match=sentence):
        check_server(port)


def test_in_place_of_the_last_port_no_port_behind_it_is_named() -> None:
    with closing(socket.socket()) as busy:
        busy.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        busy.bind((HOST, 65535))
        busy.listen()
        with pytest.raises(ConfigurationError, match=r"^viewer.port=65535: in use; give another one, such as 8090$"):
            check_server(65535)


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ablate.viewer.server.find_spec", lambda _: None)
    with pytest.raises(ConfigurationError, match=r"pip install -e '\.\[view\]'"):
        check_server(8090)
