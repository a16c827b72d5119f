"""The Unix socket at which a running instance can be asked.

Each connection has a thread of its own, which reads a line, hands the request to the control loop and sends the answer.
All that the loop does is to take the requests that are sound, once a cycle, and to hand back answers: it never waits.

What comes in at the socket may be anything, so lines and requests that wait are limited, and who says or reads nothing
is hung up on. Only our own user may connect, so connections are not counted. Whatever fails costs its own connection.
"""

from __future__ import annotations

import os
import queue
import socket
import socketserver
import stat
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from msgspec import Struct

from stadimeter.app.control import messages
from stadimeter.app.places import check_folder, is_alive
from stadimeter.errors import ControlError

# This many requests may wait for the loop, which takes them all once a cycle.
WAITING_MAX = 64

# A client that sends no line, or does not read its answer, for this long is hung up on.
IDLE_MAX_S = 30.0

# The loop is waited for this long; a reload takes longest.
ANSWER_MAX_S = 90.0

# Closing waits this long for the threads of connections, which end as soon as their sockets are shut down.
END_WAIT_S = 0.5

# Whoever has subscribed and does not read a snapshot for this long is hung up on.
UNREAD_MAX_S = 5.0

# After a connection that could not be accepted: the process has no file descriptors left, and no loop must spin.
RETRY_S = 0.05

# Gives the answer to a request. May be called from any thread, once; it never waits. An answer that takes long to put
# into words is given as a function, which is called in the thread of the connection.
Answer = Callable[[messages.Reply | Callable[[], messages.Reply]], None]


class Watched(Protocol):
    """The parts of a run that can be watched, without asking the loop."""

    def subscribe(self, args: messages.SubscribeArgs, wake: Answer) -> Callable[[], None]:
        """Begin to call ``wake`` with what makes the next snapshot, from any thread; return what ends it."""
        ...

    def frame(self, args: messages.FrameArgs) -> messages.Reply:
        """Return the newest frame."""
        ...


class Asked(Struct, frozen=True):
    """A request, and how to answer it.

    Attributes:
        may_let_act: Whether its sender may let outputs act.
    """

    request: messages.Request
    answer: Answer
    may_let_act: bool = True


class ControlSocket:
    """Listens at a Unix socket.

    Args:
        path: Where; only our user may ask there.
        hello: What the socket tells of the instance by itself, without the loop.
        watched: What can be watched of the run; None for nothing.
        metrics: Returns the figures of the run, likewise without the loop.
        idle_max_s: How long a client may send nothing, or read nothing.
    """

    def __init__(
        self,
        path: Path,
        hello: Callable[[], object],
        *,
        watched: Watched | None = None,
        metrics: Callable[[], object] = list,
        idle_max_s: float = IDLE_MAX_S,
    ) -> None:
        self.path = path
        self.hello = hello
        self.watched = watched
        self.metrics = metrics
        self.idle_max_s = idle_max_s
        self.speaking = threading.Lock()  # one thread at a time takes the processor from the loop
        self._asked: deque[Asked] = deque()
        self._server: _SocketServer | None = None

    def open(self) -> None:
        """Begin to listen; `ControlError` if that is impossible, or another user could listen there in our place."""
        check_folder(self.path.parent.resolve())
        try:
            self._server = _SocketServer(self)
        except OSError as error:
            raise ControlError(f"{self.path}: cannot listen there: {error.strerror or error}") from error

    def take(self) -> list[Asked]:
        """Return the requests that have come since the last call, oldest first. Never waits."""
        return [self._asked.popleft() for _ in range(len(self._asked))]

    def close(self) -> None:
        """Cease to listen, and hang up on everyone. May be called any number of times."""
        server, self._server = self._server, None
        if server is not None:
            server.end()
            self.path.unlink(missing_ok=True)

    def put(self, request: messages.Request, answer: Answer) -> None:
        """Let a request wait for the loop; `ControlError` if too many wait already."""
        if len(self._asked) >= WAITING_MAX:
            raise ControlError(f"{WAITING_MAX} requests wait already; try again later")
        self._asked.append(Asked(request, answer))


