"""From complete answers to files: a pure function, the same answers give the same files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.toml_source import as_toml
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.workbench.setup.camera_step import SIMULATED, table_of
from stadimeter.workbench.setup.question import CAMERA_FILE, CONFIGURATION
from stadimeter.workbench.setup.target import size_and_tolerance, target_table
from stadimeter.workbench.setup.wish_steps import (
    NOTHING,
    SCREEN,
    actuator_table,
    base_table,
    chosen_wishes,
    messenger_table,
)
from stadimeter.workbench.setup.wishes import Wish, fill_blanks

_TITLE = """\
# Written by `stadimeter init`. Change what you like:
#
#   stadimeter check stadimeter.toml     says in words what the rules below do
#   stadimeter test stadimeter.toml      tries the tests at the end; nothing moves
#   stadimeter run stadimeter.toml --watch

"""

_SCREEN_NAMES = {"vibration-motor": "motor", "led": "light", "relay": "light"}


def configuration_files(answers: Mapping[str, str], camera_model: CameraModel, model_file: str = "") -> dict[str, str]:
    """Return the text of each file by its name: the configuration, and the camera file unless there is one.

    Args:
        model_file: The camera file that is there already; empty to write one.
    """
    files = {CONFIGURATION: _configuration(answers, model_file or CAMERA_FILE)}
    return files if model_file else {CAMERA_FILE: camera_file_text(camera_model), **files}


def rule_names(answers: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the rules that the answers lead to."""
    return tuple(
        re.findall(r"^\[rules\.([\w-]+)\]$", "".join(wish.rules for wish in chosen_wishes(answers)), re.MULTILINE)
    )


def _configuration(answers: Mapping[str, str], model_file: str) -> str:
    outputs = _outputs(answers)
    tables: list[tuple[str, Mapping[str, Any]]] = [("camera", {**table_of(answers["camera"]), "model": model_file})]
    tables += _targets(answers)
    tables += [(f"actuators.{name}", actuator_table(answer)) for name, answer in outputs.values() if name]
    if "base" in answers:
        tables.append(("base", base_table(answers)))
    tables += _world(answers)
    if "broker" in answers:
        tables.append(("messenger", messenger_table(answers["broker"])))
    written: dict[str, str] = {}
    for name, table in tables:
        written[name] = f"[{name}]\n" + "".join(f"{key} = {as_toml(value)}\n" for key, value in table.items())
    rules = [_rules(wish, answers, outputs.get(wish.key, ("", ""))[0]) for wish in chosen_wishes(answers)]
    return _TITLE + "\n".join([*written.values(), *rules])


def _world(answers: Mapping[str, str]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return the world for a camera or a base that is not there."""
    if answers["camera"] == SIMULATED:
        size, _ = size_and_tolerance(answers["size"])
        return [("world", {"ball_diameter": size} if answers["target"] == "ball" else {})]
    return [("world", {})] if answers.get("base") == SCREEN else []


def _targets(answers: Mapping[str, str]) -> list[tuple[str, Mapping[str, Any]]]:
    kind, first = answers["target"], target_table(answers)
    targets: list[tuple[str, Mapping[str, Any]]] = [(f"targets.{kind}", first)]
    if "apart_second" in answers:
        second = answers["apart_second"]
        own = {"id": int(second)} if kind == "tag" else {"hsv": second}
        targets.append((f"targets.{kind}-2", {**first, **own}))
    return targets


def _outputs(answers: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return for each wish that drives an actuator its name and the answer; wishes with one answer share it."""
    named: dict[str, str] = {}
    outputs = {}
    for wish in chosen_wishes(answers):
        answer = answers.get(f"{wish.key}_output", NOTHING)
        if answer == NOTHING:
            continue
        driver = wish.output.split()[0] if answer == SCREEN else answer.split()[0]
        name = _SCREEN_NAMES.get(driver, driver)
        key = f"{answer} {name}" if answer == SCREEN else answer
        if key not in named:
            taken = sum(other == name or other.startswith(f"{name}-") for other in named.values())
            named[key] = f"{name}-{taken + 1}" if taken else name
        outputs[wish.key] = (named[key], answer)
    return outputs


def _rules(wish: Wish, answers: Mapping[str, str], output: str) -> str:
    figures = {blank.key: answers[f"{wish.key}_{blank.key}"] for blank in wish.blanks}
    if wish.key == "parking":
        nearest, farthest = (parse_length(answers[f"parking_{key}"]) for key in ("stop", "slow"))
        figures["middle"] = f"{(nearest + farthest) / 2:.4g} m"
    target = answers["target"]
    drives = f'actuator = "{output}"\n' if output else ""
    if wish.key != "apart":
        drives += f'target = "{target}"\n'
    return fill_blanks(wish.rules.replace("{drives}", drives), {**figures, "target": target, "output": output})
