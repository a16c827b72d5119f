"""The links of the page to the run, to the workbench, and to a run that it starts: a question and its answer."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import tempfile
from asyncio import IncompleteReadError, LimitOverrunError, StreamReader, StreamWriter
from asyncio.subprocess import DEVNULL, PIPE, Process
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Mapping, Sequence
from contextlib import ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from msgspec import Struct

from stadimeter.app.control.client import ANSWER_WAIT_S, HELLO_WAIT_S, attached_bytes, find
from stadimeter.app.places import check_peer
from stadimeter.errors import ControlError, PageError
from stadimeter.web import python

# A longer line is no answer. The first snapshot holds the distances of some minutes.
LINE_MAX_BYTES = 8 * 1024 * 1024

# What HTTP has for the codes of errors; all others are a request that makes no sense just now: 400.
STATUS_OF_CODE = {"conflict": 409, "not-found": 404, "busy": 503}

_OF_THE_FRAMING = frozenset({"transaction", "status", "error", "code", "bytes", "data"})


class PageAnswer(Struct, frozen=True):
    """The answer of a run or the workbench, and the bytes that belong to it, such as a picture."""

    data: Any
    attached: bytes = b""


async def put(writer: StreamWriter, op: str, args: Mapping[str, Any]) -> None:
    """Send a question; `PageError` if its arguments are nested too deeply to be written."""
    try:
        line = json.dumps({"transaction": op, "op": op, "args": args})
    except RecursionError as error:
        raise PageError(400, "wrong-body", "the body of the request is nested too deeply") from error
    writer.write(line.encode("ascii") + b"\n")
    await writer.drain()


async def take(reader: StreamReader) -> PageAnswer:
    """Read an answer.

    Raises:
        PageError: It is a refusal, in the words of the one who was asked.
        EOFError: There is no more.
        ValueError: It makes no sense.
    """
    try:
        line = await reader.readuntil(b"\n")
    except LimitOverrunError as error:
        raise ValueError("an answer without an end") from error
    found = json.loads(line)
    if not isinstance(found, dict):
        raise ValueError("an answer is an object")
    attached = await reader.readexactly(attached_bytes(found))
    if found.get("status") == "error":
        raise refusal(found)
    return PageAnswer(found.get("data"), attached)


def refusal(answer: Mapping[str, Any]) -> PageError:
    """Return the error that an answer is."""
    code = str(answer.get("code") or "refused")
    details = {key: value for key, value in answer.items() if key not in _OF_THE_FRAMING}
    return PageError(STATUS_OF_CODE.get(code, 400), code, str(answer.get("error", "refused")), details)


# What `take` may raise besides a refusal: the other side is gone, or says what makes no sense.
UNREADABLE = (OSError, EOFError, ValueError, IncompleteReadError)


async def end_process(process: Process, end: Callable[[], object], wait_s: float) -> None:
    """End a process in the way that it heeds; kill it if it does not."""
    for ask, limit_s in ((end, wait_s), (process.kill, None)):
        with suppress(ProcessLookupError, TimeoutError):
            async with asyncio.timeout(limit_s):
                ask()
                await process.wait()
                return


# The link to the run: asks at its control socket, and follows its snapshots -----------------------


# A run that is subscribed to and sends nothing for this long is taken for hung.
SILENCE_MAX_S = 10.0

_Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class RunLink:
    """Asks the run of a configuration, wherever it listens.

    Args:
        configuration: The file that it runs.
        socket: Where it listens; None to look for it.
    """

    def __init__(self, configuration: Path, socket: Path | None = None) -> None:
        self.configuration = configuration
        self._given = socket
        self._found: Path | None = None

    async def ask(self, op: str, args: Mapping[str, Any] | None = None, wait_s: float = ANSWER_WAIT_S) -> PageAnswer:
        """Ask for an operation; `PageError` if it is refused, or no run answers."""
        try:
            async with asyncio.timeout(wait_s), self._connection() as streams:
                return await _exchange(streams, op, args or {})
        except TimeoutError as error:
            raise PageError(503, "no-answer", f"the run did not answer within {wait_s:g} s; does it hang?") from error

    async def subscription(self, args: Mapping[str, Any]) -> AsyncGenerator[PageAnswer, None]:
        """Yield snapshots until the run ends or is silent, which is a `PageError`."""
        async with self._connection() as (reader, writer):
            try:
                await put(writer, "subscribe", args)
                while True:
                    async with asyncio.timeout(SILENCE_MAX_S):
                        answer = await take(reader)
                    yield answer
            except TimeoutError as error:
                raise PageError(503, "no-answer", f"the run says nothing since {SILENCE_MAX_S:g} s") from error
            except UNREADABLE as error:
                raise PageError(503, "no-run", "the run has ended") from error

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[_Streams]:
        reader, writer = await self._connect()
        try:
            yield reader, writer
        finally:
            writer.close()

    async def _connect(self) -> _Streams:
        """Connect to where the run was last, else to where it is now."""
        try:
            if self._given is not None:
                return await _open(self._given)
            if self._found is not None and (streams := await self._reconnect(self._found)) is not None:
                return streams
            self._found = await asyncio.to_thread(find, self.configuration, names_others=False)
            return await _open(self._found)
        except ControlError as error:
            raise PageError(503, "no-run", str(error)) from error
        except OSError as error:
            raise PageError(503, "no-run", f"no run listens there: {error.strerror or error}") from error

    async def _reconnect(self, path: Path) -> _Streams | None:
        """Connect to where our run was; None if another, or none, is there now."""
        try:
            streams = await _open(path)
        except OSError:
            return None
        try:
            async with asyncio.timeout(HELLO_WAIT_S):
                told = await _exchange(streams, "hello", {})
            is_ours = Path(told.data["configuration"]) == self.configuration.resolve()
        except (PageError, TimeoutError, KeyError, TypeError):
            is_ours = False
        if is_ours:
            return streams
        streams[1].close()
        return None


async def _exchange(streams: _Streams, op: str, args: Mapping[str, Any]) -> PageAnswer:
    try:
        await put(streams[1], op, args)
        return await take(streams[0])
    except TimeoutError:
        raise
    except UNREADABLE as error:
        raise PageError(503, "no-run", "the run has ended, or what listens there is no run") from error


async def _open(path: Path) -> _Streams:
    reader, writer = await asyncio.open_unix_connection(os.fspath(path), limit=LINE_MAX_BYTES)
    try:
        check_peer(path, writer.get_extra_info("socket"))
    except BaseException:
        writer.close()
        raise
    return reader, writer


# The link to the workbench: starts its process when it is first needed, and asks over its pipe ----


# The process ends after this long without a question, and lets go of its camera: what it has loaded takes a small Pi a
# third of its memory.
IDLE_MAX_S = 120.0

# It is given this long to close its camera when it shall end.
END_WAIT_S = 2.0


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
        self._idle: asyncio.TimerHandle | None = None
        self._work: set[asyncio.Task[Any]] = set()

    async def ask(self, op: str, args: Mapping[str, Any], wait_s: float) -> PageAnswer:
        """Ask for an operation; `PageError` if it is refused, takes too long, or its process dies."""
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
        async with self._turn:
            return await self._answer(op, args, wait_s)

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


# The run that the page starts when there is none, and ends when it ends itself --------------------
#
# If the page is killed, the run's standard input ends and so does the run: no output goes on that no one could end.


# Loading takes a small Pi many seconds, and some cameras take five to open.
START_MAX_S = 45.0

ASK_EVERY_S = 0.1
RUN_END_WAIT_S = 5.0
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
            await end_process(process, process.terminate, RUN_END_WAIT_S)

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
            *command, stdin=PIPE, stdout=DEVNULL, stderr=said, start_new_session=True
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
