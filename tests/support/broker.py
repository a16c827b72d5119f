"""Real MQTT brokers for tests, on a free port of the loopback interface.

mosquitto where it is installed; else amqtt, which is written in Python and speaks MQTT 3.1.1 only.
"""

from __future__ import annotations

import asyncio
import shutil
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, Protocol

from msgspec import Struct

HOST = "127.0.0.1"
START_S = 120.0


class BrokerAccess(Struct, frozen=True, kw_only=True):
    """Who may do what at a test broker.

    Attributes:
        username: The only user; None lets everybody in.
        acl: Lines of a mosquitto access list; empty for none. Only mosquitto heeds it.
        certificate: The broker's certificate, for TLS; None for none. Only mosquitto heeds it.
    """

    username: str | None = None
    password: str = ""
    acl: str = ""
    certificate: Path | None = None
    key: Path | None = None


class LoopbackBroker(Protocol):
    """A broker that can be stopped, and started again on the same port. It forgets everything in between."""

    port: int

    def start(self) -> None:
        """Start; return when it accepts connections."""
        ...

    def stop(self) -> None:
        """Stop. Does nothing if it does not run."""
        ...


def mosquitto_program() -> str | None:
    """Return the path of mosquitto, or None where it is not installed."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")


def free_port() -> int:
    """Return a port of the loopback interface that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port: int = probe.getsockname()[1]
    return port


def make_broker(folder: Path, access: BrokerAccess | None = None) -> LoopbackBroker:
    """Make the best broker that this machine has; it is not started yet.

    Args:
        access: Who may do what; everybody everything if not given.
    """
    access = access or BrokerAccess()
    return MosquittoBroker(folder, access) if mosquitto_program() else AmqttBroker(folder, access)


def _wait_for(port: int) -> None:
    until_s = time.monotonic() + START_S
    while True:
        try:
            socket.create_connection((HOST, port), timeout=START_S).close()
        except OSError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.01)
        else:
            return


class MosquittoBroker:
    """A mosquitto of our own."""

    def __init__(self, folder: Path, access: BrokerAccess) -> None:
        self.port = free_port()
        self._file = folder / f"mosquitto-{self.port}.conf"
        self._log = folder / f"mosquitto-{self.port}.log"
        self._process: subprocess.Popen[bytes] | None = None
        self._file.write_text("\n".join(self._configuration(folder, access)) + "\n")

    def start(self) -> None:
        """Start; return when it accepts connections."""
        program = mosquitto_program()
        assert program is not None
        with self._log.open("ab") as log:
            self._process = subprocess.Popen([program, "-c", str(self._file)], stdout=log, stderr=log)
        try:
            _wait_for(self.port)
        except OSError:
            self.stop()
            raise RuntimeError(f"mosquitto does not start:\n{self._log.read_text()}") from None

    def stop(self) -> None:
        """Stop. Does nothing if it does not run."""
        if self._process is not None:
            self._process.kill()  # it has nothing to save, and takes its time to end otherwise
            self._process.wait(START_S)
            self._process = None

    def _configuration(self, folder: Path, access: BrokerAccess) -> list[str]:
        # As root, mosquitto would become another user, who may not read the test's folder.
        lines = [f"listener {self.port} {HOST}", "persistence false", "user root", "log_dest stderr"]
        lines.append("set_tcp_nodelay true")
        lines.append(f"allow_anonymous {'true' if access.username is None else 'false'}")
        if access.username is not None:
            passwords = folder / f"mosquitto-{self.port}.passwords"
            passwords.write_text(f"{access.username}:{access.password}\n")
            subprocess.run(["mosquitto_passwd", "-U", str(passwords)], check=True)
            lines.append(f"password_file {passwords}")
        if access.acl:
            acl = folder / f"mosquitto-{self.port}.acl"
            acl.write_text(access.acl)
            lines.append(f"acl_file {acl}")
        if access.certificate is not None:
            lines += [f"certfile {access.certificate}", f"keyfile {access.key}"]
        return lines


class AmqttBroker:
    """An amqtt broker in a thread.

    Args:
        access: Who may do what; without access list and TLS.
    """

    def __init__(self, folder: Path, access: BrokerAccess) -> None:
        if access.acl or access.certificate:
            raise ValueError("the amqtt broker is set up here without access lists and TLS; this needs mosquitto")
        self.port = free_port()
        self._plugins = self._login(folder, access)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._broker: Any = None
        self._connections: set[asyncio.StreamWriter] = set()

    def start(self) -> None:
        """Start; return when it accepts connections."""
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="amqtt", daemon=True)
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._start(), self._loop).result(START_S)

    def stop(self) -> None:
        """Stop. Does nothing if it does not run."""
        if self._loop is None or self._thread is None:
            return
        asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result(START_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(START_S)
        self._loop.close()
        self._loop = self._thread = self._broker = None

    async def _start(self) -> None:
        # A library for tests only, and only where mosquitto is missing.
        from amqtt.broker import Broker  # type: ignore[import-untyped]

        connections = self._connections

        class TidyBroker(Broker):  # type: ignore[misc] # a class of that library
            """Knows every connection, also those that did not get as far as a session."""

            async def stream_connected(
                self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, listener_name: str
            ) -> None:
                connections.add(writer)
                try:
                    await super().stream_connected(reader, writer, listener_name)
                finally:
                    writer.transport.abort()
                    connections.discard(writer)

        listeners = {"default": {"type": "tcp", "bind": f"{HOST}:{self.port}"}}
        self._broker = TidyBroker({"listeners": listeners, "plugins": self._plugins})
        await self._broker.start()

    async def _stop(self) -> None:
        # Without this, amqtt now and then waits for ever for a connection that swallowed its cancellation.
        for writer in list(self._connections):
            writer.transport.abort()
        await self._broker.shutdown()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def _login(self, folder: Path, access: BrokerAccess) -> dict[str, dict[str, Any]]:
        if access.username is None:
            return {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}}
        from pwdlib.hashers.argon2 import Argon2Hasher

        passwords = folder / f"amqtt-{self.port}.passwords"
        passwords.write_text(f"{access.username}:{Argon2Hasher(time_cost=1).hash(access.password)}\n")
        return {"amqtt.plugins.authentication.FileAuthPlugin": {"password_file": str(passwords)}}
