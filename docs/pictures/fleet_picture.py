"""The view of a fleet as a picture, for the documentation: three devices, of which one has fallen silent."""

from __future__ import annotations

import json
from pathlib import Path

from live_view_svg import save_svg

from stadimeter.cli.fleet import Fleet, FleetScreen
from stadimeter.messaging.protocol import Received

NOW_S = 1000.0
_NOON = "2026-06-01T12:00:03"  # in the time zone of whoever looks, so that it is the same picture everywhere


def shown_fleet() -> Fleet:
    """Return the fleet of the picture, from the messages that its devices sent."""
    fleet = Fleet("stadimeter")

    def say(topic: str, payload: object, ago_s: float) -> None:
        data = payload.encode() if isinstance(payload, str) else json.dumps(payload).encode()
        fleet.take(Received(topic=f"stadimeter/{topic}", payload=data, is_retained=False), NOW_S - ago_s)

    seen = {"hall/press": (48.2, 0.92, 0.01), "garage": (0.4, 0.48, 0.006), "hall/lathe": (0.3, 2.43, 0.02)}
    for device, (ago_s, distance_m, sigma_m) in seen.items():
        say(f"{device}/availability", "online", ago_s)
        say(f"{device}/info", {"boot_id": "", "version": "0.1.0", "configuration_sha256": "bdf8"}, ago_s)
        target = {"status": "tracking", "distance_m": distance_m, "sigma_m": sigma_m, "seq": 1}
        say(f"{device}/target/ball/state", target, ago_s)
    alarm = {"active": True, "severity": "alarm", "acknowledged": False, "since": _NOON}
    say("garage/rule/too-close/state", {**alarm, "reason": "0.48 m is below 0.50 m"}, 0.4)
    return fleet


def draw(path: Path) -> None:
    """Write the picture as an SVG file."""
    save_svg(FleetScreen(shown_fleet(), "broker.local:8883", "", NOW_S), path, 110, 8, title="stadimeter fleet")
