"""The run that the page starts when there is none: a process of its own, which the page ends when it ends itself.

If the page is killed, the run's standard input ends and so does the run: no output goes on that no one could end.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import tempfile
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from stadimeter.errors import PageError
from stadimeter.web import python
from stadimeter.web.exchange import end_process
from stadimeter.web.run_link import RunLink

# Loading takes a small Pi many seconds, and some cameras take five to open.
START_MAX_S = 45.0

ASK_EVERY_S = 0.1
END_WAIT_S = 5.0
SAID_MAX_BYTES = 4000


class RunProcess:
    """Starts a run, and ends the one that it started.

    Args:
        link: Tells when it can be asked.
        environ: Tells whether a service has started us, which starts the run too.
    """

    def __init__(self, link: RunLink, environ: Mapping[str, str] = os.environ) -> None:
        self._link = link
        self._is_of_service = _is_of_service(environ)
        self._process: Process | None = None
        self._last_pid = 0  # of the process that answered last as the run
        self._said: Any = None
        self._files = ExitStack()
        self._turn = asyncio.Lock()

    @property
    def may_start(self) -> bool:
        """True if the page can start a run: not where systemd does, nor beside another's that hangs or begins anew."""
        return not self._is_of_service and not self._is_anothers_there()

    async def start(self) -> Any:
        """Start the run and return what it says of itself; `PageError` says why it did not start."""
        async with self._turn:
            if await self._is_running():
                raise PageError(409, "is-running", "the run is there already")
            if self._is_anothers_there():
                raise PageError(409, "is-running", self._silent())
            if self._is_of_service:
                words = "the service starts the run: `sudo systemctl start stadimeter`"
                raise PageError(409, "is-service", words)
            return await self._start()

    def explain(self, error: PageError) -> PageError:
        """Say more of why no run can be asked: nothing is set up yet, or what the one that we started said last."""
        if error.code != "no-run":
            return error
        if not self._link.configuration.exists():
            return PageError(503, "no-configuration", "Nothing is set up yet.")
        if self._is_anothers_there():
            return PageError(503, "no-answer", self._silent())
        if self._process is not None and (self._process.returncode or 0) > 0:
            return PageError(503, "no-run", f"the run has ended: {_last_words(self._said)}")
        return error

    async def end(self) -> None:
        """End the run that we started, as Ctrl-C does; kill it if it does not end."""
        process, self._process = self._process, None
        self._files.close()
        if process is not None and process.returncode is None:
            await end_process(process, process.terminate, END_WAIT_S)

    async def about(self) -> dict[str, Any]:
        """Return the run's own description, started here or elsewhere; `PageError` if none answers."""
        told: dict[str, Any] = (await self._link.ask("hello")).data
        self._last_pid = told.get("pid", 0)
        return told

    async def _is_running(self) -> bool:
        try:
            await self.about()
        except PageError:
            return False
        return True

    def _silent(self) -> str:
        words = "is there, but does not answer: wait until it has begun anew; if it hangs, end it first"
        return f"the run (process {self._last_pid}) {words}"

    def _is_anothers_there(self) -> bool:
        """Check whether a run that was not started here exists, and may answer nothing."""
        is_ours = self._process is not None and self._process.pid == self._last_pid
        return not is_ours and _is_run(self._last_pid)

    async def _start(self) -> Any:
        await self.end()
        configuration = self._link.configuration
        if not configuration.exists():
            raise PageError(409, "no-configuration", f"{configuration} is not there yet: set it up and save it first")
        self._said = said = self._files.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 - closed by end()
        self._process = process = await _start_run(configuration, said)
        try:
            async with asyncio.timeout(START_MAX_S):
                while process.returncode is None:
                    with suppress(PageError):
                        return await self.about()
                    await asyncio.sleep(ASK_EVERY_S)
        except TimeoutError as error:
            words = f"the run was started, but cannot be asked after {START_MAX_S:g} s: {_tail(said)}"
            raise PageError(503, "no-answer", words) from error
        raise PageError(409, "not-started", f"the run did not start: {_tail(said)}")


def _is_of_service(environ: Mapping[str, str]) -> bool:
    """Check whether systemd has started us; not a desktop's terminal, which is often a service itself."""
    started = environ.get("SYSTEMD_EXEC_PID")  # as of version 248
    return "INVOCATION_ID" in environ and started in {None, str(os.getpid())}


def _is_run(pid: int) -> bool:
    """Check whether a process is one of ours. One that restarts keeps its number, one that ended has no words."""
    try:
        return b"stadimeter" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


async def _start_run(configuration: Path, said: Any) -> Process:
    command = [*python("stadimeter"), "run", str(configuration), "--end-with-input"]
    try:
        return await asyncio.create_subprocess_exec(
            *command,
            stdin=PIPE,
            stdout=DEVNULL,
            stderr=said,
            start_new_session=True,
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise PageError(503, "not-started", f"the run cannot be started: {error}") from error


def _tail(said: Any) -> str:
    """Return the end of what a process said on standard error."""
    said.seek(0, os.SEEK_END)
    said.seek(max(0, said.tell() - SAID_MAX_BYTES))
    text = said.read().decode("utf-8", "replace").strip()
    return text.removeprefix("error: ") or "it said nothing"


def _last_words(said: Any) -> str:
    """Return the last error that a process said on standard error, else its last line."""
    before, _, last = _tail(said).rpartition("\nerror: ")
    return last if before else last.splitlines()[-1]
