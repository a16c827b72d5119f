"""Sessions that people have ended: their cookies are signed, and would open the page until they end by themselves."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stadimeter.errors import PageError
from stadimeter.web.passwords import replace_file
from stadimeter.web.routes import Right

# Of so many sessions of a right it is remembered that they were ended. One more ends others, and lets none go on.
ENDED_MAX = 1000


@dataclass(frozen=True, slots=True)
class Session:
    """What a cookie says: what it opens, until when in seconds since 1970, and which session it is."""

    right: Right
    until_s: int
    name: str


@dataclass(slots=True)
class _OfRight:
    """The ended sessions of one right, each with its end; and the end up to which every one counts as ended."""

    until_s: dict[str, int] = field(default_factory=dict)
    floor_s: int = 0

    def add(self, session: Session, now_s: float) -> None:
        self.until_s = {name: until_s for name, until_s in self.until_s.items() if until_s > now_s}
        self.until_s[session.name] = session.until_s
        while len(self.until_s) > ENDED_MAX:
            first = min(self.until_s, key=self.until_s.__getitem__)
            self.floor_s = max(self.floor_s, self.until_s.pop(first))


class EndedSessions:
    """Remembers ended sessions, in a file beside the passwords: a restart of the page opens none of them again.

    Args:
        path: The file; it is made when it is first needed.
        unix_s: Seconds since 1970.
    """

    def __init__(self, path: Path, unix_s: Callable[[], float]) -> None:
        self.path = path
        self._unix_s = unix_s
        self._read_as: tuple[int, ...] | None = None
        self._of: dict[Right, _OfRight] = {}
        self._writing = asyncio.Lock()

    def has(self, session: Session) -> bool:
        """Return whether a session was ended; `PageError` if that cannot be known: none goes on then."""
        self._read()
        ended = self._of.get(session.right)
        return ended is not None and (session.until_s <= ended.floor_s or session.name in ended.until_s)

    async def add(self, session: Session) -> None:
        """End a session, at once; `PageError` if the file cannot be written, so that a restart would revive it."""
        async with self._writing:
            self._read()
            self._of.setdefault(session.right, _OfRight()).add(session, self._unix_s())
            told = {str(int(right)): {"floor_s": of.floor_s, "ended": of.until_s} for right, of in self._of.items()}
            try:
                await asyncio.to_thread(replace_file, self.path, json.dumps(told))
            except OSError as error:
                words = f"you are logged out until the page restarts: {self.path} cannot be written: {error.strerror}"
                raise PageError(503, "not-written", words) from error

    def _read(self) -> None:
        try:
            seen = self._seen()
            if seen is not None and seen != self._read_as:
                self._of = _parsed(json.loads(self.path.read_bytes()))
                self._read_as = seen
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            words = f"{self.path}: cannot be read; delete it, and set the password anew to end all sessions"
            raise PageError(503, "no-sessions", words) from error

    def _seen(self) -> tuple[int, ...] | None:
        try:
            found = self.path.stat()
        except FileNotFoundError:
            return None
        return found.st_mtime_ns, found.st_ino, found.st_size


def _parsed(told: Any) -> dict[Right, _OfRight]:
    return {
        Right(int(right)): _OfRight({str(name): int(until) for name, until in of["ended"].items()}, int(of["floor_s"]))
        for right, of in told.items()
    }
