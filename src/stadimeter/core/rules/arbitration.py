"""Who wins an output."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from operator import attrgetter

from stadimeter.core.rules.request import Request


def arbitrate(requests: Iterable[Request]) -> dict[str, list[Request]]:
    """Sort the requests for each output, the winner first.

    The highest priority wins. Between equals, the one that comes first in the configuration does; a configuration
    with such equals is refused before it runs.

    Args:
        requests: What the rules want, in the order of the configuration.

    Returns:
        For each output that anybody wants something of, the requests for it, the winner first.
    """
    by_output: dict[str, list[Request]] = defaultdict(list)
    for request in sorted(requests, key=attrgetter("priority"), reverse=True):  # equals stay in order
        by_output[request.output].append(request)
    return by_output
