"""Messages about how a run is doing: its figures every half minute, and at once whether its camera delivers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sized
from typing import Protocol

import msgspec
from msgspec import Struct, field

import stadimeter
from stadimeter.app.live.health import Board, LiveHealth, live_health
from stadimeter.app.live.history import RunHistory
from stadimeter.core.message import Message

FORM = 1
INTERVAL_S = 30.0

# Without a frame for this long, nothing is known of any target: it is not "out of sight".
SILENT_S = 2.0

HEALTH, CAMERA = "health", "camera/state"


class DeliveryCounts(Protocol):
    """Knows what did not arrive, as `Deliveries` does."""

    def undelivered(self) -> Sized:
        """Return the messages that still wait."""
        ...

    def given_up(self) -> Mapping[str, int]:
        """Return the number of messages given up, by sender."""
        ...


class HealthReports(Struct):
    """Decides when the health of a run is published, and composes the message.

    Attributes:
        trouble: Says what is wrong outside the loop.
    """

    history: RunHistory
    board: Board
    trouble: Callable[[], str]
    deliveries: DeliveryCounts
    _told_at_s: float = -math.inf
    _was_online: bool | None = field(default=None)

    def messages(self, now_s: float, wall_clock: Callable[[], str]) -> list[Message]:
        """Return the messages to be published now; `now_s` is on the run's clock."""
        messages: list[Message] = []
        age_s = self.history.frame_age_s
        is_online = age_s is not None and age_s < SILENT_S
        if is_online is not self._was_online:
            self._was_online = is_online
            messages.append(_camera(is_online=is_online))
        if self.history.record is not None and now_s - self._told_at_s >= INTERVAL_S:
            self._told_at_s = now_s
            messages.append(self._health(wall_clock()))
        return messages

    def repeat(self) -> None:
        """Publish it with the next call."""
        self._told_at_s = -math.inf

    def last_messages(self) -> tuple[Message, ...]:
        """Return, for the end of a run, that the camera delivers no more."""
        return (_camera(is_online=False),) if self._was_online else ()

    def _health(self, wall_clock: str) -> Message:
        health = live_health(self.history, self.board, "", self.trouble())
        waiting = {
            "undelivered": len(self.deliveries.undelivered()),
            "given_up": sum(self.deliveries.given_up().values()),
        }
        figures = {"v": FORM, "ts": wall_clock, "version": stadimeter.__version__, **_figures(health), **waiting}
        return Message(topic=HEALTH, payload=msgspec.json.encode(figures).decode())


def _camera(*, is_online: bool) -> Message:
    return Message(topic=CAMERA, payload="online" if is_online else "offline", qos=1, retain=True)


def _figures(health: LiveHealth) -> dict[str, object]:
    board, (median_s, p95_s) = health.board, health.cycle_s
    return {
        "frame_rate_hz": _rounded(health.frame_rate_hz, 1),
        "frame_age_s": _rounded(health.frame_age_s),
        "latency_s": _rounded(health.latency_s),
        "cycle_s": _rounded(median_s, 4),
        "cycle_p95_s": _rounded(p95_s, 4),
        "dropped_frames": health.dropped_frames,
        "temperature_c": _rounded(board.temperature_c, 1),
        "throttling": board.throttling,
        "disk_free_bytes": board.disk_free_bytes,
        "memory_bytes": board.memory_bytes,
        "trouble": health.trouble,
        "mounting": health.mounting.status.value if health.mounting is not None else None,
    }


def _rounded(value: float | None, digits: int = 3) -> float | None:
    return None if value is None else round(value, digits)
