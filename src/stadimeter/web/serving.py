"""Serves the page: the socket it listens at, and its end."""

from __future__ import annotations

import asyncio
import signal
import socket
from collections.abc import Callable, Generator
from contextlib import contextmanager

import uvicorn

from stadimeter.errors import PageError
from stadimeter.web.page import Page, application


class _Server(uvicorn.Server):
    """Ends when it is told, and leaves signals to us."""

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


def listen(address: str, port: int) -> socket.socket:
    """Return a socket that listens; `PageError` if the port is taken."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((address, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise PageError(503, "no-port", f"{address}:{port}: {error.strerror}") from error
    return listener


def serve(page: Page, listener: socket.socket, ready: Callable[[], None] = lambda: None) -> None:
    """Serve the page until SIGTERM or SIGINT."""
    asyncio.run(_serve(page, listener, ready))


async def _serve(page: Page, listener: socket.socket, ready: Callable[[], None]) -> None:
    config = uvicorn.Config(
        application(page),
        log_config=None,
        access_log=False,
        server_header=False,
        ws="none",
        http="h11",
        lifespan="off",
        timeout_graceful_shutdown=1,
    )
    server = _Server(config)

    def end() -> None:
        server.should_exit = True
        page.feeds.close()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, end)
    ready()
    await server.serve(sockets=[listener])
    await page.workbench.close()
