"""Messages on remembered figures: ``figure/<name>/state``, retained, when one has changed, every 2 s at most."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping

from stadimeter.core.conditions.summary import RememberedFigure
from stadimeter.core.message import Message

INTERVAL_S = 2.0


def figure_topics(figures: Iterable[RememberedFigure]) -> frozenset[str]:
    """Return the topics on which figures are published."""
    return frozenset(f"figure/{figure.name}/state" for figure in figures)


class FigureReports:
    """Decides when a figure is published. Values are in the SI unit, rounded to three decimals; null if not known."""

    def __init__(self) -> None:
        self._told: dict[str, tuple[float, float | None]] = {}

    def messages(
        self, now_s: float, wall_clock: Callable[[], str], figures: Mapping[str, float | None]
    ) -> Iterable[Message]:
        """Return the messages after a cycle."""
        for name, value in figures.items():
            rounded = None if value is None else round(value, 3) + 0.0
            told_s, told = self._told.get(name, (-math.inf, math.nan))
            if rounded != told and now_s - told_s >= INTERVAL_S:
                self._told[name] = now_s, rounded
                payload = json.dumps({"v": 1, "ts": wall_clock(), "value": rounded}, separators=(",", ":"))
                yield Message(topic=f"figure/{name}/state", payload=payload, qos=1, retain=True)
