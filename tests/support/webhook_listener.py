"""A web service on the loopback interface that takes notifications as JSON, and can be plagued."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

HOST = "127.0.0.1"


class WebhookListener:
    """Listens while it is open, and remembers what was posted to it.

    Attributes:
        posted: The bodies of all requests, read as JSON, in the order in which they are answered with success.
        is_free: Cleared, requests are left without an answer until it is set.
        asked: Set as soon as a request has come.
    """

    def __init__(self) -> None:
        self.posted: list[dict[str, Any]] = []
        self.status = 200
        self.is_free = threading.Event()
        self.is_free.set()
        self.asked = threading.Event()
        listener = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
                listener.asked.set()
                listener.is_free.wait()
                if listener.status == 200:  # before the answer, after which whoever asked may look
                    listener.posted.append(json.loads(body))
                self.send_response(listener.status)
                self.end_headers()

            def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name is http.server's
                pass

        self._server = ThreadingHTTPServer((HOST, 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Answer what waits, and stop listening."""
        self.is_free.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
