"""The common part of the links to the run and the workbench: a question and its answer, the end of a process."""

from __future__ import annotations

import asyncio
import json
from asyncio import IncompleteReadError, LimitOverrunError, StreamReader, StreamWriter
from asyncio.subprocess import Process
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from msgspec import Struct

from stadimeter.app.control.framing import attached_bytes
from stadimeter.errors import PageError

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
    more = answer.get("data")
    details |= more if isinstance(more, dict) else {}
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
