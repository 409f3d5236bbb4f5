"""A browser without a picture: speaks with the viewer's page as its JavaScript does, for tests and benchmarks."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 5.0),
    "fov": 0.7,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 400,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 1.0, 0.0),
}


@dataclass(frozen=True)
class Seen:
    """A change of one part of the page, and when it came, seconds of `time.perf_counter`."""

    part: str
    values: dict[str, Any]
    at_s: float


@dataclass(eq=False)
class Client:
    """A connection to a page; `labels` are the identities of its parts by their labels, `seen` what changed."""

    port: int
    origin: str | None = None
    labels: dict[str, str] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    values: dict[str, dict[str, Any]] = field(default_factory=dict)
    nodes: dict[str, dict[str, Any]] = field(default_factory=dict)
    seen: list[Seen] = field(default_factory=list)

    def __enter__(self) -> Self:
        self._socket = connect(
            f"ws://127.0.0.1:{self.port}",
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            origin=self.origin,  # type: ignore[arg-type]
            max_size=None,
            compression=None,
            open_timeout=60,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.send(_CAMERA)
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._socket.close()
        self._reader.join(10)

    def send(self, message: dict[str, Any]) -> None:
        self._socket.send(msgspec.msgpack.encode(message))

    @property
    def closed(self) -> bool:
        """Whether the page has closed the connection."""
        return not self._reader.is_alive()

    def send_raw(self, content: bytes) -> None:
        self._socket.send(content)

    def set(self, label: str, value: object) -> None:
        """Move a slider, pick from a list, switch a box."""
        self.send({"type": "GuiUpdateMessage", "uuid": self.labels[label], "updates": {"value": value}})

    def press(self, label: str) -> None:
        """Press a button, or give a command that a key gives too."""
        if self.kinds[self.labels[label]] == "RegisterCommandMessage":
            self.send({"type": "CommandTriggerMessage", "uuid": self.labels[label]})
        else:
            self.set(label, True)

    def texts(self) -> str:
        """All words that stand on the page."""
        parts = [str(v.get("content") or v.get("_markdown") or "") for v in list(self.values.values())]
        return "\n".join(part for part in parts if part)

    def images(self) -> list[Seen]:
        """The pictures that have come, oldest first."""
        return [seen for seen in list(self.seen) if "_data" in seen.values]

    def captions(self) -> list[Seen]:
        """The lines under the pictures that have come, oldest first."""
        return [seen for seen in list(self.seen) if "mm deep" in str(seen.values.get("content"))]

    def until(self, holds: Callable[[], object], within_s: float = 60.0) -> None:
        end = time.monotonic() + within_s
        while not holds():
            if time.monotonic() > end:
                raise TimeoutError(f"nothing happened; the page says: {self.texts()[-500:]}")
            time.sleep(0.005)

    def _read(self) -> None:
        with suppress(ConnectionClosed):
            while True:
                content = self._socket.recv()
                assert isinstance(content, bytes)
                length = int.from_bytes(content[8:16], "little")
                plain = zstandard.ZstdDecompressor().decompress(content[16 : 16 + length])
                for message in msgspec.msgpack.decode(plain)["messages"]:
                    self._take(message, time.perf_counter())

    def _take(self, message: dict[str, Any], at_s: float) -> None:
        kind = message["type"]
        if kind in ("GuiUpdateMessage", "CommandUpdateMessage"):
            self.values.setdefault(message["uuid"], {}).update(message["updates"])
            self.seen.append(Seen(message["uuid"], message["updates"], at_s))
        elif "uuid" in message and "props" in message:
            self.kinds[message["uuid"]] = kind
            self.values.setdefault(message["uuid"], {}).update(message["props"])
            if "value" in message:
                self.values[message["uuid"]]["value"] = message["value"]
            if message["props"].get("label"):
                self.labels[message["props"]["label"]] = message["uuid"]
        elif kind in ("SetPositionMessage", "SetOrientationMessage"):
            self.nodes.setdefault(message["name"], {}).update(message)
