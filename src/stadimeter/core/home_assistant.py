"""Discovery of a device by Home Assistant: one message that the broker keeps, with every entity of it.

The form is that of Home Assistant's "device discovery" (home-assistant.io, integration MQTT, section "MQTT discovery").
Home Assistant drops a whole device for one key at the root that it does not know, and the key of a component that it
does not know: so keys are written in full, and are those of the types below.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import msgspec
from msgspec import Struct

from stadimeter.core.message import AVAILABILITY, Message


class _Part(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A part of the message; keys that are not given are left out of it."""


class Topic(_Part, frozen=True, kw_only=True):
    """A topic that says ``online`` or ``offline``."""

    topic: str


class Component(_Part, frozen=True, kw_only=True, tag_field="platform"):
    """An entity, as every platform has it.

    Attributes:
        unique_id: By which Home Assistant knows it for ever, whatever it is called.
        default_entity_id: What it is called in automations, unless a person renames it.
        qos: Of its subscriptions and orders. It does not follow that of the device.
        availability: In place of that of the device: it is available while all of these say so.
        expire_after: After this many seconds without a state it is unavailable; 0 for never.
    """

    unique_id: str
    default_entity_id: str
    name: str
    qos: int
    availability: tuple[Topic, ...] = ()
    availability_mode: Literal["", "all"] = ""
    entity_category: Literal["", "config", "diagnostic"] = ""
    enabled_by_default: bool = True
    icon: str = ""

    @property
    def states(self) -> tuple[str, ...]:
        """The topics that it shows."""
        topics = tuple(getattr(self, field, "") for field in ("state_topic", "json_attributes_topic", "image_topic"))
        return (*filter(None, topics), *(each.topic for each in self.availability))

    @property
    def order(self) -> str:
        """The topic to which it sends; empty for none."""
        return getattr(self, "command_topic", "")


class Sensor(Component, frozen=True, kw_only=True, tag="sensor"):
    """A figure, or one of some words."""

    state_topic: str
    value_template: str
    device_class: str = ""
    state_class: Literal["", "measurement"] = ""
    unit_of_measurement: str = ""
    suggested_display_precision: int | None = None
    options: tuple[str, ...] = ()
    expire_after: int = 0


class BinarySensor(Component, frozen=True, kw_only=True, tag="binary_sensor"):
    """Something that is so or not, or unknown."""

    state_topic: str
    value_template: str
    device_class: str = ""
    json_attributes_topic: str = ""
    json_attributes_template: str = ""
    expire_after: int = 0


class EventEntity(Component, frozen=True, kw_only=True, tag="event"):
    """Something that happens; what it says beside its type are attributes."""

    state_topic: str
    event_types: tuple[str, ...]


class Number(Component, frozen=True, kw_only=True, tag="number"):
    """A figure that people may set."""

    state_topic: str
    value_template: str
    command_topic: str
    command_template: str
    min: float
    max: float
    step: float
    mode: Literal["box"]
    unit_of_measurement: str = ""
    device_class: str = ""


class Switch(Component, frozen=True, kw_only=True, tag="switch"):
    """Something that people may switch."""

    state_topic: str
    value_template: str
    command_topic: str
    payload_on: str
    payload_off: str
    state_on: str
    state_off: str


class ButtonEntity(Component, frozen=True, kw_only=True, tag="button"):
    """Something that people may ask for."""

    command_topic: str
    payload_press: str


class ImageEntity(Component, frozen=True, kw_only=True, tag="image"):
    """A picture."""

    image_topic: str
    content_type: str


class UpdateEntity(Component, frozen=True, kw_only=True, tag="update"):
    """The version that runs, and the one there is. Nothing is installed by it.

    Attributes:
        latest_version_topic: Where who looks after the devices publishes the version that they should have.
    """

    state_topic: str
    value_template: str
    latest_version_topic: str
    title: str


AnyComponent = Sensor | BinarySensor | EventEntity | Number | Switch | ButtonEntity | ImageEntity | UpdateEntity


_PLATFORMS = frozenset(str(kind.__struct_config__.tag) for kind in AnyComponent.__args__)


class DiscoveryDevice(_Part, frozen=True, kw_only=True):
    """The device that the entities belong to."""

    identifiers: tuple[str, ...]
    name: str
    manufacturer: str
    model: str
    sw_version: str


class Origin(_Part, frozen=True, kw_only=True):
    """The program that says all this."""

    name: str
    sw_version: str
    support_url: str


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
        components: By a key that stays the same while an entity is the same.
    """

    place: DiscoveryPlace
    device: DiscoveryDevice
    origin: Origin
    components: Mapping[str, AnyComponent]

    def message(self, gone: Mapping[str, str] | None = None) -> Message:
        """Return the message.

        Args:
            gone: The platforms of components that are no more, by key: such a message removes them. One without them
                must follow.
        """
        removed = {key: {"platform": platform} for key, platform in (gone or {}).items()}
        content = {
            "device": self.device,
            "origin": self.origin,
            "availability": [Topic(topic=f"{self.place.base}/{AVAILABILITY.path}")],
            "availability_mode": "all",
            "components": {**self.components, **removed},
        }
        payload = msgspec.json.encode(content).decode()
        return Message(topic=self.place.topic, payload=payload, qos=1, retain=True, is_absolute=True)

    @property
    def platforms(self) -> dict[str, str]:
        """The platform of each component."""
        return {key: str(each.__struct_config__.tag) for key, each in self.components.items()}


class _KeptComponent(Struct):
    platform: str


class _KeptAnnouncement(Struct):
    components: dict[str, _KeptComponent]


def announced_platforms(payload: bytes) -> dict[str, str]:
    """Return the platforms that an announcement names, by key; none of what no run of this program announces."""
    try:
        kept = msgspec.json.decode(payload, type=_KeptAnnouncement)
    except msgspec.MsgspecError:
        return {}
    return {key: each.platform for key, each in kept.components.items() if each.platform in _PLATFORMS}


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
