"""A Home Assistant with its MQTT integration and nothing else, for tests. Runs where that is installed, as a program.

    python in_home_assistant.py FOLDER PORT

It connects to a broker on the loopback interface and obeys lines of JSON on its standard input, each answered by one:

    {"do": "states"}                    every entity by its unique id: state, attributes, platform, if it is disabled
    {"do": "call", "domain": …, "service": …, "data": …}
    {"do": "blueprint", "text": …}      whether it is a blueprint for an automation
    {"do": "warnings"}                  what the log had to say since the last time
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
from pathlib import Path
from typing import Any
from unittest.mock import Mock

from homeassistant import config_entries, core, loader
from homeassistant.helpers import (
    area_registry,
    category_registry,
    device_registry,
    entity,
    entity_registry,
    floor_registry,
    frame,
    issue_registry,
    label_registry,
    restore_state,
    translation,
)
from homeassistant.util.yaml import parse_yaml

REGISTRIES = (
    area_registry,
    category_registry,
    device_registry,
    entity_registry,
    floor_registry,
    issue_registry,
    label_registry,
)


class Warnings(logging.Handler):
    """Keeps warnings and worse."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line, with the error if there is one."""
        self.lines.append(
            f"{record.name}: {record.getMessage()} {record.exc_info[1] if record.exc_info else ''}".strip()
        )


async def begin(folder: str, port: int) -> core.HomeAssistant:
    """Start it, with its link to the broker."""
    hass = core.HomeAssistant(folder)
    hass.config.skip_pip = True
    hass.config_entries = config_entries.ConfigEntries(hass, {})
    loader.async_setup(hass)
    frame.async_setup(hass)
    entity.async_setup(hass)
    translation.async_setup(hass)
    for registry in REGISTRIES:
        if asyncio.iscoroutine(loading := registry.async_load(hass)):
            await loading
    await restore_state.async_load(hass)
    hass.config.components |= {"http", "file_upload"}  # of which pictures and forms are served, and nothing else
    hass.http = Mock()
    entry = config_entries.ConfigEntry(
        data={"broker": "127.0.0.1", "port": port, "protocol": "5"}, options={"discovery": True}, domain="mqtt",
        version=1, minor_version=2, title="broker", source="user", unique_id=None,
        discovery_keys={}, subentries_data=(),
    )  # fmt: skip
    hass.set_state(core.CoreState.running)
    await hass.config_entries.async_add(entry)
    return hass


def states(hass: core.HomeAssistant) -> dict[str, Any]:
    """Return what is known of every entity."""
    registry = entity_registry.async_get(hass)
    found = {}
    for known in registry.entities.values():
        state = hass.states.get(known.entity_id)
        found[known.unique_id] = {
            "entity_id": known.entity_id,
            "platform": known.domain,
            "name": known.original_name,
            "is_disabled": known.disabled_by is not None,
            "state": None if state is None else state.state,
            "attributes": {} if state is None else {key: str(value) for key, value in state.attributes.items()},
        }
    return found


async def obey(hass: core.HomeAssistant, order: dict[str, Any], warnings: Warnings) -> object:
    """Do what is asked for; return the answer."""
    match order["do"]:
        case "states":
            return states(hass)
        case "call":
            await hass.services.async_call(order["domain"], order["service"], order["data"], blocking=True)
            return None
        case "warnings":
            lines, warnings.lines = warnings.lines, []
            return lines
        case "blueprint":
            from homeassistant.components.automation.config import AUTOMATION_BLUEPRINT_SCHEMA
            from homeassistant.components.blueprint.models import Blueprint

            blueprint = Blueprint(
                parse_yaml(order["text"]), expected_domain="automation", schema=AUTOMATION_BLUEPRINT_SCHEMA
            )
            return {"name": blueprint.name, "inputs": sorted(blueprint.inputs)}
    raise ValueError(order)


async def main() -> None:
    """Serve until the standard input ends."""
    warnings = Warnings()
    logging.getLogger().addHandler(warnings)
    folder, port = sys.argv[1:]
    Path(folder).mkdir(parents=True, exist_ok=True)
    Path(folder, "configuration.yaml").touch()
    hass = await begin(folder, int(port))
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        try:
            answer = {"answer": await obey(hass, json.loads(line), warnings)}
        except Exception as error:  # noqa: BLE001 - the test shall see it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)
    await hass.async_stop(force=True)


if __name__ == "__main__":
    asyncio.run(main())
