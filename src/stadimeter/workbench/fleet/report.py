"""A fleet for programs: as one record, and what is wrong in it."""

from __future__ import annotations

from typing import Any

import msgspec

from stadimeter.workbench.fleet.devices import Device, Fleet


def fleet_record(fleet: Fleet, now_s: float) -> dict[str, Any]:
    """Return the fleet as ``fleet --json`` prints it. Ages are in seconds, and null where they are not known."""
    return {
        "devices": [_device_record(device, now_s) for _, device in sorted(fleet.devices.items())],
        "alarms": [msgspec.to_builtins(alarm) for alarm in fleet.standing],
        "messages": fleet.messages,
        "passed_over": fleet.passed_over,
    }


def troubles(fleet: Fleet, now_s: float) -> list[str]:
    """Return, as sentences, why not all is well: devices that are not online, and serious alarms that stand."""
    found = [] if fleet.devices else [f"no device was heard below {fleet.root}/"]
    statuses = {device.name: device.status(now_s) for device in fleet.devices.values()}
    found += [f"{name}: {status}" for name, status in sorted(statuses.items()) if status != "online"]
    found += [
        f"{alarm.device}/{alarm.rule}: {alarm.severity or 'alarm of unknown severity'}: {alarm.reason}"
        for alarm in fleet.standing
        if alarm.is_serious
    ]
    if fleet.passed_over:
        found.append(f"{fleet.passed_over} messages were passed over: there was no room for them, or no such topic")
    return found


def age_s(at_s: float | None, now_s: float) -> float | None:
    """Return how old something is."""
    return None if at_s is None else round(max(0.0, now_s - at_s), 1)


def _device_record(device: Device, now_s: float) -> dict[str, Any]:
    return {
        "device": device.name,
        "status": device.status(now_s),
        "age_s": age_s(device.newest_s, now_s),
        **msgspec.to_builtins(device.info),
        "configuration": msgspec.to_builtins(device.configuration),
        "why_not": device.configuration.why_not() if device.configuration else "",
        "targets": [
            {
                "target": name,
                "status": target.status,
                "distance_m": target.distance_m,
                "sigma_m": target.sigma_m,
                "sequence": target.sequence,
                "age_s": age_s(target.at_s, now_s),
            }
            for name, target in sorted(device.targets.items())
        ],
        "standing": len(device.standing),
        "unjudged": sorted(device.unjudged),
        "unreadable": device.unreadable,
        "missed": device.missed,
    }
