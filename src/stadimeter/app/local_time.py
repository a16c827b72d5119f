"""The local time, the date and the sun's times at a place, as schedules see them."""

from __future__ import annotations

from datetime import datetime

from msgspec.structs import replace

from stadimeter.app.clock import time_of_day
from stadimeter.config.loader import Configuration
from stadimeter.config.sun import sun_times_s
from stadimeter.core.observation import WallTime


def wall_time(now: datetime, configuration: Configuration) -> WallTime:
    """Return the time of day, the date and, where a rule asks for it, when the sun rises and sets on that date.

    Args:
        now: In any time zone; without one it is the time of the place.
    """
    place = configuration.place
    zone = place.zone if place is not None else None
    local = now if now.tzinfo is None else now.astimezone(zone)
    shown = time_of_day(local)
    if not configuration.needs_sun or place is None or place.latitude is None or place.longitude is None:
        return shown
    sunrise_s, sunset_s = sun_times_s(place.latitude, place.longitude, zone, local.date())
    return replace(shown, sunrise_s=sunrise_s, sunset_s=sunset_s)
