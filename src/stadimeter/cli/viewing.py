"""How a run is shown while it goes on: the live view, lines, or nothing but troubles."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Literal, TextIO

import typer

from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.cli.plain_view import PlainView
from stadimeter.cli.view_thread import STOP_WAIT_S, ViewThread
from stadimeter.core.condition import DistanceCondition
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, RampRule

if TYPE_CHECKING:
    from stadimeter.cli.live_view import LiveView

View = Literal["live", "plain", "json"]
_NO_SCREEN = nullcontext()


@contextmanager
def show(loop: Loop, view: View, title: str, unit: str) -> Iterator[None]:
    """Show a run.

    Args:
        loop: The run.
        view: How.
        title: What runs.
        unit: The unit of distances.

    Yields:
        Nothing; the view ends with the context.
    """
    if view == "live":
        live = live_view_of(loop, title, unit)
        with _fed(loop, live.update, live):
            yield
        return
    if view == "plain":
        plain = PlainView(typer.echo, unit=unit, trouble=loop.trouble, ascii_only=not _is_unicode(sys.stdout))
        with _fed(loop, plain.update):
            yield
        return
    loop.listeners.append(_TroubleTeller(loop))
    yield


@contextmanager
def _fed(
    loop: Loop, update: Callable[[CycleRecord], None], screen: AbstractContextManager[object] = _NO_SCREEN
) -> Iterator[None]:
    """Feed a view with every cycle: from a thread if the loop must not wait, directly if it runs on a stepped clock."""
    if not loop.parts.is_live:
        loop.listeners.append(lambda record, _frame: update(record))
        with screen:
            yield
        return
    thread = ViewThread(update, screen)
    thread.start()
    loop.listeners.append(lambda record, _frame: thread.submit(record))
    try:
        yield
    finally:
        thread.stop(loop.deadline.left_s(STOP_WAIT_S))
        if thread.dropped:
            typer.echo(f"warning: {thread.dropped} cycles were not shown: the terminal did not keep up", err=True)


def live_view_of(loop: Loop, title: str, unit: str) -> LiveView:
    """Return the live view of a run.

    Args:
        loop: The run.
        title: What runs.
        unit: The unit of distances.

    Returns:
        The view, not shown yet.
    """
    from stadimeter.cli.live_view import LiveView  # noqa: PLC0415 - it takes long, and few runs show it

    return LiveView(
        title,
        unit=unit,
        trouble=loop.trouble,
        messages=lambda: tuple(loop.published),
        limits_m=chart_limits_m(loop.parts.configuration.plan),
    )


def _is_unicode(stream: TextIO) -> bool:
    return "utf" in (stream.encoding or "").lower()


class _TroubleTeller:
    """Tells on standard error what is wrong outside the loop, once for each change."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._said = ""

    def __call__(self, *_: object) -> None:
        trouble = self._loop.trouble()
        if trouble and trouble != self._said:
            typer.echo(f"warning: {trouble}", err=True)
        self._said = trouble


def chart_limits_m(plan: Plan) -> dict[str, list[float]]:
    """Return the distances at which rules begin, for marking them in a chart.

    Args:
        plan: The rules.

    Returns:
        For each target the distances in metres, nearest first.
    """
    limits_m: dict[str, set[float]] = {target: set() for target in plan.targets}
    for rule in plan.rules:
        limits_m[rule.target].update(_limits_m(rule))
    return {target: sorted(values) for target, values in limits_m.items()}


def _limits_m(rule: AnyRule) -> tuple[float, ...]:
    match rule:
        case AlarmRule(condition=DistanceCondition(above_m=above_m, below_m=below_m)):
            return tuple(limit_m for limit_m in (above_m, below_m) if limit_m is not None)
        case RampRule():
            return (rule.start_m,)
        case FollowRule():
            return (rule.distance_m,)
        case _:
            return ()
