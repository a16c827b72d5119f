"""How often somebody may try a password: few times in a row from one address, and few times a minute in all."""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable
from ipaddress import IPv6Address, ip_address, ip_network
from math import ceil

from stadimeter.errors import PageError

FREE = 5
"""So many failures in a row cost no time. Each further one doubles the wait."""

FIRST_WAIT_S, LONGEST_WAIT_S = 10.0, 900.0
FORGOTTEN_S = 24 * 3600.0
"""After this long without a failure, those before count no more."""

IN_ALL, IN_ALL_S = 30, 60.0
"""So many failures in so much time, from everywhere: a network of computers guesses no faster than one."""

ADDRESSES_MAX = 1000
"""Of so many addresses the failures are remembered; the oldest is forgotten first."""


class Attempts:
    """Counts failures.

    Args:
        clock: Seconds, of any origin.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._recent: deque[float] = deque(maxlen=IN_ALL)

    def begin(self, address: str) -> None:
        """Count an attempt as failed until it has succeeded; `PageError` says how long to wait, if it is too early."""
        now_s, of = self._clock(), _network(address)
        count, until_s = self._failures.get(of, (0, now_s))
        if now_s > until_s + FORGOTTEN_S:
            count = 0
        if len(self._recent) == IN_ALL:
            until_s = max(until_s, self._recent[0] + IN_ALL_S)
        if until_s > now_s:
            left_s = ceil(until_s - now_s)
            words = f"too many wrong passwords; try again in {left_s} s"
            raise PageError(429, "too-many-attempts", words, {"wait_s": left_s})
        count += 1
        doubled = 2.0 ** min(count - FREE, 20)
        wait_s = min(LONGEST_WAIT_S, FIRST_WAIT_S * doubled) if count >= FREE else 0.0
        self._failures[of] = (count, now_s + wait_s)
        self._failures.move_to_end(of)
        self._recent.append(now_s)
        while len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)

    def succeeded(self, address: str, *, forgets: bool = True) -> None:
        """Take back the attempt that was none, and forget the failures of its address.

        Args:
            forgets: Whether those are forgotten at once. Not for a password that there is more to gain than: whoever
                has it could guess that other one without a wait, with theirs in between.
        """
        count, _ = self._failures.pop(_network(address), (1, 0.0))
        if count > 1 and not forgets:
            self._failures[_network(address)] = (count - 1, self._clock())
        if self._recent:
            self._recent.pop()


def _network(address: str) -> str:
    """Return what one computer may have of addresses: of version 6, any of its network."""
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, IPv6Address) and found.ipv4_mapped is None:
        return str(ip_network((found, 64), strict=False))
    return str(getattr(found, "ipv4_mapped", None) or found)
