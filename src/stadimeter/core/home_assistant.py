"""Discovery of a device by Home Assistant: one message that the broker keeps, with every entity of it.

The form is that of Home Assistant's "device discovery" (home-assistant.io, integration MQTT, section "MQTT discovery").
Home Assistant drops a whole device for one key at the root that it does not know, and of a component the key: so keys
are written in full, and tests compare them with those of each platform.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec
from msgspec import Struct

from stadimeter.core.message import AVAILABILITY, Message

SUPPORT_URL = "https://github.com/stadimeter/stadimeter"

# The platforms of our components. A kept message that names another is not ours.
PLATFORMS = frozenset({"sensor", "binary_sensor", "event", "number", "switch", "button", "image", "update"})

# An entity, with the keys that Home Assistant has for its platform.
Component = Mapping[str, Any]


class DiscoveryPlace(Struct, frozen=True, kw_only=True):
    """The place where a node is discovered.

    Attributes:
        node: Its name, which no other node has.
        base: What its topics begin with.
        prefix: What Home Assistant listens to.
    """

    node: str
    base: str
    prefix: str

    @property
    def device(self) -> str:
        """By which Home Assistant knows the device, and its entities by what begins with this."""
        return f"stadimeter_{self.node}"

    @property
    def topic(self) -> str:
        """The topic of the message, which does not begin with the base topic."""
        return f"{self.prefix}/device/{self.device}/config"


class Announcement(Struct, frozen=True, kw_only=True):
    """A device with its entities, to be discovered.

    Attributes:
        version: Of this program.
        components: By a key that stays the same while an entity is the same.
    """

    place: DiscoveryPlace
    version: str
    components: Mapping[str, Component]

    def message(self, gone: Mapping[str, str] | None = None) -> Message:
        """Return the message.

        Args:
            gone: The platforms of components that are no more, by key: such a message removes them. One without them
                must follow.
        """
        place = self.place
        content = {
            "device": {
                "identifiers": [place.device],
                "name": f"Stadimeter {place.node}",
                "manufacturer": "Stadimeter project",
                "model": "Stadimeter",
                "sw_version": self.version,
            },
            "origin": {"name": "stadimeter", "sw_version": self.version, "support_url": SUPPORT_URL},
            "availability": [{"topic": f"{place.base}/{AVAILABILITY.path}"}],
            "availability_mode": "all",
            "components": {
                **self.components,
                **{key: {"platform": platform} for key, platform in (gone or {}).items()},
            },
        }
        payload = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
        return Message(topic=place.topic, payload=payload, qos=1, retain=True, is_absolute=True)

    @property
    def platforms(self) -> dict[str, str]:
        """The platform of each component."""
        return {key: each["platform"] for key, each in self.components.items()}


class _KeptComponent(Struct):
    platform: str


class _KeptAnnouncement(Struct):
    components: dict[str, _KeptComponent]


def announced_platforms(payload: bytes) -> dict[str, str]:
    """Return the platforms that an announcement names, by key; none of what no run of this program announces."""
    try:
        kept = msgspec.json.decode(payload, type=_KeptAnnouncement)
    except ValueError:
        return {}
    return {key: each.platform for key, each in kept.components.items() if each.platform in PLATFORMS}


def announce(announcement: Announcement | None, before: Mapping[str, str], topic: str) -> Iterator[Message]:
    """Yield what announces a device, and removes what an earlier announcement has left.

    Args:
        announcement: The device; None for none.
        before: The platforms of the earlier one, by key.
        topic: The topic of both.
    """
    if announcement is None:
        if before:
            yield Message(topic=topic, payload="", qos=1, retain=True, is_absolute=True)
        return
    # A key that goes on with another platform is among them: Home Assistant must first forget the entity that it was.
    now = announcement.platforms
    if gone := {key: platform for key, platform in before.items() if now.get(key) != platform}:
        yield announcement.message(gone)
    yield announcement.message()
