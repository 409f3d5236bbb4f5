"""The server of the page, and who may use it.

What is promised: the page is reached from this machine alone, and by no page of another site.

- The server listens on the loopback address, whatever the library's default.
- viser lets every browser ask for a tunnel through a public server (`ShareUrlRequest`). It is never opened: the two
  methods that viser calls for such requests do nothing here.
- Any site may have a browser connect to this machine, and the browser names the site. Connections of other sites are
  closed before a message of theirs is read, and those that came while the server was starting are closed then.

Other programs and other users of this machine are not kept out: who can run code here can read the port.

viser has no public way to see where a connection comes from, so this module reads two private names of it,
`_websock_server` and `_live_connections`. If they change, no page is shown: the error closes the connection. Therefore
the extra `view` allows one minor release of viser; tests/viewer/test_server.py says whether the next one keeps this.
"""

import socket
import sys
from collections.abc import Callable, Coroutine
from contextlib import closing, redirect_stdout
from importlib.util import find_spec
from io import StringIO
from typing import Any

from ablate.extras import installing
from ablate.settings.study import ConfigurationError, ViewerSettings

HOST = "127.0.0.1"
_POLICY_VIOLATION = 1008  # RFC 6455, 7.4.1
_FREE_TO_USE = range(1024, 65535)  # those below are the administrator's, and behind the last one there is none


def check_server(port: int) -> None:
    """A ConfigurationError in one line where the extra is not installed, or the port is in use or not allowed."""
    if find_spec("viser") is None:
        raise ConfigurationError(f"task=view needs viser: {installing('view')}")
    with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except OSError as error:
            why = "not allowed" if isinstance(error, PermissionError) else "in use"
            other = port + 1 if port in _FREE_TO_USE else ViewerSettings.port
            raise ConfigurationError(f"viewer.port={port}: {why}; give another one, such as {other}") from error


def open_server(port: int) -> Any:
    """A `viser.ViserServer` at this port, which `check_server` has found free; it keeps what this module promises."""
    import viser

    class WithoutTunnel(viser.ViserServer):
        """What a browser's requests for a tunnel call does nothing."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Open no tunnel."""

        def disconnect_share_url(self) -> None:
            """Close none."""

    with redirect_stdout(StringIO()):  # it prints a table of addresses
        server = WithoutTunnel(host=HOST, port=port, verbose=False)
    connections = server._websock_server
    connections.on_client_connect(_only_own_pages(connections, port))
    connections.disconnect_all_clients()  # those that came before the line above; a page connects again by itself
    return server


def _only_own_pages(connections: Any, port: int) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """Close the connections that pages of other sites ask a browser for; a program names no site."""
    own_sites = [f"http://{name}:{port}".removesuffix(":80") for name in (HOST, "localhost")]

    async def check(client: Any) -> None:
        connection = connections._live_connections[client.client_id]
        site = connection.request.headers.get("Origin")
        if site is not None and site not in own_sites:
            print(f"ablate: a page of {site[:100]} was refused", file=sys.stderr)
            await connection.close(_POLICY_VIOLATION, "another site's page")

    return check
