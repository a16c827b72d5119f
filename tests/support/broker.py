"""A real broker for tests: mosquitto on a free port of the loopback interface. Without one, its tests are skipped."""

from __future__ import annotations

import random
import socket
import subprocess
import time
from contextlib import suppress
from pathlib import Path

from msgspec import Struct

from support.programs import path_of, require

HOST = "127.0.0.1"
START_S = 120.0


class BrokerAccess(Struct, frozen=True, kw_only=True):
    """Who may do what at a test broker.

    Attributes:
        username: The only user; None lets everybody in.
        acl: Lines of an access list; empty for none.
        certificate: The broker's certificate, for TLS; None for none.
    """

    username: str | None = None
    password: str = ""
    acl: str = ""
    certificate: Path | None = None
    key: Path | None = None


def free_port() -> int:
    """Return a port of the loopback interface that nobody listens on.

    It is below those that the kernel gives to whoever connects: none of these takes it before it is listened on.
    """
    while True:
        port = random.SystemRandom().randrange(15_000, 32_000)
        with suppress(OSError), socket.socket() as probe:
            probe.bind((HOST, port))
            return port


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
    """A mosquitto of our own. It can be started again on the same port, and forgets everything in between.

    Args:
        folder: Where its files are written.
        access: Who may do what; everybody everything if not given.
    """

    def __init__(self, folder: Path, access: BrokerAccess | None = None) -> None:
        require("mosquitto")
        access = access or BrokerAccess()
        self.port = free_port()
        self._file = folder / f"mosquitto-{self.port}.conf"
        self._log = folder / f"mosquitto-{self.port}.log"
        self._process: subprocess.Popen[bytes] | None = None
        self._file.write_text("\n".join(self._configuration(folder, access)) + "\n")

    def start(self) -> None:
        """Start; return when it accepts connections."""
        program = path_of("mosquitto")
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
