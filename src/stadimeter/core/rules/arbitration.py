"""The choice of the winner of an output."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter

from stadimeter.core.plan import BaseOutput, Output
from stadimeter.core.rule_step import LevelRequest, Request, TwistRequest

# The requests for each output that has any, the winner first.
Wanted = Mapping[str, Sequence[Request]]


def arbitrate(requests: Iterable[Request], outputs: Mapping[str, Output] | None = None) -> dict[str, list[Request]]:
    """Sort the requests for each output, the winner first.

    The highest priority wins. Between equals, the output's combination decides.

    Args:
        requests: What the rules want, in the order of the configuration.
        outputs: The outputs that have equals to combine, by name.
    """
    by_output: dict[str, list[Request]] = defaultdict(list)
    for request in sorted(requests, key=attrgetter("priority"), reverse=True):  # equals stay in order
        by_output[request.output].append(request)
    for name, output in (outputs or {}).items():
        if len(by_output.get(name, ())) > 1:
            by_output[name] = _combine(by_output[name], output)
    return by_output


def rearrange(wanted: Wanted, gone: Iterable[Request], come: Iterable[Request], positions: Mapping[str, int]) -> Wanted:
    """Return the same as `arbitrate` when only a few requests have changed, without sorting all of them.

    Lists in which nothing has changed are the same objects.

    Args:
        wanted: The requests for each output so far, the winner first.
        gone: The requests that were made before and are no longer.
        come: The requests that are made now.
        positions: The position of each rule in the configuration, by its name.
    """
    after: dict[str, Sequence[Request]] = dict(wanted)
    lists: dict[str, list[Request]] = {}

    def place(request: Request) -> tuple[int, int]:
        return -request.priority, positions[request.rule]

    for request in gone:
        left = lists.setdefault(request.output, list(wanted[request.output]))
        del left[bisect_left(left, place(request), key=place)]
    for request in come:
        insort(lists.setdefault(request.output, list(wanted.get(request.output, ()))), request, key=place)
    for output, requests in lists.items():
        if requests:
            after[output] = requests
        else:
            del after[output]
    return after


def _combine(wanted: list[Request], output: Output) -> list[Request]:
    equals = [request for request in wanted if request.priority == wanted[0].priority]
    if len(equals) == 1:
        return wanted
    rest = wanted[len(equals) :]
    if isinstance(output, BaseOutput):
        return [_most_restrictive(equals), *rest]
    levels = [request for request in equals if isinstance(request, LevelRequest)]
    levels.sort(key=attrgetter("level"), reverse=output.combine == "max")
    return [*levels, *rest]


def _most_restrictive(equals: list[Request]) -> Request:
    """Return the slower of each speed. Rules that want to go opposite ways stand still."""
    twists = [request for request in equals if isinstance(request, TwistRequest)]
    return TwistRequest(
        rule="+".join(request.rule for request in twists),
        output=twists[0].output,
        priority=twists[0].priority,
        linear_mps=_slowest([request.linear_mps for request in twists]),
        angular_radps=_slowest([request.angular_radps for request in twists]),
        tilt_radps=_slowest([request.tilt_radps for request in twists]),
        is_gentle=all(request.is_gentle for request in twists),
    )


def _slowest(speeds: list[float]) -> float:
    slowest = min(speeds, key=abs)
    return slowest if all(math.copysign(1.0, speed) == math.copysign(1.0, slowest) for speed in speeds) else 0.0
