"""The page on Home Assistant and its blueprints, with what the appliance really announces and publishes."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from stadimeter.app.messages import Reporter
from stadimeter.config.loader import load_configuration
from stadimeter.core.decision import Decision, RuleStatus, RuleTrace, SafetyMode
from stadimeter.core.measurement import Track, TrackStatus
from support.every_rule import ORDERS, announced

jinja2 = pytest.importorskip("jinja2")
yaml = pytest.importorskip("yaml")

ROOT = Path(__file__).parents[2]
APPLIANCE = load_configuration(ROOT / "config/appliance.toml")
BLUEPRINTS = sorted((ROOT / "deploy/homeassistant").glob("*.yaml"))
PAGE = (ROOT / "docs/mqtt.md").read_text(encoding="utf-8")
BASE = "stadimeter/shelf"


def published(*traces: RuleTrace) -> dict[str, str]:
    """Return the newest payload of each topic after these cycles of a run."""
    reporter = Reporter(boot_id="boot")
    newest = {f"{BASE}/availability": "online"}  # the link's own; see tests/messaging/test_mqtt.py
    messages = list(reporter.opening(APPLIANCE.plan.rules))
    for second, trace in enumerate(traces):
        decision = Decision(
            commands=(), events=(), tracks=(Track(target="ball", status=TrackStatus.SEARCHING),), outputs=(),
            safety=SafetyMode.ACTIVE, safety_reason="", rules=(trace,),
        )  # fmt: skip
        messages += reporter.messages(float(second), lambda: "2026-06-01T12:00:00.000+00:00", decision)
    return newest | {f"{BASE}/{each.topic}": each.payload for each in messages}


def shown(entity: dict[str, Any], newest: dict[str, str]) -> str:
    """Return what Home Assistant shows: its MQTT entities render a template, and take `None` for unknown."""
    if any(newest[each["topic"]] != "online" for each in entity["availability"]):
        return "unavailable"
    value = json.loads(newest[entity["state_topic"]])
    return str(jinja2.Template(entity["value_template"]).render(value_json=value))


def trace(status: RuleStatus, active: bool | None) -> RuleTrace:
    return RuleTrace(rule="too-close", status=status, active=active)


UNKNOWN, IDLE = trace(RuleStatus.UNKNOWN, None), trace(RuleStatus.IDLE, False)
ACTIVE, BLIND = trace(RuleStatus.ACTIVE, True), trace(RuleStatus.UNKNOWN, True)


@pytest.mark.parametrize(
    ("traces", "expected"),
    [
        ((), "unavailable"),
        ((UNKNOWN,), "unavailable"),
        ((UNKNOWN, IDLE), "OFF"),
        ((IDLE, UNKNOWN), "unavailable"),
        ((IDLE, ACTIVE), "ON"),
        ((ACTIVE, BLIND), "ON"),
    ],
)
def test_a_rule_that_cannot_be_judged_is_neither_on_nor_off(traces, expected):
    entity = json.loads(announced(APPLIANCE).message().payload)["components"]["rule_too-close"]
    assert entity["availability_mode"] == "all"
    assert shown(entity, published(*traces)) == expected
    if traces == (UNKNOWN,):
        assert shown({**entity, "availability": []}, published(UNKNOWN)) == "None", "who goes by the state alone"


def test_the_page_names_every_kind_of_entity():
    (table,) = re.findall(r"\| entity \| shows \|\n(.*?)\n\n", PAGE, re.DOTALL)
    first_cells = " ".join(row.split(" | ")[0] for row in table.splitlines())
    found = announced(APPLIANCE, orders=ORDERS).components.values()
    assert set(re.findall(r"`(\w+)`", first_cells)) == {each["platform"] for each in found}


class _Loader(yaml.SafeLoader):  # type: ignore[misc,name-defined] # it has no types here
    """Reads `!input`, of which the name is kept."""


_Loader.add_constructor("!input", lambda loader, node: Input(loader.construct_scalar(node)))


class Input(str):
    """The name of an input."""

    __slots__ = ()


def inputs_used(value: object) -> set[str]:
    if isinstance(value, Input):
        return {str(value)}
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return {name for part in parts for name in inputs_used(part)}


@pytest.mark.parametrize("file", BLUEPRINTS, ids=lambda file: file.stem)
def test_a_blueprint_is_an_automation_that_uses_each_of_its_inputs(file):
    found = yaml.load(file.read_text(encoding="utf-8"), _Loader)
    about = found["blueprint"]
    assert about["domain"] == "automation"
    assert about["name"].startswith("Stadimeter: ")
    assert set(found) <= {"blueprint", "mode", "max", "variables", "triggers", "conditions", "actions"}
    assert inputs_used({key: value for key, value in found.items() if key != "blueprint"}) == set(about["input"])
    assert all("selector" in each for each in about["input"].values())
    assert f"`{file.name}`" in PAGE


def test_no_blueprint_takes_unknown_for_off():
    """Nothing happens because an entity became `off` that was not `on` before."""
    assert len(BLUEPRINTS) == 3
    for file in BLUEPRINTS:
        found = yaml.load(file.read_text(encoding="utf-8"), _Loader)
        for trigger in found["triggers"]:
            assert trigger.get("to") != "off" or trigger.get("from") == "on"
