"""The page of a run, as a process beside it: started, watched and ended, and nothing else.

The page asks the run at its control socket like any other program. If it dies, it is started again, after waits that
grow; the run does not depend on it. It lives through a restart of the run, which keeps its process id: the program that
begins anew finds the page by what the old one left in the environment.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from stadimeter.app.restarts import ENV_PAGE_LEFT, ENV_PARENT_RUN_PID, ENV_RESTARTED

if TYPE_CHECKING:
    from stadimeter.config.models import WebTable

# Before a page that ended is started again: the first wait, doubled each time, up to the longest.
FIRST_WAIT_S = 1.0
MAX_WAIT_S = 60.0

# After a page that lived this long, the waits begin anew.
PROVEN_S = 60.0

# A page that is asked to end has this long; then it is killed. Its workbench ends by the end of its input then.
END_WAIT_S = 0.8

# No more characters of a line of the page are told.
LINE_MAX = 500

# Begins the line in which a page says where it is.
READY = "The page: "

UNBUFFERED = {"PYTHONUNBUFFERED": "1"}

# These variables of the environment are about this process, and not the page's.
_ENV_OF_THIS_PROCESS = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", ENV_RESTARTED, ENV_PAGE_LEFT)


def page_command(configuration: Path, socket: Path, web: WebTable) -> list[str]:
    """Return the command line of a page."""
    command = [sys.executable, "-m", "stadimeter", "web", str(configuration), "--socket", str(socket)]
    command += ["--port", str(web.port)]
    for option, value in (
        ("--address", web.host),
        ("--certificate", web.certificate),
        ("--key", web.key),
        ("--password-file", web.password_file),
    ):
        command += [option, str(value)] if value is not None else []
    return command + [word for name in web.allowed_hosts for word in ("--allow-host", name)]


class PageProcess:
    """Keeps a page running.

    Args:
        tell: Takes a line that a person should read: where the page is, or why it ended. Called in a thread.
    """

    def __init__(self, command: Sequence[str], tell: Callable[[str], None]) -> None:
        self._command = list(command)
        self._tell = tell
        self._told = ""
        self._is_over = threading.Event()
        self._lock = threading.Lock()
        self._pid = 0  # of the page; 0 for none
        self._words = -1  # what the page says, as a file descriptor
        self._left = os.environ.pop(ENV_PAGE_LEFT, "").split()
        self._thread = threading.Thread(target=self._keep, name="page", daemon=True)

    def start(self) -> None:
        """Start the page, or go on with that of the program which this one has replaced. Returns at once."""
        self._thread.start()

    def end(self) -> None:
        """End the page, and wait a moment for it. May be called any number of times."""
        self._is_over.set()
        for number in (signal.SIGTERM, signal.SIGKILL):
            with self._lock:
                if self._pid:
                    os.kill(self._pid, number)
            self._thread.join(END_WAIT_S)

    def end_left(self) -> None:
        """End the page of the program that this one has replaced, and start none."""
        self._is_over.set()
        self.start()
        self.end()

    def hand_on(self) -> None:
        """Leave the page to the program that replaces this one."""
        self._is_over.set()
        with self._lock:
            if self._pid:
                os.environ[ENV_PAGE_LEFT] = f"{self._words} {self._pid} {_digest(self._command)}"

    def _keep(self) -> None:
        wait_s = FIRST_WAIT_S
        self._take_over()
        while not self._is_over.is_set():
            began_s = time.monotonic()
            said = self._begin_and_hear()
            if self._is_over.is_set():
                return
            if time.monotonic() - began_s > PROVEN_S:
                wait_s = FIRST_WAIT_S
            self._say(f"warning: the page has ended and is started again: {said or 'it did not say why'}")
            self._is_over.wait(wait_s)
            wait_s = min(2 * wait_s, MAX_WAIT_S)

    def _take_over(self) -> None:
        """Go on with the page of the program that this one has replaced, if it is the same; else end that one."""
        if len(self._left) != 3:
            return
        words, pid, digest = int(self._left[0]), int(self._left[1]), self._left[2]
        try:
            os.set_inheritable(words, False)
        except OSError:  # it ended while it was handed on
            return
        self._words, self._pid = words, pid
        if digest != _digest(self._command):
            os.kill(self._pid, signal.SIGTERM)
            self._hear()

    def _begin_and_hear(self) -> str:
        """Start the page if there is none, hear it until it ends, and return what it said last."""
        with self._lock:
            if self._is_over.is_set():
                return ""
            if not self._pid:
                try:
                    self._words, self._pid = _begun(self._command)
                except OSError as error:  # no memory, or no process, is left for it just now
                    return f"it cannot be started: {error.strerror or error}"
        return self._hear()

    def _hear(self) -> str:
        said = ""
        with open(self._words, encoding="utf-8", errors="replace") as lines:  # noqa: PTH123 - a descriptor
            while line := lines.readline(LINE_MAX):
                said = line.strip() or said
                if said.startswith(READY):
                    self._say(said)
        with self._lock:
            with suppress(ChildProcessError):
                os.waitpid(self._pid, 0)
            self._pid = 0
        return said.removeprefix("error: ")

    def _say(self, words: str) -> None:
        """Tell what is news."""
        if words != self._told:
            self._told = words
            self._tell(words)


def _begun(command: list[str]) -> tuple[int, int]:
    """Start a page; return what it says, as a file descriptor, and its process id."""
    environment = {name: value for name, value in os.environ.items() if name not in _ENV_OF_THIS_PROCESS}
    environment |= {**UNBUFFERED, ENV_PARENT_RUN_PID: str(os.getpid())}
    words, end = os.pipe()
    actions = [
        (os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0),
        (os.POSIX_SPAWN_DUP2, end, 1),
        (os.POSIX_SPAWN_DUP2, end, 2),
    ]
    try:
        return words, os.posix_spawn(command[0], command, environment, file_actions=actions, setpgroup=0)
    except OSError:
        os.close(words)
        raise
    finally:
        os.close(end)


def _digest(command: Sequence[str]) -> str:
    return sha256("\0".join(command).encode()).hexdigest()
