"""What Home Assistant 2026.2.3 refuses of a discovery message, or takes for something else than is meant.

Each of these was tried there: one unknown key at the root, in `device` or in `origin` drops the whole device, and so
does a component without `unique_id`. A unit that does not fit drops the component; a key that it does not know is
passed over without a word; a fraction of a second in `expire_after` becomes "never"; a QoS at the root is lost.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

ROOT = {"device", "origin", "availability", "availability_mode", "components"}
DEVICE = {
    "identifiers", "name", "manufacturer", "model", "model_id", "sw_version", "hw_version", "serial_number",
    "configuration_url",
}  # fmt: skip
ORIGIN = {"name", "sw_version", "support_url"}
EVERY = {
    "platform", "unique_id", "default_entity_id", "name", "qos", "availability", "availability_mode",
    "entity_category", "enabled_by_default", "icon",
}  # fmt: skip
NEEDED = {
    "sensor": {"state_topic"}, "binary_sensor": {"state_topic"}, "event": {"state_topic", "event_types"},
    "number": {"state_topic", "command_topic", "min", "max"}, "switch": {"state_topic", "command_topic"},
    "button": {"command_topic"}, "image": {"image_topic"},
    "update": {"state_topic", "latest_version_topic"},
}  # fmt: skip
ALLOWED = {
    "sensor": {
        "device_class", "state_class", "unit_of_measurement", "suggested_display_precision", "options", "expire_after",
        "value_template",
    },
    "binary_sensor": {
        "device_class", "expire_after", "value_template", "json_attributes_topic", "json_attributes_template",
    },
    "event": {"device_class"},
    "number": {"step", "mode", "unit_of_measurement", "device_class", "value_template", "command_template"},
    "switch": {"payload_on", "payload_off", "state_on", "state_off", "value_template"},
    "button": {"payload_press"},
    "image": {"content_type"},
    "update": {"value_template", "title", "device_class"},
}  # fmt: skip
UNITS = {"distance": "m", "speed": "m/s", "duration": "s", "temperature": "°C"}


def faults(message: dict[str, Any]) -> list[str]:
    """Return what is wrong with a discovery message."""
    return list(_faults(message))


def _faults(message: dict[str, Any]) -> Iterator[str]:
    if set(message) != ROOT:
        yield f"keys at the root: {sorted(set(message) ^ ROOT)}"
    device, origin = message.get("device", {}), message.get("origin", {})
    if not device.get("identifiers") or set(device) - DEVICE:
        yield f"device: {sorted(set(device) - DEVICE)}"
    if not origin.get("name") or set(origin) - ORIGIN:
        yield f"origin: {sorted(set(origin) - ORIGIN)}"
    for url in (device.get("configuration_url", "http://x/"), origin.get("support_url", "http://x/")):
        if not re.match(r"https?://", url):
            yield f"{url} is no address"
    components = message.get("components", {})
    for key, component in components.items():
        yield from (f"{key}: {fault}" for fault in _component_faults(component))
    ids = [each.get("unique_id") for each in components.values()]
    if len(set(ids)) < len(ids):
        yield "two unique ids are the same"


def _component_faults(component: dict[str, Any]) -> Iterator[str]:
    platform = component.get("platform", "")
    if platform not in NEEDED:
        yield f"platform {platform!r}"
        return
    needed = {"unique_id", "default_entity_id", "name", "qos"} | NEEDED[platform]
    if missing := needed - set(component):
        yield f"without {sorted(missing)}"
    if unknown := set(component) - EVERY - NEEDED[platform] - ALLOWED[platform]:
        yield f"unknown {sorted(unknown)}"
    if not re.fullmatch(rf"{platform}\.[a-z0-9_]+", component.get("default_entity_id", "")):
        yield "default_entity_id"
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", component.get("unique_id", "")):
        yield "unique_id"
    yield from _value_faults(component, platform)
    text = repr(component)
    if "~" in text or "NaN" in text:
        yield "an abbreviation, or NaN"


def _value_faults(component: dict[str, Any], platform: str) -> Iterator[str]:
    expires = component.get("expire_after", 1)
    if not isinstance(expires, int) or expires < 1:
        yield f"expire_after {expires}"
    unit, kind = component.get("unit_of_measurement"), component.get("device_class")
    if kind in UNITS and unit != UNITS[kind]:
        yield f"{kind} in {unit}"
    if kind == "enum" and (not component.get("options") or {"state_class", "unit_of_measurement"} & set(component)):
        yield "an enumeration with figures, or without words"
    if "state_class" in component and not unit and kind:
        yield "figures without a unit"
    if platform == "number" and not component.get("min", 1) < component.get("max", 0):
        yield "an empty range"
    if component.get("entity_category") == "config" and platform in {"sensor", "binary_sensor", "event", "image"}:
        yield "a category for what can be set"
    if "availability_topic" in component and "availability" in component:
        yield "two kinds of availability"
