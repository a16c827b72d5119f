"""A configuration with a rule of every kind and severity, and what Home Assistant discovers of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stadimeter.app.control.mqtt_requests import OFFERS
from stadimeter.app.discovery import announcement
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.home_assistant import Announcement, DiscoveryPlace
from support.simulated_run import SIMULATED_BALL

EVERY_RULE = (
    SIMULATED_BALL
    + """
[targets.box-2]
detector = "ideal"
[base]
driver = "simulated"
[messenger]
driver = "mqtt"
node = "Dock-3"
[rules.too-close]
target = "ball"
severity = "safety"
when = { below = "50 cm" }
latch = true
[rules.near]
target = "ball"
severity = "alarm"
when = { all = [{ below = "3 m" }, { time_to_contact = { below = "2 s" } }] }
ack = "required"
latch = true
[rules.in-reach]
target = "ball"
when = { between = ["50 cm", "1.5 m"] }
[rules.to_the_left]
target = "ball"
severity = "info"
when = { bearing = { below = "-10 deg" } }
[rules.fast]
target = "ball"
when = { closing_speed = { above = "1 m/s" } }
[rules.apart]
target = "ball"
when = { separation = { of = ["ball", "box-2"], above = "1 m" } }
[rules.many]
target = "ball"
when = { count = { at_least = 2 } }
[rules.at-night]
target = "ball"
when = { time = { between = ["22:00", "06:00"] } }
[rules.gone]
target = "ball"
when = { lost = true }
[rules.either]
target = "ball"
when = { any = [{ rule = "near" }, { base = { battery_below = "11 V" } }, { not = { seen = true } }] }
observe = true
[rules.louder]
target = "ball"
actuator = "motor"
ramp = { from = "2 m", to = "0.5 m" }
[rules.follow]
target = "ball"
actuator = "base"
follow = { distance = "1 m" }
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""
)

ORDERS = frozenset(f"request/{name}" for name in OFFERS)
"""Everything that a run may take from others."""


def every_rule(folder: Path) -> Configuration:
    """Return that configuration."""
    path = folder / "every-rule.toml"
    path.write_text(EVERY_RULE)
    return load_configuration(path)


def announced(configuration: Configuration, *, orders: frozenset[str] = frozenset(), **place: Any) -> Announcement:
    """Return what a run announces which takes these orders."""
    options = configuration.messenger.options if configuration.messenger is not None else None
    where: DiscoveryPlace = getattr(options, "discovery_place")  # noqa: B009 - of this driver only
    place = {"node": where.node, "base": where.base, "prefix": where.prefix, **place}
    return announcement(configuration.plan, DiscoveryPlace(**place), orders)
