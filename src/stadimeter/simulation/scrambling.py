"""Numbers that look random and follow from keys: the same keys, the same numbers."""

from __future__ import annotations

import math

# Of SplitMix64.
_MASK = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15


def scramble(*keys: int) -> int:
    """Return 64 bits that look random and depend on every bit of every key, in order.

    It is the output function of SplitMix64 (G. Steele, D. Lea and C. Flood, "Fast splittable pseudorandom number
    generators", 2014), once for each key. Ten times cheaper than seeding a generator for each frame.
    """
    state = 0
    for key in keys:
        state = (state + _GOLDEN + key) & _MASK
        state = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        state = ((state ^ (state >> 27)) * 0x94D049BB133111EB) & _MASK
        state ^= state >> 31
    return state


def gaussian_pair(*keys: int) -> tuple[float, float]:
    """Return two independent numbers of the standard normal distribution, by the Box-Muller transform, from keys."""
    bits = scramble(*keys)
    radius = math.sqrt(-2.0 * math.log(((bits >> 32) + 1) / 2**32))
    angle = 2.0 * math.pi * (bits & 0xFFFFFFFF) / 2**32
    return (radius * math.cos(angle), radius * math.sin(angle))