class _Handler(socketserver.StreamRequestHandler):
    """Serves one connection: line by line, one answer after the other."""

    server: _SocketServer

    def setup(self) -> None:
        """Limit how long one read, and one write, may take."""
        super().setup()
        self.request.settimeout(self.server.control.idle_max_s)
        self.thread, self.is_closed = threading.current_thread(), False
        self.replies: queue.SimpleQueue[messages.Reply | Callable[[], messages.Reply]] = queue.SimpleQueue()
        self.server.handlers.add(self)

    def finish(self) -> None:
        """Note that it is over."""
        self.server.handlers.discard(self)
        super().finish()

    def hang_up(self) -> None:
        """Let its thread end, whatever it waits for: the client, or the loop."""
        self.is_closed = True
        with suppress(OSError):  # the client is gone already
            self.request.shutdown(socket.SHUT_RDWR)
        self.replies.put(messages.Reply(error="the connection was closed"))

    def handle(self) -> None:
        """Answer every line. What is raised here ends this connection, and no other."""
        while (line := self.rfile.readline(messages.LINE_MAX_BYTES + 1)).endswith(b"\n"):
            if line.strip() and not self._answer(line):
                return
        if len(line) > messages.LINE_MAX_BYTES:
            self.wfile.write(
                messages.Reply(error=f"a line of more than {messages.LINE_MAX_BYTES} bytes is no request").line(None)
            )

    def _answer(self, line: bytes) -> bool:
        """Answer a line; return whether more may be asked on this connection."""
        with self.server.control.speaking:
            transaction = messages.transaction_of(line)
            try:
                end = self._begin(messages.parse_request(line))
            except ControlError as error:
                end = None
                self.replies.put(messages.Reply(error=str(error)))
        if end is None:
            # Without an answer in time the connection ends: the next request would be given the one that is too late.
            self._write(self.replies.get(timeout=ANSWER_MAX_S), transaction)
            return True
        try:
            self.request.settimeout(min(UNREAD_MAX_S, self.server.control.idle_max_s))
            while not self.is_closed:
                self._write(self.replies.get(), transaction)
        finally:
            end()
        return False

    def _begin(self, request: messages.Request) -> Callable[[], None] | None:
        """See to it that a request will be answered; return what ends a subscription, None for any other request."""
        control, answer = self.server.control, self.replies.put
        if request.op == "subscribe":
            return self._watched().subscribe(request.args, answer)
        if request.op == "frame":
            answer(partial(self._watched().frame, request.args))
        elif request.op == "hello":
            answer(messages.Reply(control.hello()))
        elif request.op == "metrics":
            answer(lambda: messages.Reply(control.metrics()))
        else:
            control.put(request, answer)
        return None

    def _watched(self) -> Watched:
        watched = self.server.control.watched
        if watched is None:
            raise ControlError("this run cannot be watched")
        return watched

    def _write(self, reply: messages.Reply | Callable[[], messages.Reply], transaction: messages.Transaction) -> None:
        """Write the line of an answer, and what follows it."""
        with self.server.control.speaking:
            known = reply if isinstance(reply, messages.Reply) else make_reply(reply)
            line = known.line(transaction)
        self.wfile.write(line)
        if known.attached:
            self.wfile.write(known.attached)


class _SocketServer(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    """Accepts connections, in a thread of its own, and serves each in one that keeps no process alive."""

    request_queue_size = 128
    daemon_threads = True
    block_on_close = False

    def __init__(self, control: ControlSocket) -> None:
        self.control = control
        self.handlers: set[_Handler] = set()
        super().__init__(os.fspath(control.path), _Handler)
        self._thread = threading.Thread(target=self.serve_forever, args=(60.0,), name="control socket", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Close everything, and wait a moment for the threads."""
        self.socket.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        self.shutdown()
        self._thread.join()
        self.server_close()
        until_s = time.monotonic() + END_WAIT_S
        handlers = list(self.handlers)
        for handler in handlers:
            handler.hang_up()
        for handler in handlers:
            handler.thread.join(max(0.0, until_s - time.monotonic()))

    def server_bind(self) -> None:
        """Bind the socket for our user alone; one that a killed run left behind is replaced."""
        path = self.control.path
        if path.is_socket() and not is_alive(path):
            path.unlink()
        super().server_bind()
        path.chmod(stat.S_IRUSR | stat.S_IWUSR)  # no client can connect before `listen`

    def get_request(self) -> tuple[Any, Any]:
        """Accept a connection."""
        try:
            return super().get_request()
        except OSError:
            time.sleep(RETRY_S)
            raise

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: the connection is closed, and what clients send must not fill a log."""


def make_reply(reply: Callable[[], messages.Reply]) -> messages.Reply:
    """Return the answer of a function; if it fails, an error that says so."""
    try:
        return reply()
    except BaseException as error:  # noqa: BLE001 - a defect in an answer is said to whoever asked
        return messages.Reply(error=f"the answer could not be put into words: {type(error).__name__}: {error}")
