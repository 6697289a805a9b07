"""Dashboard: a node's diagnostics as one JSON document, on a web page that is served to this machine alone.

It is read-only. The server listens on 127.0.0.1 and answers requests for its own name only: pages of other names that
resolve to this address (DNS rebinding) get nothing.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from itertools import islice
from typing import Any, TypeAlias

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import interval_of_positive
from geomid_ros.report.page import Script, rendered_page
from geomid_ros.report.result_pages import cannot_tell

State: TypeAlias = dict[str, Any]
_COUNTS = ("received", "accepted", "lost")
_REASONS = ("rejected", "dropped", "noted")
_LEVELS = ("ok", "warning", "error", "stale")
_MOST = 500  # statuses, and values of each, as the publisher of diagnostics decides how many there are


def state_of(node: str, diagnoses: Sequence[Any]) -> State | None:
    """Return the state of a node.

    Args:
        node: its full name without the leading slash.
        diagnoses: statuses of one message (``diagnostic_msgs/DiagnosticStatus``), those of other nodes included.

    Returns:
        ``level`` and ``message`` of its stream, ``links``, ``channels``, ``topics``, ``numbers`` and ``others``
        (statuses that are not of links); None if the node has no stream status.
    """
    own = islice((item for item in diagnoses if item.name.startswith(f"{node}: ")), _MOST)
    states = {item.name.removeprefix(f"{node}: "): item for item in own}
    values = {name: {pair.key: pair.value for pair in item.values[:_MOST]} for name, item in states.items()}
    stream = states.pop("stream", None)
    if stream is None:
        return None
    channels, topics, numbers = _grouped(values["stream"])
    return {
        "node": node,
        "level": _level(stream),
        "message": stream.message,
        "links": [_link(name, values[name]) for name in states if "mass" in values[name]],
        "channels": [{"name": name, **entries} for name, entries in channels.items()],
        "topics": [{"name": name, **entries} for name, entries in topics.items()],
        "numbers": list(numbers.items()),
        "others": [
            {"name": name, "level": _level(item), "message": item.message, "values": list(values[name].items())}
            for name, item in states.items()
            if "mass" not in values[name]
        ],
    }


def _level(status: Any) -> str:
    return _LEVELS[min(int.from_bytes(status.level), len(_LEVELS) - 1)]


def _number(text: str | None) -> float | None:
    """Return a finite number, else None, as JSON has no NaN or infinity."""
    try:
        value = float(text or "nan")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _link(name: str, values: Mapping[str, str]) -> State:
    mass, deviation = _number(values["mass"]), _number(values.get("mass std"))
    ends: tuple[float | None, float | None] = (None, None)
    if mass is not None and mass > 0.0 and deviation is not None and deviation >= 0.0:
        ends = interval_of_positive(mass, deviation)
    return {
        "name": name,
        "mass": mass,
        "std": deviation,
        "low": ends[0],
        "high": ends[1],
        "from_data": _number(values.get("from data")),
        "distance": _number(values.get("distance from prior")),
        "merged": values.get("merged", ""),
        "cannot_tell": cannot_tell([*filter(None, values.get("not identifiable", "").split(", "))]),
    }


def _grouped(values: Mapping[str, str]) -> tuple[dict[str, State], dict[str, State], dict[str, str]]:
    """Group the stream's values by channel, by topic, and those of the stream as a whole."""
    channels: dict[str, State] = {key.removesuffix(" rms"): {} for key in values if key.endswith(" rms")}
    topics: dict[str, State] = {}
    numbers: dict[str, str] = {}
    for key, value in values.items():
        channel, _, kind = key.rpartition(" ")
        topic, _, reason = key.partition(": ")
        topic, _, outcome = topic.rpartition(" ")
        if key.startswith("gap "):
            channels.setdefault(key.removeprefix("gap "), {})["gap"] = _number(value)
        elif channel in channels and kind in ("rms", "sigma"):
            channels.setdefault(channel, {})[kind] = _number(value)
        elif outcome in _REASONS and topic != "rows":
            topics.setdefault(topic, {}).setdefault(outcome, []).append([reason, value])
        elif kind in _COUNTS:
            topics.setdefault(channel, {})[kind] = value
        else:
            numbers[key] = value
    return channels, topics, numbers


ADDRESS = "127.0.0.1"
PORT = 8765
_OUR_NAMES = r"(127\.0\.0\.1|localhost)"
_MOST_LISTENERS = 20
_MOST_BODY = 1024  # bytes: requests of the page have no body
_BEAT = 0.25  # [s] interval at which new states are sent, and closed connections noticed
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Board:
    """Latest state as text, how many there were, and who listens. For one thread alone."""

    def __init__(self) -> None:
        self.text, self.version, self.listeners = "", 0, 0

    def show(self, state: State) -> None:
        """Replace the state."""
        self.text = json.dumps(state, allow_nan=False)
        self.version += 1


class _Handler(RequestHandler):
    def initialize(self, board: Board, page: bytes) -> None:
        self._board, self._page = board, page

    def set_default_headers(self) -> None:
        for name, value in _HEADERS.items():
            self.set_header(name, value)


class _Page(_Handler):
    def get(self) -> None:
        self.finish(self._page)


class _Events(_Handler):
    """Server-sent events, each a complete state."""

    async def get(self) -> None:
        if self._board.listeners >= _MOST_LISTENERS:
            raise HTTPError(503)
        self.set_header("Content-Type", "text/event-stream")
        self._board.listeners += 1
        seen = 0
        try:
            while True:
                is_new, seen = self._board.version > seen, self._board.version
                self.write(f"data: {self._board.text}\n\n" if is_new else ": nothing new\n\n")
                await self.flush()  # fails once the connection is closed
                await asyncio.sleep(_BEAT)
        except (StreamClosedError, asyncio.CancelledError):
            pass  # the listener leaves, or the dashboard ends
        finally:
            self._board.listeners -= 1


@asynccontextmanager
async def served_board(node: str, port: int | None) -> AsyncIterator[tuple[Board, str]]:
    """Serve the page inside the context, which is given its board and its address.

    Args:
        node: name of the node that is shown.
        port: port to serve on; None: the default port, or any free port if that is taken.

    Raises:
        InputError: the port is taken.
    """
    board = Board()
    page = rendered_page("dashboard.html.j2", {"node": node, "script": Script.read("dashboard.js")}).encode()
    settings = {"board": board, "page": page}
    application = Application(log_function=lambda _: None)
    application.add_handlers(_OUR_NAMES, [("/", _Page, settings), ("/events", _Events, settings)])
    server = HTTPServer(application, max_body_size=_MOST_BODY, idle_connection_timeout=60.0)
    try:
        sockets = bind_sockets(port or PORT, ADDRESS)
    except OSError as error:
        if port is not None:
            reason = f"port {port} of {ADDRESS} is not available ({error.strerror})"
            raise InputError(f"{reason}; use another --port") from error
        sockets = bind_sockets(0, ADDRESS)
    server.add_sockets(sockets)
    try:
        yield board, f"http://{ADDRESS}:{sockets[0].getsockname()[1]}"
    finally:
        server.stop()
        await server.close_all_connections()
