"""The run that the page starts when there is none: a process of its own, which the page ends when it ends itself.

If the page is killed, the run notices that and ends by itself: no output goes on that no one could end.
"""

from __future__ import annotations

import asyncio
import os
import select
import subprocess
import tempfile
from asyncio.subprocess import DEVNULL, Process
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from stadimeter.app.restarts import ENV_PARENT_PAGE_PID, ENV_PARENT_RUN_PID
from stadimeter.errors import PageError
from stadimeter.web import python
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
        self._last_run = _LastRun()
        self._said: Any = None
        self._files = ExitStack()
        self._turn = asyncio.Lock()

    @property
    def may_start(self) -> bool:
        """Whether the page starts runs: not where systemd does."""
        return not self._is_of_service

    async def start(self) -> Any:
        """Start the run and return what it says of itself; `PageError` says why it did not start."""
        async with self._turn:
            if await self._is_running():
                raise PageError(409, "is-running", "the run is there already")
            if self._last_run.is_there() and not self._is_ours(self._last_run.pid):
                words = "is there, but does not answer: wait until it has begun anew; if it hangs, end it first"
                raise PageError(409, "is-running", f"the run (process {self._last_run.pid}) {words}")
            if self._is_of_service:
                words = "the service starts the run: `sudo systemctl start stadimeter`"
                raise PageError(409, "is-service", words)
            return await self._started()

    def explained(self, error: PageError) -> PageError:
        """Say more of why no run can be asked: nothing is set up yet, or what the one that we started said last."""
        if error.code != "no-run":
            return error
        if not self._link.configuration.exists():
            return PageError(503, "no-configuration", "Nothing is set up yet.")
        if self._process is not None and (self._process.returncode or 0) > 0:
            return PageError(503, "no-run", f"the run has ended: {_last_words(self._said)}")
        return error

    async def end(self) -> None:
        """End the run that we started, as Ctrl-C does; kill it if it does not end."""
        process, self._process = self._process, None
        self._files.close()
        if process is None or process.returncode is not None:
            return
        with suppress(ProcessLookupError):
            process.terminate()
        try:
            async with asyncio.timeout(END_WAIT_S):
                await process.wait()
        except TimeoutError:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    async def about(self) -> dict[str, Any]:
        """Return what the run says of itself, started here or elsewhere; `PageError` if none answers."""
        told: dict[str, Any] = (await self._link.ask("hello")).data
        self._last_run.see(told.get("pid", 0))
        return told

    async def _is_running(self) -> bool:
        try:
            await self.about()
        except PageError:
            return False
        return True

    def _is_ours(self, pid: int) -> bool:
        return self._process is not None and self._process.pid == pid

    async def _started(self) -> Any:
        await self.end()
        configuration = self._link.configuration
        if not configuration.exists():
            raise PageError(409, "no-configuration", f"{configuration} is not there yet: set it up and save it first")
        self._said = said = self._files.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 - closed by end()
        self._process = process = await _begun(configuration, said)
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
    """Return whether systemd has started us, or our run; not a desktop's terminal, which is often a service itself."""
    if "INVOCATION_ID" not in environ:
        return False
    started = environ.get("SYSTEMD_EXEC_PID")  # as of version 248
    return started in {None, str(os.getpid()), environ.get(ENV_PARENT_RUN_PID)}


class _LastRun:
    """The process that answered last as the run. One that restarts keeps its number, and answers nothing meanwhile."""

    def __init__(self) -> None:
        self.pid = 0
        self._process = -1

    def see(self, pid: int) -> None:
        """Remember a process."""
        self._forget()
        with suppress(OSError):
            self.pid, self._process = pid, os.pidfd_open(pid)

    def is_there(self) -> bool:
        """Return whether it still is."""
        if self._process >= 0 and select.select([self._process], [], [], 0)[0]:
            self._forget()
        return self._process >= 0

    def _forget(self) -> None:
        if self._process >= 0:
            os.close(self._process)
        self.pid, self._process = 0, -1

    def __del__(self) -> None:
        self._forget()


async def _begun(configuration: Path, said: Any) -> Process:
    command = [*python("stadimeter"), "run", str(configuration)]
    try:
        return await asyncio.create_subprocess_exec(
            *command,
            stdin=DEVNULL,
            stdout=DEVNULL,
            stderr=said,
            start_new_session=True,
            env={**os.environ, ENV_PARENT_PAGE_PID: str(os.getpid())},
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
