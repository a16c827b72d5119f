"""How likely a quantity is on one side of a limit, for a normal distribution."""

from __future__ import annotations

import math

_ROOT_2 = math.sqrt(2)


def probability_between(low: float, high: float, value: float, sigma: float) -> float:
    """Return how likely the true value is between two limits.

    Args:
        low: The lower limit, or minus infinity.
        high: The upper limit, or infinity.
        value: The value, in the unit of the limits.
        sigma: Its standard deviation, zero or more.

    Returns:
        From 0 to 1.
    """
    return probability_below(high, value, sigma) - probability_below(low, value, sigma)


def probability_below(limit: float, value: float, sigma: float) -> float:
    """Return how likely the true value is below a limit.

    Args:
        limit: The limit; it may be infinite.
        value: The value, in the unit of the limit.
        sigma: Its standard deviation, zero or more.

    Returns:
        From 0 to 1.
    """
    if math.isinf(limit):
        return 1.0 if limit > 0 else 0.0
    if sigma <= 0:
        return 1.0 if value < limit else 0.0
    return 0.5 * math.erfc((value - limit) / (sigma * _ROOT_2))
