"""Serves the page: where it listens, its connections and their bounds, and its end."""

from __future__ import annotations

import asyncio
import errno
import logging
import signal
import socket
import ssl
import time
from collections.abc import Awaitable, Callable, Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.gzip import GZipMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from stadimeter.app.ending import heeds_hangup
from stadimeter.errors import PageError
from stadimeter.web.access import AccessGuard, is_loopback
from stadimeter.web.answers import as_error, as_json, as_picture, bounded_body
from stadimeter.web.page import Page, PageOptions, login_form
from stadimeter.web.passwords import PasswordFile
from stadimeter.web.routes import BODY_MAX_BYTES, PAGE_OPERATIONS, PageOperation, Right

# The page as an application: every path of the table, and who may go there ------------------------


_READ_AS: Mapping[str, type] = {"number": float, "integer": int}
_Endpoint = Callable[[Request], Awaitable[Response]]

# The files of the page are a quarter as large; level 6 costs a tenth of the time of 9, and 1 % of the size.
_GZIPPED = (Middleware(GZipMiddleware, minimum_size=1024, compresslevel=6),)


def application(page: Page) -> ASGIApp:
    """Return the application: every path of the table, and 404 for all else."""
    routes = [_route(page, operation) for operation in PAGE_OPERATIONS]
    handlers: Mapping[Any, Any] = {PageError: _answer_refusal, HTTPException: _no_such, Exception: _defect}
    return AccessGuard(Starlette(routes=routes, exception_handlers=handlers), page.access, login_form)


def _route(page: Page, operation: PageOperation) -> Route:
    answer: _Endpoint = getattr(page, operation.op) if operation.to == "own" else _handed_on(page, operation)

    async def admitted(request: Request) -> Response:
        page.access.check(operation, request.scope)
        return await answer(request)

    route = Route(operation.path, admitted, middleware=_GZIPPED if operation.is_text else ())
    route.methods = {operation.method}  # and no HEAD with each GET: a stream would not end
    return route


def _handed_on(page: Page, operation: PageOperation) -> _Endpoint:
    async def ask(request: Request) -> Response:
        args = await _args(request, operation)
        if operation.to == "run":
            answer = await page.run.ask(operation.op, args, operation.wait_s)
        else:
            answer = await page.workbench.ask(operation.op, args, operation.wait_s)
        if operation.media:
            return as_picture(answer, operation.media)
        hidden = () if request.scope["right"] is Right.OPERATE else operation.hidden
        return as_json(
            {key: value for key, value in answer.data.items() if key not in hidden} if hidden else answer.data
        )

    return ask


async def _args(request: Request, operation: PageOperation) -> dict[str, Any]:
    """Return the arguments that are handed on: of the body, of the query, and of the path, which has the last word."""
    args = {**await _body(request, operation), **_query(request, operation), **request.path_params}
    if "ago_s" in args:
        args["at_unix_s"] = time.time() - args.pop("ago_s")
    if operation.names_operator:
        args.setdefault("by", f"the page at {request.client.host}" if request.client else "the page")
    return args


def _query(request: Request, operation: PageOperation) -> dict[str, Any]:
    query = {}
    for name, kind in operation.query.items():
        if name in request.query_params:
            try:
                query[name] = _READ_AS.get(kind, str)(request.query_params[name])
            except ValueError as error:
                raise PageError(400, "wrong-query", f"{name}: a number is wanted") from error
    return query


async def _body(request: Request, operation: PageOperation) -> Mapping[str, Any]:
    text = await bounded_body(request, BODY_MAX_BYTES) if operation.changes else b""
    if not text:
        return {}
    try:
        return msgspec.json.decode(text, type=dict[str, Any])
    except (ValueError, RecursionError) as error:
        raise PageError(400, "wrong-body", f"the body of the request is no JSON object: {error}") from error


def _answer_refusal(_request: Request, error: PageError) -> Response:
    return as_error(error)


def _no_such(request: Request, error: HTTPException) -> Response:
    code = {404: "not-found", 405: "wrong-method"}.get(error.status_code, "refused")
    return as_error(PageError(error.status_code, code, f"{request.method} {request.url.path}: {error.detail}"))


def _defect(_request: Request, error: Exception) -> Response:
    words = f"this is a defect of stadimeter, not of yours: {type(error).__name__}"
    return as_error(PageError(500, "defect", words))


# The process: where it listens, its connections and their bounds, and its end ---------------------


# A connection without a request, or with one that is not whole, is ended after this long.
CONNECTIONS_MAX = 256
IDLE_MAX_S = 15.0

# So is one that takes nothing of what we send.
STUCK_MAX_S = 30.0

