"""The view that Home Assistant has of a run: the entities of its targets, its rules and itself, from the compiled plan.

An entity is offered only if the run publishes what it shows and takes what it sends. So nothing is listed twice: a
topic that is new brings its entities with it.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import stadimeter
from stadimeter.core import message as topics
from stadimeter.core.alarms.machine import RuleThreshold, thresholds_of
from stadimeter.core.decision import ALARM_EVENTS, Severity
from stadimeter.core.home_assistant import Announcement, Component, DiscoveryPlace
from stadimeter.core.measurement import TrackStatus
from stadimeter.core.plan import Plan
from stadimeter.core.rule import AlarmRule, AnyRule, gate_of
from stadimeter.core.safety import could_let_act
from stadimeter.operator_actions import SWITCHES, OperatorAction

# Two states in a row may be lost on the way before a figure is unavailable.
TARGET_EXPIRES_S = int(3 * topics.TARGET_STATE.heartbeat_s)
HEALTH_EXPIRES_S = int(3 * topics.HEALTH.heartbeat_s)

# A button has no field for a time.
SHELVE_FOR_S = 1800.0

# What of a rule's state is shown beside it.
_ATTRIBUTES = (
    "reason", "status", "since", "acknowledged", "latched", "first_out", "inhibits", "chattering", "data_lost",
)  # fmt: skip

_DEVICE_CLASSES = {Severity.SAFETY: "safety", Severity.ALARM: "problem", Severity.WARNING: "problem"}
# Below the first level of the base topic: one for all devices there.
_LATEST_VERSION = "latest_version"

_TAKE_SNAPSHOT = topics.REQUEST.of("snapshot")

# Offered where other programs may let outputs act.
_LETS_ACT = topics.REQUEST.of(OperatorAction.RELEASE_OUTPUTS)


def announcement(plan: Plan, place: DiscoveryPlace, orders: Iterable[str]) -> Announcement:
    """Return the announcement that Home Assistant discovers.

    Args:
        orders: The topics that the run listens to, such as ``request/acknowledge``.
    """
    orders = frozenset(orders)
    names = {"target": plan.targets, "rule": [rule.name for rule in plan.rules]}
    published = {each.of(name) for each in topics.OWN_TOPICS for name in names.get(each.first_level, ("",))}
    if _TAKE_SNAPSHOT not in orders:
        published.discard(topics.SNAPSHOT.path)
    entities = _Entities(place)
    found = [each for name in plan.targets for each in entities.of_target(name)]
    for rule in plan.rules:
        refused = _refused_orders(plan, rule.name) if _LETS_ACT not in orders else frozenset()
        ordered = {f"{place.base}/{topics.REQUEST.of(order)}" for order in refused}
        found += [each for each in entities.of_rule(rule) if each.get("command_topic") not in ordered]
    found += entities.of_run()
    known = {f"{place.base}/{topic}" for topic in (*published, *orders)}
    return Announcement(
        place=place,
        version=stadimeter.__version__,
        components={
            each["unique_id"].removeprefix(f"{place.device}_"): each
            for each in found
            if known.issuperset(_topics_of(each))
        },
    )


def _topics_of(component: Component) -> Iterator[str]:
    """Yield the topics that an entity shows, and to which it sends."""
    keys = ("state_topic", "json_attributes_topic", "image_topic", "command_topic")
    yield from (component[key] for key in keys if key in component)
    yield from (each["topic"] for each in component.get("availability", ()))


def _refused_orders(plan: Plan, rule: str) -> frozenset[str]:
    """Return the orders that are refused for a rule, since they could let an output act; also those of switches."""
    actions = frozenset(each for each in OperatorAction if could_let_act(plan, each, rule))
    return actions.union(name for name, both in SWITCHES.items() if actions.intersection(both))


class _Entities:
    """Makes entities of one node.

    A unique id is made of what an entity shows and of whom. No kind begins with another one and ``_``, so two are never
    the same, however targets and rules are called.
    """

    def __init__(self, place: DiscoveryPlace) -> None:
        self._place = place

    def of_target(self, target: str) -> Iterator[Component]:
        """Yield what is shown of a target: nothing while the camera is silent."""
        topic, shown = self._topic(topics.TARGET_STATE.of(target)), _title(target)
        common: dict[str, Any] = {
            "state_topic": topic,
            "expire_after": TARGET_EXPIRES_S,
            **self._available(topics.CAMERA_STATE.path),
        }
        figure: dict[str, Any] = {"state_class": "measurement", **common}
        metres = {"device_class": "distance", "unit_of_measurement": "m", **figure}
        yield self._entity(
            "sensor", "distance", target, f"{shown} distance",
            value_template=_value("distance_m"), suggested_display_precision=2, **metres,
        )  # fmt: skip
        yield self._entity(
            "sensor", "sigma", target, f"{shown} distance uncertainty (1σ)", entity_category="diagnostic",
            value_template=_value("sigma_m"), suggested_display_precision=3, **metres,
        )  # fmt: skip
        yield self._entity(
            "sensor", "closing_speed", target, f"{shown} closing speed",
            value_template=_value("closing_mps"), suggested_display_precision=2,
            device_class="speed", unit_of_measurement="m/s", **figure,
        )  # fmt: skip
        yield self._entity(
            "sensor", "status", target, f"{shown} status",
            value_template=_value("status"), device_class="enum", options=tuple(TrackStatus), **common,
        )  # fmt: skip
        yield self._entity(
            "binary_sensor", "presence", target, f"{shown} in sight",
            value_template="{{ 'ON' if value_json.status in ['tracking', 'coasting'] else 'OFF' }}",
            device_class="occupancy", **common,
        )  # fmt: skip

    def of_rule(self, rule: AnyRule) -> Iterator[Component]:
        """Yield whether a rule is active, and what people may do to it."""
        topic, name = self._topic(topics.RULE_STATE.of(rule.name)), rule.name
        attributes = ", ".join(f"'{key}': value_json.{key}" for key in _ATTRIBUTES)
        yield self._entity(
            "binary_sensor", "rule", name, _title(name),
            qos=1,
            state_topic=topic,
            value_template="{{ {true: 'ON', false: 'OFF'}.get(value_json.active) }}",
            device_class=_DEVICE_CLASSES.get(rule.severity, "") if isinstance(rule, AlarmRule) else "running",
            json_attributes_topic=topic,
            json_attributes_template=f"{{{{ {{{attributes}}} | tojson if value_json is defined else '{{}}' }}}}",
            **self._available(topics.RULE_AVAILABILITY.of(name)),
        )  # fmt: skip
        alarm = gate_of(rule)
        yield from self._buttons(alarm)
        if rule.severity is not Severity.SAFETY:
            yield from (self._threshold(name, key, found) for key, found in thresholds_of(alarm).items())
            yield self._switch(name, "in-service", "in_service", "in service")
            yield self._switch(name, "observed", "observed", "observed only")

    def of_run(self) -> Iterator[Component]:
        """Yield what is not of one target or rule."""
        yield self._entity(
            "event", "alarm", "", "Alarm", qos=1,
            state_topic=self._topic(topics.ALARM_EVENT.path), event_types=tuple(ALARM_EVENTS),
        )  # fmt: skip
        yield self._button(OperatorAction.STOP_OUTPUTS, "", "Stop all outputs", {})
        yield self._entity(
            "button", "take_snapshot", "", "Take a picture", qos=1,
            command_topic=self._topic(_TAKE_SNAPSHOT), payload_press="{}",
        )  # fmt: skip
        yield self._entity(
            "image", "snapshot", "", "Picture",
            image_topic=self._topic(topics.SNAPSHOT.path), content_type="image/jpeg",
        )  # fmt: skip
        yield self._entity(
            "update", "software", "", "Software", qos=1, entity_category="diagnostic",
            state_topic=self._topic(topics.INFO.path), value_template="{{ value_json.version }}", title="stadimeter",
            latest_version_topic=f"{self._place.base.partition('/')[0]}/{_LATEST_VERSION}",
        )  # fmt: skip
        yield self._diagnostic("frame_rate", "Frame rate", "frame_rate_hz", unit_of_measurement="fps", **_MEASURED)
        yield self._diagnostic(
            "latency", "Latency to the outputs", "latency_s",
            device_class="duration", unit_of_measurement="s", suggested_display_precision=3, **_MEASURED,
        )  # fmt: skip
        yield self._diagnostic(
            "temperature", "Processor temperature", "temperature_c",
            device_class="temperature", unit_of_measurement="°C", **_MEASURED,
        )  # fmt: skip
        yield self._diagnostic("undelivered", "Messages not delivered", "undelivered", **_MEASURED)

    def _buttons(self, rule: AlarmRule) -> Iterator[Component]:
        name = rule.name
        if rule.ack == "required":
            yield self._button(OperatorAction.ACKNOWLEDGE, name, f"{_title(name)}: acknowledge", {})
        if rule.latch:
            yield self._button(OperatorAction.RESET, name, f"{_title(name)}: reset", {})
        if rule.shelve_max_s and rule.severity is not Severity.SAFETY:
            for_s = min(SHELVE_FOR_S, rule.shelve_max_s)
            words = f"{_title(name)}: shelve for {for_s / 60:.3g} min"
            yield self._button(OperatorAction.SHELVE, name, words, {"for_s": for_s})
            yield self._button(OperatorAction.UNSHELVE, name, f"{_title(name)}: unshelve", {})

    def _button(self, action: OperatorAction, rule: str, words: str, more: Mapping[str, object]) -> Component:
        return self._entity(
            "button", action.value.replace("-", "_"), rule, words,
            qos=1,
            command_topic=self._topic(topics.REQUEST.of(action.value)),
            payload_press=json.dumps({**({"rule": rule} if rule else {}), **more}),
        )  # fmt: skip

    def _switch(self, rule: str, order: str, key: str, words: str) -> Component:
        """Return a switch of a rule. Home Assistant sends both states to one topic, so there is one order for them."""
        return self._entity(
            "switch", key, rule, f"{_title(rule)} {words}",
            qos=1,
            entity_category="config",
            state_topic=self._topic(topics.RULE_SETTINGS.of(rule)),
            value_template=f"{{{{ {{true: 'ON', false: 'OFF'}}.get(value_json.{key}) }}}}",
            command_topic=self._topic(topics.REQUEST.of(order)),
            payload_on=json.dumps({"rule": rule, "value": True}),
            payload_off=json.dumps({"rule": rule, "value": False}),
            state_on="ON",
            state_off="OFF",
        )  # fmt: skip

    def _threshold(self, rule: str, key: str, found: RuleThreshold) -> Component:
        order = f'{{"rule": {json.dumps(rule)}, "key": {json.dumps(key)}, "value": {{{{ value }}}}}}'
        return self._entity(
            "number", f"threshold_{key}", rule, f"{_title(rule)} {key}",
            qos=1,
            entity_category="config",
            state_topic=self._topic(topics.RULE_SETTINGS.of(rule)),
            value_template=f"{{{{ value_json.thresholds['{key}'].value }}}}",
            command_topic=self._topic(topics.REQUEST.of("set-threshold")),
            command_template=order,
            min=math.ceil(found.place.low * 1e3) / 1e3,
            max=math.floor(found.place.high * 1e3) / 1e3,
            step=0.01 if found.unit in {"m", "m/s"} else 0.001,
            mode="box",
            unit_of_measurement=found.unit,
            device_class={"m": "distance", "m/s": "speed", "s": "duration"}.get(found.unit, ""),
        )  # fmt: skip

    def _diagnostic(self, what: str, words: str, key: str, **more: Any) -> Component:
        return self._entity(
            "sensor", what, "", words,
            entity_category="diagnostic",
            state_topic=self._topic(topics.HEALTH.path),
            value_template=_value(key),
            expire_after=HEALTH_EXPIRES_S,
            enabled_by_default=False,
            **more,
        )  # fmt: skip

    def _entity(self, platform: str, what: str, of: str, words: str, **keys: Any) -> Component:
        """Return an entity with these keys. It has no key that is empty: Home Assistant would take that for a value."""
        name = f"{what}_{of}" if of else what
        entity = {
            "platform": platform,
            "unique_id": f"{self._place.device}_{name}",
            "default_entity_id": f"{platform}.{_slug(self._place.node)}_{_slug(name)}",
            "name": words,
            "qos": 0,
            **keys,
        }
        return {key: value for key, value in entity.items() if value != ""}

    def _available(self, also: str) -> dict[str, Any]:
        needed = (topics.AVAILABILITY.path, also)
        return {"availability": [{"topic": self._topic(each)} for each in needed], "availability_mode": "all"}

    def _topic(self, below: str) -> str:
        return f"{self._place.base}/{below}"


_MEASURED: dict[str, Any] = {"state_class": "measurement"}


def _value(key: str) -> str:
    """Return the template of a value. Home Assistant takes the word `None` for unknown."""
    return f"{{{{ value_json.{key} if value_json.{key} is not none else 'None' }}}}"


def _title(name: str) -> str:
    words = re.sub(r"[-_]+", " ", name).strip() or name
    return words[:1].upper() + words[1:]


def _slug(name: str) -> str:
    """Return the part of a name that is left in an entity id, which need not be unique."""
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_") or "x"
