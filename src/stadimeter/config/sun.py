"""When the sun rises and sets at a place.

The times are those of `astral` (an extra, loaded only where a rule names the sun): sunrise and sunset are when the
upper edge of the sun is at the horizon, refraction included. Beyond the polar circles some days have neither.
"""

from __future__ import annotations

import math
from contextlib import suppress
from datetime import UTC, date, datetime, time, tzinfo
from functools import lru_cache

# The sun is up while its middle is no deeper than this: half its width, and what the air bends its light.
HORIZON_DEG = -0.833


@lru_cache(maxsize=4)
def sun_times_s(latitude_deg: float, longitude_deg: float, zone: tzinfo | None, day: date) -> tuple[float, float]:
    """Return when the sun rises and sets on a day, in seconds since its midnight; see `WallTime` for days without.

    Args:
        zone: The time zone; None for that of the computer.
    """
    from astral import Observer  # noqa: PLC0415 - only where a rule asks for the sun
    from astral.sun import elevation, sunrise, sunset  # noqa: PLC0415

    observer = Observer(latitude_deg, longitude_deg)
    midnight = datetime.combine(day, time())
    noon = midnight.replace(hour=12, tzinfo=zone).astimezone(zone)
    times_s = {}
    for event in (sunrise, sunset):
        with suppress(ValueError):  # it does not come on that day
            at = event(observer, day, tzinfo=noon.tzinfo or UTC)
            times_s[event] = (at.replace(tzinfo=None) - midnight).total_seconds()
    if not times_s and elevation(observer, noon) <= HORIZON_DEG:
        return math.inf, -math.inf
    return times_s.get(sunrise, -math.inf), times_s.get(sunset, math.inf)
