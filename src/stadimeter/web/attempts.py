"""Limits on how often a password may be tried: few times in a row from one address, and few times a minute in all."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from ipaddress import IPv6Address, ip_address, ip_network
from math import ceil

from stadimeter.errors import PageError

# So many failures in a row cost no time. Each further one doubles the wait.
FREE = 5

# After this long without a failure, those before count no more.
FIRST_WAIT_S, MAX_WAIT_S = 10.0, 900.0
FORGOTTEN_S = 24 * 3600.0

# So many attempts at once, and then one in so much time, are taken from all addresses together that are not known: a
# network of computers guesses no faster than one.
IN_ALL, EVERY_S = 30, 2.0

# So long an attempt waits for its turn among them, before it is refused. So five wait at most.
TURN_MAX_S = 10.0

# Of so many addresses the failures are remembered; the oldest is forgotten first.
ADDRESSES_MAX = 1000

# Of so many it is remembered that somebody who may operate has logged in from there.
KNOWN_MAX = 100


class Attempts:
    """Counts failures.

    Args:
        clock: Seconds, of any origin.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._known: OrderedDict[str, None] = OrderedDict()
        self._paid_until_s = 0.0

    def knows(self, address: str) -> bool:
        """Check whether an operator has logged in from there: attempts from elsewhere do not hold them up."""
        return network_of(address) in self._known

    def begin(self, address: str) -> float:
        """Count an attempt as failed until it has succeeded; return for how long it waits for its turn.

        Raises `PageError`, which says how long to wait, if it is too early.
        """
        now_s, of = self._clock(), network_of(address)
        count, until_s = self._failures.get(of, (0, now_s))
        if now_s > until_s + FORGOTTEN_S:
            count = 0
        turn_s = 0.0 if of in self._known else self._turn_s(now_s)
        left_s = ceil(max(until_s - now_s, turn_s - TURN_MAX_S))
        if left_s > 0:
            words = f"too many wrong passwords; try again in {left_s} s"
            raise PageError(429, "too-many-attempts", words, {"wait_s": left_s})
        if of not in self._known:
            self._paid_until_s = max(self._paid_until_s, now_s) + EVERY_S
        count += 1
        doubled = 2.0 ** min(count - FREE, 20)
        wait_s = min(MAX_WAIT_S, FIRST_WAIT_S * doubled) if count >= FREE else 0.0
        self._failures[of] = (count, now_s + wait_s)
        self._failures.move_to_end(of)
        while len(self._failures) > ADDRESSES_MAX:
            self._failures.popitem(last=False)
        return turn_s

    def _turn_s(self, now_s: float) -> float:
        return max(0.0, self._paid_until_s - now_s - (IN_ALL - 1) * EVERY_S)

    def succeeded(self, address: str, *, forgets: bool = True) -> None:
        """Take back the attempt that was none, and forget the failures of its address.

        Args:
            forgets: Whether those are forgotten at once, and the address is known from now on. Not for a password that
                there is more to gain than: its owner could guess that other one without a wait, with theirs in
                between.
        """
        of = network_of(address)
        count, _ = self._failures.pop(of, (1, 0.0))
        if count > 1 and not forgets:
            self._failures[of] = (count - 1, self._clock())
        if of not in self._known:
            self._paid_until_s -= EVERY_S
        if forgets:
            self._known[of] = None
            self._known.move_to_end(of)
        if len(self._known) > KNOWN_MAX:
            self._known.popitem(last=False)


def network_of(address: str) -> str:
    """Return the range of addresses that one computer may have: of version 6, any of its network."""
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, IPv6Address) and found.ipv4_mapped is None:
        return str(ip_network((found, 64), strict=False))
    return str(getattr(found, "ipv4_mapped", None) or found)
