"""Snapshots and pictures of the run, from one subscription to every browser that watches.

A browser has no queue. It is given the newest message when it has taken the one before; events and distances of those
that it missed are added, so that a slow browser loses pictures and nothing else.
"""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections import deque
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import aclosing
from typing import Any

from msgspec import Struct

from stadimeter.errors import PageError
from stadimeter.web.links import PageAnswer, RunLink

# The pictures that a subscription may have.
KINDS = ("none", "plain", "drawn")

RETRY_S = 1.0
EVENTS_KEPT = 100
SAMPLES_KEPT_S = 300.0


class LiveMessage(Struct, frozen=True):
    """A snapshot as JSON, and its picture as JPEG."""

    snapshot: bytes
    picture: bytes = b""

    def encode(self) -> bytes:
        """Return it as the page's stream has it: both lengths, and both."""
        return struct.pack(">II", len(self.snapshot), len(self.picture)) + self.snapshot + self.picture


class History:
    """The events and distances of a run that a browser which comes now, or is slow, has not seen."""

    def __init__(self) -> None:
        self._begin(None)

    def _begin(self, run: Any) -> None:
        self._run = run
        self._last_event = -1
        self._events: deque[tuple[int, Any]] = deque(maxlen=EVENTS_KEPT)
        self._samples: dict[str, deque[tuple[int, Any]]] = {}

    def add(self, number: int, snapshot: Mapping[str, Any]) -> None:
        """Take what is new in the message of a number. After a restart of the run nothing of before remains."""
        run = (snapshot.get("run") or {}).get("started_unix_s")
        if run != self._run:
            self._begin(run)
        for event in snapshot.get("events", ()):
            if event["number"] > self._last_event:
                self._last_event = event["number"]
                self._events.append((number, event))
        for target, samples in snapshot.get("samples", {}).items():
            kept = self._samples.setdefault(target, deque())
            kept.extend((number, each) for each in samples if not kept or each[0] > kept[-1][1][0])
            while kept and kept[0][1][0] < kept[-1][1][0] - SAMPLES_KEPT_S:
                kept.popleft()

    def since(self, number: int) -> dict[str, Any]:
        """Return everything that came after the message of a number."""
        return {
            "events": [event for at, event in self._events if at > number],
            "samples": {
                target: [each for at, each in samples if at > number] for target, samples in self._samples.items()
            },
        }


class Feed:
    """The messages of one kind of picture. It is subscribed to while it has watchers.

    Args:
        explain: Says more of why there is no run.
    """

    def __init__(
        self, link: RunLink, image: str, explain: Callable[[PageError], PageError] = lambda error: error
    ) -> None:
        self._link = link
        self._explain = explain
        self._args = {"image": image}
        self._history = History()
        self._number = 0
        self._snapshot: Mapping[str, Any] | None = None
        self._newest = LiveMessage(b"")
        self._in_words: dict[int, bytes] = {}
        self._arrived = asyncio.Event()
        self._arrived_s = 0.0
        self._watchers = 0
        self._task: asyncio.Task[None] | None = None
        self._is_closed = False

    async def watch(self) -> AsyncGenerator[LiveMessage, None]:
        """Yield a message whenever there is a newer one. Ends when the page does."""
        self._watchers += 1
        if self._task is None:
            self._task = asyncio.create_task(self._follow())
        seen = 0
        try:
            while not self._is_closed:
                if self._snapshot is None or self._number == seen:
                    await self._arrived.wait()
                    continue
                message, seen = self._message(seen), self._number
                yield message
        finally:
            self._watchers -= 1
            if not self._watchers:
                self._rest()

    def close(self) -> None:
        """Let all who watch go."""
        self._is_closed = True
        self._rest()
        self._arrived.set()

    def _rest(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
        self._snapshot = None

    async def _follow(self) -> None:
        while True:
            try:
                async with aclosing(self._link.subscription(self._args)) as answers:
                    is_first = True
                    async for answer in answers:
                        self._take(answer, is_first=is_first)
                        is_first = False
            except PageError as error:
                why = self._explain(error)
                self._publish({"gone": str(why), "code": why.code}, b"")
            except (AttributeError, LookupError, TypeError):
                words = "the run says what this page does not understand: are they of one version?"
                self._publish({"gone": words, "code": "odd-run"}, b"")
            await asyncio.sleep(RETRY_S)

    def _take(self, answer: PageAnswer, *, is_first: bool) -> None:
        if not isinstance(answer.data, dict):
            raise TypeError("a snapshot is an object")
        self._history.add(self._number + 1, answer.data)
        self._publish(answer.data, answer.attached)
        if is_first:
            self._in_words.clear()  # what it brings may be known already

    def _publish(self, snapshot: Mapping[str, Any], picture: bytes) -> None:
        self._number += 1
        self._arrived_s = time.monotonic()
        self._snapshot = snapshot
        self._newest = LiveMessage(_json(snapshot), picture)
        self._in_words = {self._number - 1: self._newest.snapshot}
        arrived, self._arrived = self._arrived, asyncio.Event()
        arrived.set()

    def _message(self, seen: int) -> LiveMessage:
        """Return the newest message for one who has seen that of a number, and none of those between.

        A watcher who comes while the run hangs gets the last message, with its age.
        """
        snapshot = self._snapshot or {}
        if seen not in self._in_words:
            news = {} if "gone" in snapshot else self._history.since(seen)
            self._in_words[seen] = _json({**snapshot, **news})
        words = self._in_words[seen]
        if "gone" not in snapshot:
            words = b'{"waited_s":%.3f,' % (time.monotonic() - self._arrived_s) + words[1:]
        return LiveMessage(words, self._newest.picture)


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":")).encode("ascii")
