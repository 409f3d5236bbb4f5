"""The server of the page: on this machine alone, without a tunnel, and quiet."""

import logging
import socket
import sys
from contextlib import closing, redirect_stdout
from importlib.util import find_spec
from io import StringIO
from typing import Any
from urllib.parse import urlsplit

from ablate.settings.study import ConfigurationError

#: Whatever the library's default, the page is shown to this machine only.
HOST = "127.0.0.1"
NEEDS = "task=view needs viser: pip install 'ablate-ultrasound[view]'"
_OWN_NAMES = (HOST, "localhost")


def check_server(port: int) -> None:
    """A ConfigurationError in one line where the extra is not installed, or the port is in use or not allowed."""
    if find_spec("viser") is None:
        raise ConfigurationError(NEEDS)
    with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except OSError as error:
            why = "not allowed" if isinstance(error, PermissionError) else "in use"
            raise ConfigurationError(f"viewer.port={port}: {why}; give another one, such as {port + 1}") from error


def open_server(port: int) -> Any:
    """A `viser.ViserServer` on this machine's own address, at exactly this port.

    Raises
    ------
    ConfigurationError
        As `check_server`.
    """
    check_server(port)
    import viser
    from viser import _messages

    with redirect_stdout(StringIO()):  # it prints a table of addresses
        server = viser.ViserServer(host=HOST, port=port, verbose=False)
        if server.get_port() != port:  # it takes the next one that is free
            server.stop()
            raise ConfigurationError(f"viewer.port={port}: in use; give another one, such as {port + 1}")
    sockets = server._websock_server
    for request in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        sockets.unregister_handler(request)  # a browser could ask for a tunnel to another server
    sockets.on_client_connect(_only_own_pages(sockets, port))
    _speak_in_sentences(server)
    return server


def _only_own_pages(sockets: Any, port: int) -> Any:
    """Close the connections that pages of other sites ask a browser for."""

    async def check(client: Any) -> None:
        connection = sockets._live_connections[client.client_id]
        origin = connection.request.headers.get("Origin")
        if origin is not None and not _is_own(origin, port):
            await connection.close(1008, "another site's page")
            _say(f"a page of {origin[:100]} was refused")

    return check


def _is_own(origin: str, port: int) -> bool:
    try:
        parts = urlsplit(origin)
        return parts.scheme == "http" and parts.hostname in _OWN_NAMES and parts.port == port
    except ValueError:
        return False


def _speak_in_sentences(server: Any) -> None:
    """One line for what a browser sends that cannot be understood, in place of a traceback."""

    def shorten(record: logging.LogRecord) -> bool:
        if record.exc_info and record.exc_info[1] is not None:
            said = "a browser sent what cannot be read; its connection was closed"
            record.msg, record.args, record.exc_info = f"ablate: {said}", (), None
        return True

    logging.getLogger("websockets.server").addFilter(shorten)

    def report(_: Any, context: dict[str, Any]) -> None:
        error = context.get("exception")
        _say(f"a browser sent what cannot be used: {' '.join(str(error or context['message']).split())[:200]}")

    loop = server.get_event_loop()
    loop.call_soon_threadsafe(loop.set_exception_handler, report)


def _say(words: str) -> None:
    print(f"ablate: {words}", file=sys.stderr)
