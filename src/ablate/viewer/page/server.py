"""The server of the page: on this machine alone, and without a tunnel."""

import logging
import socket
import sys
from contextlib import closing, redirect_stdout
from importlib.util import find_spec
from io import StringIO
from typing import Any

from ablate.settings.study import ConfigurationError

#: Whatever the library's default, the page is shown to this machine only.
HOST = "127.0.0.1"
NEEDS = "task=view needs viser: pip install 'ablate-ultrasound[view]'"


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
    """A `viser.ViserServer` on this machine's own address, at this port, which `check_server` has found free."""
    import viser
    from viser import _messages

    with redirect_stdout(StringIO()):  # it prints a table of addresses
        server = viser.ViserServer(host=HOST, port=port, verbose=False)
    sockets = server._websock_server
    for request in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
        sockets.unregister_handler(request)  # a browser could ask for a tunnel to another server
    sockets.on_client_connect(_only_own_pages(sockets, port))
    logging.getLogger("websockets.server").addFilter(_in_a_sentence)
    return server


def _only_own_pages(sockets: Any, port: int) -> Any:
    """Close the connections that pages of other sites ask a browser for."""
    own = [f"http://{name}:{port}".removesuffix(":80") for name in (HOST, "localhost")]

    async def check(client: Any) -> None:
        connection = sockets._live_connections[client.client_id]
        origin = connection.request.headers.get("Origin")
        if origin is not None and origin not in own:
            await connection.close(1008, "another site's page")
            print(f"ablate: a page of {origin[:100]} was refused", file=sys.stderr)

    return check


def _in_a_sentence(record: logging.LogRecord) -> bool:
    """Shorten the traceback of what a browser sends and cannot be understood to one line."""
    if record.exc_info and record.exc_info[1] is not None:
        record.msg = "ablate: a browser sent what cannot be read; its connection was closed"
        record.args, record.exc_info = (), None
    return True
