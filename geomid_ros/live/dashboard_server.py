"""Web page that shows a node, served to this machine alone. It is read-only.

The server listens on 127.0.0.1 and answers requests for its own name only: pages of other names that resolve to this
address (DNS rebinding) get nothing.
"""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler

from geomid_ros.errors import InputError
from geomid_ros.live.dashboard_state import State
from geomid_ros.report.page import Script, rendered_page

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
        self.text = ""
        self.version = 0
        self.listeners = 0

    def show(self, state: State) -> None:
        """Replace the state."""
        self.text = json.dumps(state, allow_nan=False)
        self.version += 1


class _Handler(RequestHandler):
    def initialize(self, board: Board, page: bytes) -> None:
        self._board = board
        self._page = page

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
        try:
            await self._follow()
        except (StreamClosedError, asyncio.CancelledError):
            pass  # the listener leaves, or the dashboard ends
        finally:
            self._board.listeners -= 1

    async def _follow(self) -> None:
        seen = 0
        while True:
            is_new, seen = self._board.version > seen, self._board.version
            self.write(f"data: {self._board.text}\n\n" if is_new else ": nothing new\n\n")
            await self.flush()  # fails once the connection is closed
            await asyncio.sleep(_BEAT)


def _bound(port: int | None) -> list[socket.socket]:
    """Return sockets on a port; None: the default port, or any free port if that is taken."""
    try:
        return bind_sockets(PORT if port is None else port, ADDRESS)
    except OSError as error:
        if port is None:
            return bind_sockets(0, ADDRESS)
        raise InputError(f"port {port} of {ADDRESS} is not available ({error.strerror}); use another --port") from error


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
    sockets = _bound(port)
    server.add_sockets(sockets)
    try:
        yield board, f"http://{ADDRESS}:{sockets[0].getsockname()[1]}"
    finally:
        server.stop()
        await server.close_all_connections()
