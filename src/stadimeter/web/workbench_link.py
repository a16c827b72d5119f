"""The link to the workbench: starts its process when it is first needed, and asks over its pipe."""

from __future__ import annotations

import asyncio
from asyncio.subprocess import PIPE, Process
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stadimeter.errors import PageError
from stadimeter.web import python
from stadimeter.web.exchange import LINE_MAX_BYTES, UNREADABLE, PageAnswer, end_process, put, take

# The process ends after this long without a question: what it has loaded takes a small Pi a third of its memory.
IDLE_MAX_S = 300.0

# It is given this long to close its camera when it shall end.
END_WAIT_S = 2.0

# As many questions may wait for it; it answers one after the other.
WAITING_MAX = 32


class WorkbenchLink:
    """Asks the workbench process.

    Args:
        command: Starts it.
        idle_max_s: How long it is kept without a question.
    """

    def __init__(self, command: Sequence[str], idle_max_s: float = IDLE_MAX_S) -> None:
        self.idle_max_s = idle_max_s
        self._command = tuple(command)
        self._process: Process | None = None
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._idle: asyncio.TimerHandle | None = None
        self._work: set[asyncio.Task[Any]] = set()

    async def ask(self, op: str, args: Mapping[str, Any], wait_s: float) -> PageAnswer:
        """Ask for an operation; `PageError` if it is refused, takes too long, or its process dies."""
        if self._waiting >= WAITING_MAX:
            raise PageError(503, "busy", f"{WAITING_MAX} questions wait already for the workbench; try again later")
        self._waiting += 1
        # Whoever asked may hang up: the answer is read all the same, or it would be the next one's.
        return await asyncio.shield(self._begin(self._ask(op, args, wait_s)))

    async def close(self) -> None:
        """End the process; what it is still asked is not answered."""
        for work in self._work:
            work.cancel()
        await self._end()

    def _begin(self, work: Any) -> asyncio.Task[Any]:
        task = asyncio.create_task(work)
        self._work.add(task)
        task.add_done_callback(self._work.discard)
        return task

    async def _ask(self, op: str, args: Mapping[str, Any], wait_s: float) -> PageAnswer:
        try:
            async with self._turn:
                return await self._answer(op, args, wait_s)
        finally:
            self._waiting -= 1

    async def _answer(self, op: str, args: Mapping[str, Any], wait_s: float) -> PageAnswer:
        if self._idle is not None:
            self._idle.cancel()
        reader, writer = await self._streams()
        try:
            async with asyncio.timeout(wait_s):
                await put(writer, op, args)
                return await take(reader)
        except TimeoutError as error:
            await self._end(at_once=True)
            words = f"the workbench took longer than {wait_s:g} s for this, and was ended; try it again"
            raise PageError(503, "workbench-slow", words) from error
        except UNREADABLE as error:
            await self._end(at_once=True)
            words = "the workbench has ended unexpectedly; try it again, it is started anew"
            raise PageError(503, "workbench-gone", words) from error
        finally:
            self._idle = asyncio.get_running_loop().call_later(self.idle_max_s, self._rest)

    async def _streams(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        if self._process is None or self._process.returncode is not None:
            try:
                self._process = await asyncio.create_subprocess_exec(
                    *self._command, stdin=PIPE, stdout=PIPE, limit=LINE_MAX_BYTES, start_new_session=True
                )
            except OSError as error:
                words = f"the workbench cannot be started: {error.strerror or error}"
                raise PageError(503, "workbench-gone", words) from error
        reader, writer = self._process.stdout, self._process.stdin
        assert reader is not None  # noqa: S101 - both are pipes
        assert writer is not None  # noqa: S101
        return reader, writer

    def _rest(self) -> None:
        if not self._waiting:
            self._begin(self._end_in_turn())

    async def _end_in_turn(self) -> None:
        async with self._turn:
            await self._end()

    async def _end(self, *, at_once: bool = False) -> None:
        """Let the process end at the end of its input; kill it if it does not."""
        process, self._process = self._process, None
        if self._idle is not None:
            self._idle.cancel()
        if process is not None and process.stdin is not None:
            await end_process(process, process.kill if at_once else process.stdin.close, END_WAIT_S)


def command_of_workbench(configuration: Path, socket: Path | None) -> list[str]:
    """Return the command that starts the workbench process of a configuration."""
    given = [] if socket is None else [str(socket)]
    return [*python("stadimeter.workbench.server.process"), str(configuration), *given]
