"""A network cable for tests: TCP on the loopback interface that can be cut, mended and clogged."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable
from contextlib import suppress

from support.broker import HOST, free_port

MQTT_5_BEGINS = re.compile(rb"\x10[\x80-\xff]{0,3}[\x00-\x7f]\x00\x04MQTT\x05")
"""What a program that speaks MQTT 5 sends first: CONNECT, its length, the protocol's name and version."""


class Tunnel:
    """Carries connections to a server's port until it is cut.

    Args:
        target_port: The server's port.
        is_mqtt_5_unanswered: Whether a program that speaks MQTT 5 is never answered, as old brokers do.
    """

    def __init__(self, target_port: int, *, is_mqtt_5_unanswered: bool = False) -> None:
        self._is_mqtt_5_unanswered = is_mqtt_5_unanswered
        self.port = free_port()
        self._target_port = target_port
        self._flows = threading.Event()
        self._sockets: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._lock = threading.Lock()
        self._is_cut = True

    def mend(self) -> None:
        """Carry connections."""
        listener = socket.create_server((HOST, self.port))
        self._flows.set()
        self._is_cut = False
        self._sockets.append(listener)
        self._begin(self._accept, listener)

    def cut(self) -> None:
        """Break every connection without a word, and refuse new ones. Does nothing when cut."""
        with self._lock:
            self._is_cut = True
            for one in self._sockets:
                _shut(one)
        self._flows.set()
        for thread in self._threads:
            thread.join()
        for one in self._sockets:
            one.close()
        self._sockets.clear()
        self._threads.clear()

    def clog(self) -> None:
        """Keep the connections but let nothing through, until cut."""
        self._flows.clear()

    def _begin(self, run: Callable[..., None], *args: socket.socket) -> None:
        thread = threading.Thread(target=run, args=args, name="tunnel", daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                near, _ = listener.accept()
            except OSError:  # it was cut
                return
            try:
                far = socket.create_connection((HOST, self._target_port))
            except OSError:  # the server is away
                near.close()
                continue
            with self._lock:
                self._sockets += [near, far]
                if self._is_cut:
                    return
                self._begin(self._carry, near, far)
                self._begin(self._carry, far, near)

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                if self._is_mqtt_5_unanswered and MQTT_5_BEGINS.match(data):
                    continue
                self._flows.wait()
                sink.sendall(data)
        self._flows.wait()  # nothing comes through a clogged cable, so no end does
        _shut(source)
        _shut(sink)


def _shut(one: socket.socket) -> None:
    with suppress(OSError):  # it may be shut already
        one.shutdown(socket.SHUT_RDWR)
