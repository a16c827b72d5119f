"""The Unix socket at which a running instance can be asked.

A thread of its own accepts, reads, checks and answers; all that the control loop does is to take the requests that are
sound and to hand back answers. Whatever comes in at the socket, the loop never waits for it: lines are limited, and so
are connections, requests that wait, and answers that nobody reads.
"""

from __future__ import annotations

import os
import selectors
import socket
import stat
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from stadimeter.app.control.connection import Connection
from stadimeter.app.control.messages import (
    PlainRequest,
    Reply,
    Request,
    Transaction,
    parse_request,
    transaction_of,
)
from stadimeter.app.control.places import is_alive
from stadimeter.errors import ControlError

CONNECTIONS_MAX = 16
WAITING_MAX = 64
"""So many requests may wait for the loop, which takes them all once a cycle."""
IDLE_MAX_S = 60.0
"""A connection on which nothing is said for this long is closed."""

Answer = Callable[[Reply | Callable[[], Reply]], None]
"""Sends the answer to a request. May be called from any thread, once; it never waits. An answer that takes long to put
into words is given as a function, which is called in the thread of the socket."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A request, and how to answer it.

    Attributes:
        request: What is asked for.
        answer: Sends the answer.
    """

    request: Request
    answer: Answer


class ControlSocket:
    """Listens at a Unix socket.

    Args:
        path: Where; only our user may ask there.
        hello: What the socket tells of the instance by itself, without the loop.
        idle_max_s: How long a connection may say nothing.
    """

    def __init__(self, path: Path, hello: Callable[[], object], *, idle_max_s: float = IDLE_MAX_S) -> None:
        self.path = path
        self._hello = hello
        self._idle_max_s = idle_max_s
        self._asked: deque[Asked] = deque()
        self._answers: deque[tuple[Connection, Transaction, Reply | Callable[[], Reply]]] = deque()
        self._connections: dict[int, Connection] = {}
        self._selector = selectors.DefaultSelector()
        self._listener: socket.socket | None = None
        self._wake, self._woken = socket.socketpair()
        self._is_closing = False
        self._thread = threading.Thread(target=self._serve, name="control socket", daemon=True)

    def open(self) -> None:
        """Begin to listen.

        Raises:
            ControlError: It cannot be listened there.
        """
        try:
            self._listener = _listening(self.path)
        except OSError as error:
            raise ControlError(f"{self.path}: cannot listen there: {error.strerror or error}") from error
        self._woken.setblocking(False)
        self._wake.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._thread.start()

    def take(self) -> list[Asked]:
        """Return the requests that have come since the last call. Never waits.

        Returns:
            The requests, oldest first.
        """
        if not self._asked:
            return []
        return [self._asked.popleft() for _ in range(len(self._asked))]

    def close(self) -> None:
        """Cease to listen, and close every connection. May be called any number of times."""
        if self._is_closing:
            return
        self._is_closing = True
        if self._listener is not None:
            self._rouse()
            self._thread.join()
            self.path.unlink(missing_ok=True)
        self._wake.close()
        self._woken.close()
        self._selector.close()

    def _rouse(self) -> None:
        try:
            self._wake.send(b"x")
        except OSError:  # it is being roused already, or is closed
            return

    def _serve(self) -> None:
        while not self._is_closing:
            for key, events in self._selector.select(1.0 if self._connections else None):
                if key.fileobj is self._listener:
                    self._accept(self._listener)
                elif key.fileobj is self._woken:
                    self._woken.recv(4096)
                elif connection := self._connections.get(key.fd):
                    self._attend(connection, events)
            self._pass_on_answers()
            self._close_idle()
        self._end()

    def _end(self) -> None:
        self._pass_on_answers()
        for connection in list(self._connections.values()):
            self._drop(connection)
        if self._listener is not None:
            self._listener.close()

    def _accept(self, listener: socket.socket) -> None:
        try:
            accepted, _ = listener.accept()
        except OSError:  # whoever it was is gone, or we have no file descriptors left
            return
        connection = Connection(accepted)
        self._connections[accepted.fileno()] = connection
        with self._served(connection):
            if len(self._connections) > CONNECTIONS_MAX:
                connection.refuse(f"{CONNECTIONS_MAX} others are connected already; try again later")

    @contextmanager
    def _served(self, connection: Connection) -> Iterator[None]:
        """Do something with a connection. Afterwards wait for what it needs then, or close it."""
        try:
            yield
        except OSError:  # the other end is gone
            self._drop(connection)
            return
        if connection.is_done:
            self._drop(connection)
        elif connection.socket.fileno() in self._connections:
            self._watch(connection)

    def _attend(self, connection: Connection, events: int) -> None:
        with self._served(connection):
            if events & selectors.EVENT_WRITE:
                connection.flush()
            if not events & selectors.EVENT_READ:
                return
            try:
                lines = connection.lines()
            except ControlError as error:
                connection.refuse(str(error))
                return
            for line in lines:
                self._hear(connection, line)

    def _hear(self, connection: Connection, line: bytes) -> None:
        """Take in one line: answer it, or leave it to the loop."""
        transaction = transaction_of(line)
        try:
            request = parse_request(line)
        except ControlError as error:
            connection.say(Reply(error=str(error)).line(transaction))
            return
        if isinstance(request, PlainRequest) and request.op == "hello":
            connection.say(Reply(self._hello()).line(transaction))
        elif len(self._asked) >= WAITING_MAX:
            connection.say(Reply(error=f"{WAITING_MAX} requests wait already; try again later").line(transaction))
        else:
            connection.unanswered += 1
            self._asked.append(Asked(request, lambda reply: self._answer(connection, transaction, reply)))

    def _answer(self, connection: Connection, transaction: Transaction, reply: Reply | Callable[[], Reply]) -> None:
        self._answers.append((connection, transaction, reply))
        self._rouse()

    def _pass_on_answers(self) -> None:
        while self._answers:
            connection, transaction, reply = self._answers.popleft()
            connection.unanswered -= 1
            if self._connections.get(connection.socket.fileno()) is connection:
                with self._served(connection):
                    connection.say((reply if isinstance(reply, Reply) else _put_into_words(reply)).line(transaction))

    def _watch(self, connection: Connection) -> None:
        """Wait for what the connection needs: nothing at all while only the loop's answer is missing."""
        is_watched = connection.socket in self._selector.get_map()
        if connection.events and is_watched:
            self._selector.modify(connection.socket, connection.events)
        elif connection.events:
            self._selector.register(connection.socket, connection.events)
        elif is_watched:
            self._selector.unregister(connection.socket)

    def _close_idle(self) -> None:
        earliest_s = time.monotonic() - self._idle_max_s
        for connection in list(self._connections.values()):
            if connection.heard_s < earliest_s and connection.unanswered == 0:
                self._drop(connection)

    def _drop(self, connection: Connection) -> None:
        if self._connections.pop(connection.socket.fileno(), None) is None:
            return
        if connection.socket in self._selector.get_map():
            self._selector.unregister(connection.socket)
        connection.socket.close()


def _put_into_words(reply: Callable[[], Reply]) -> Reply:
    try:
        return reply()
    except Exception as error:  # noqa: BLE001 - a defect in an answer must not end all other conversations
        return Reply(error=f"the answer could not be put into words: {type(error).__name__}: {error}")


def _listening(path: Path) -> socket.socket:
    """Return a socket that listens, for our user alone. One that nobody listens at any more is replaced."""
    if path.is_socket() and not is_alive(path):
        path.unlink()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(os.fspath(path))
        path.chmod(stat.S_IRUSR | stat.S_IWUSR)  # nobody can connect before `listen`
        listener.listen()
        listener.setblocking(False)
    except BaseException:
        listener.close()
        raise
    return listener
