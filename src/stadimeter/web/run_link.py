"""The link to the run: asks at its control socket, and follows its snapshots."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator, AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from stadimeter.app.control.client import ANSWER_WAIT_S, HELLO_WAIT_S, find
from stadimeter.app.control.places import check_peer
from stadimeter.errors import ControlError, PageError
from stadimeter.web.exchange import LINE_MAX_BYTES, UNREADABLE, PageAnswer, put, take

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
