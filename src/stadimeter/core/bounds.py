"""Limits of numbers from outside: one table, by what the number is.

Whatever is beyond is a slip or damage. Within these bounds no square, quotient or exponential that is worked out here
overflows, and no time that is added to another loses its milliseconds: a float keeps them up to 1e12 s.
"""

from __future__ import annotations

# Beyond the moon; a camera sees no target there.
MAX_LENGTH_M = 1e9

# A thousand turns.
MAX_SPEED_MPS = 1e6
MAX_ACCELERATION_MPS2 = 1e6
MAX_ANGLE_RAD = 1e4
MAX_TURN_RATE_RADPS = 1e4
MAX_TURN_ACCELERATION_RADPS2 = 1e6
MAX_FREQUENCY_HZ = 1e9
MAX_VOLTAGE_V = 1e6

# Of the width of the picture: a target that is larger is not seen whole.
MAX_SIZE = 10.0
SIZE_UNIT = "of the width"

# A hundred years.
MAX_DURATION_S = 3.2e9

# On a clock that began when the computer was switched on, or in 1970: it is the year 2286 then.
MAX_TIME_S = 1e10

# By the unit of a quantity of a target, the largest value of a threshold on it.
MAX_BY_UNIT = {"m": MAX_LENGTH_M, "m/s": MAX_SPEED_MPS, "rad": MAX_ANGLE_RAD, "s": MAX_DURATION_S, SIZE_UNIT: MAX_SIZE}

# Of a measurement, in metres or radians; also of its standard deviation.
MAX_FIGURE = 1e6

# Of a number without a unit.
MAX_PLAIN = 1e18

# A quantity that is nearer to zero is zero, and written as that.
MIN_QUANTITY = 1e-12


def is_time(*times_s: float) -> bool:
    """Check whether each is a time that a clock can show, or known to be none: NaN or infinite."""
    return all(abs(time_s) <= MAX_TIME_S or time_s - time_s != 0.0 for time_s in times_s)