# More than this does not wait in the kernel for a slow browser: what waits there is old when it is seen.
UNSENT_MAX_BYTES = 128 * 1024

EVERYWHERE = ("::", "0.0.0.0")  # noqa: S104 - only with a password


def listen(address: str | None, port: int, passwords: Path) -> socket.socket:
    """Return a socket that listens.

    Args:
        address: Where; None for the loopback without a password, and everywhere with one.

    Raises:
        PageError: The port is in use, the address is none of ours, or others could reach us without a password.
    """
    has_password = PasswordFile(passwords).passwords() is not None
    if address is not None and not is_loopback(address) and not has_password:
        words = f"{address} can be reached by others: set a password first, once, by adding `--set-password`"
        raise PageError(400, "no-passwords", words)
    wanted = (address,) if address else EVERYWHERE if has_password else ("127.0.0.1",)
    for each in wanted:
        try:
            return _make_listener(each, port)
        except OSError as error:
            if each == wanted[-1] or error.errno in {errno.EADDRINUSE, errno.EACCES}:
                raise PageError(503, "no-port", _why_not(each, port, error)) from error
    raise AssertionError("there is at least one address")


def check_certificate(certificate: Path | None, key: Path | None) -> None:
    """See that a certificate and its key can be used; `PageError` says why not."""
    if certificate is None or key is None:
        return
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=lambda: "")
    except ssl.SSLError as error:
        words = f"{certificate} and {key} are no certificate with its key, without a passphrase, both as PEM"
        raise PageError(400, "certificate", words) from error
    except OSError as error:
        words = f"{certificate} or {key} cannot be read: {error.strerror}"
        raise PageError(400, "certificate", words) from error


def serve(
    options: PageOptions,
    listener: socket.socket,
    tls: tuple[Path | None, Path | None] = (None, None),
    ready: Callable[[], None] = lambda: None,
) -> None:
    """Serve the page until SIGTERM, SIGINT or SIGHUP.

    Each ends it at once: streams end, and requests that wait for an answer get an error.
    """
    asyncio.run(_serve(Page(options, listener.getsockname()[:2]), listener, tls, ready))


async def _serve(
    page: Page, listener: socket.socket, tls: tuple[Path | None, Path | None], ready: Callable[[], None]
) -> None:
    server = server_of(page, tls)

    def end() -> None:
        if not server.should_exit:
            work.create_task(page.close())
        server.force_exit = server.should_exit
        server.should_exit = True
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # a download that is cut short is no fault

    loop = asyncio.get_running_loop()
    numbers = [signal.SIGTERM, signal.SIGINT]
    if heeds_hangup():
        numbers.append(signal.SIGHUP)
    for number in numbers:
        loop.add_signal_handler(number, end)
    async with asyncio.TaskGroup() as work:
        ready()
        await server.serve(sockets=[listener])


def server_of(page: Page, tls: tuple[Path | None, Path | None] = (None, None)) -> uvicorn.Server:
    """Return a server that serves a page, until its ``should_exit`` is set."""
    certificate, key = tls
    config = uvicorn.Config(
        application(page),
        http=_Connection,
        ws="none",
        lifespan="off",
        log_config=None,
        log_level="error",  # what strangers send must not fill a log
        access_log=False,
        server_header=False,
        proxy_headers=False,
        timeout_graceful_shutdown=1,
        ssl_certfile=certificate,
        ssl_keyfile=key,
    )
    return _Server(config)


class _Server(uvicorn.Server):
    """Leaves signals to us: it would end the process before what it started has ended."""

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


class _Connection(H11Protocol):
    """A connection that cannot be held without asking anything."""

    _since_s = 0.0
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if len(self.connections) > CONNECTIONS_MAX:
            transport.abort()
        self._since_s = self.loop.time()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        self._since_s = self.loop.time()
        super().on_response_complete()

    def _watch(self) -> None:
        is_busy = self.cycle is not None and not self.cycle.response_complete
        if not is_busy and self.loop.time() - self._since_s > IDLE_MAX_S:
            self.transport.abort()
        else:
            self._timer = self.loop.call_later(IDLE_MAX_S / 4, self._watch)


def _make_listener(address: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Connections inherit these.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(STUCK_MAX_S * 1000))
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_MAX_BYTES)
        if address == "::":
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        listener.bind((address, port))
        listener.listen(128)
    except BaseException:
        listener.close()
        raise
    return listener


def _why_not(address: str, port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"port {port} is in use by another program; give another one with `--port`"
    if error.errno == errno.EACCES:
        return f"port {port} is for root only; give one from 1024 on with `--port`"
    return f"{address}: cannot listen there: {error.strerror}"  # that of a name is no number of the system's
