"""From answers to files: the configuration that recipes and the other answers come to. Pure functions."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from typing import Any

from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.driver_tables import TARGET
from stadimeter.core.camera_model import CameraModel
from stadimeter.workbench.setup import recipes
from stadimeter.workbench.setup.camera_step import SIMULATED, table_of
from stadimeter.workbench.setup.question import CAMERA_FILE, CONFIGURATION
from stadimeter.workbench.setup.target import IN_ROOM, members_of, target_table

_MEMBER = re.compile(r".*\{member\}.*")


def chosen_recipes(answers: Mapping[str, str]) -> tuple[recipes.Recipe, ...]:
    """Return the recipes of the answers."""
    known = recipes.load_recipes()
    return tuple(known[key] for key in answers.get("recipe", "").split())


def blank_answers(recipe: recipes.Recipe, answers: Mapping[str, str]) -> dict[str, str]:
    """Return the answers to the blanks of a recipe by their own keys, as far as they are given."""
    own = {blank.key: answers.get(f"{recipe.key}_{blank.key}") for blank in recipe.blanks}
    return {key: text for key, text in own.items() if text is not None}


def parts_of_answers(answers: Mapping[str, str], kind: str) -> dict[str, str]:
    """Return the answers for what is on pins by their keys: each ``output``, or each ``button``."""
    keys = [f"{each.key}_{kind}" for each in chosen_recipes(answers)]
    return {key: answers[key] for key in keys if answers.get(key, recipes.NOTHING) != recipes.NOTHING}


def base_table(answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the table ``[base]``: its driver, the options of the answers ``base_…``, and the limits of every base."""
    speed = next((answers[key] for key in answers if key.endswith("_speed") and not key.startswith("base_")), "0.5 m/s")
    limits = {"max_speed": speed, "max_turn_rate": "60 deg/s"}
    if answers["base"] == recipes.SCREEN:
        return {"driver": "simulated", **limits}
    own = {
        key.removeprefix("base_"): recipes.option_value(text)
        for key, text in answers.items()
        if key.startswith("base_")
    }
    return {"driver": answers["base"], **own, **limits}


def messenger_table(broker: str) -> dict[str, Any]:
    """Return the table ``[messenger]``."""
    host, _, port = broker.partition(":")
    return {"driver": "mqtt", "host": host, **({"port": recipes.option_value(port)} if port else {})}


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
    if any(recipe.brings_lens for recipe in chosen_recipes(answers)):
        return {CONFIGURATION: _configuration(answers, {})}
    files = {CONFIGURATION: _configuration(answers, {"model": model_file or CAMERA_FILE})}
    lens = f"{recipes.lines(_settings('lens', answers))}\n\n{camera_file_text(camera_model)}".lstrip()
    return files if model_file else {CAMERA_FILE: lens, **files}


def _settings(part: str, answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys that the recipes add to a table: ``camera``, ``target`` or ``lens``."""
    chosen = chosen_recipes(answers)
    texts = [recipes.fill(getattr(each, part), each.texts(blank_answers(each, answers))) for each in chosen]
    return tomllib.loads("\n".join(texts))


def rule_names(answers: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the rules that the answers lead to."""
    texts = "".join(recipe.configuration for recipe in chosen_recipes(answers))
    return tuple(re.findall(r"^\[rules\.([\w-]+)\]$", texts, re.MULTILINE))


def _configuration(answers: Mapping[str, str], lens: Mapping[str, str]) -> str:
    outputs = _outputs(answers)
    camera = {**table_of(answers["camera"]), **lens, **_settings("camera", answers)}
    target = {**target_table(answers), **_settings("target", answers)}
    tables: list[tuple[str, Mapping[str, Any]]] = [("camera", camera), (f"targets.{answers['target']}", target)]
    tables += [(f"actuators.{name}", recipes.part_table(answer)) for name, answer in dict(outputs.values()).items()]
    if "base" in answers:
        tables.append(("base", base_table(answers)))
    if answers["camera"] == SIMULATED:
        tables.append(("world", {"ball_diameter": target["diameter"]} if target[TARGET.key] == IN_ROOM else {}))
    elif answers.get("base") == recipes.SCREEN:
        tables.append(("world", {}))
    if "broker" in answers:
        tables.append(("messenger", messenger_table(answers["broker"])))
    parts = [f"[{name}]\n{recipes.lines(table)}\n" for name, table in tables]
    for recipe in chosen_recipes(answers):
        second, rules = _filled(recipe, answers, outputs.get(recipe.key, ("", ""))[0])
        parts += [each for each in (second, rules) if each and each not in parts]  # two recipes may share a target
    return _TITLE + "\n".join(parts)


def _outputs(answers: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Return for each recipe that drives an actuator its name and the answer; recipes with one answer share it."""
    named: dict[str, str] = {}
    outputs = {}
    for recipe in chosen_recipes(answers):
        answer = answers.get(f"{recipe.key}_output", recipes.NOTHING)
        if answer == recipes.NOTHING:
            continue
        driver = recipe.output.split()[0] if answer == recipes.SCREEN else answer.split()[0]
        name = _SCREEN_NAMES.get(driver, driver)
        key = f"{answer} {name}" if answer == recipes.SCREEN else answer
        if key not in named:
            taken = sum(other == name or other.startswith(f"{name}-") for other in named.values())
            named[key] = f"{name}-{taken + 1}" if taken else name
        outputs[recipe.key] = (named[key], answer)
    return outputs


def _filled(recipe: recipes.Recipe, answers: Mapping[str, str], output: str) -> tuple[str, str]:
    """Return the second target that a recipe needs, empty for none, and its rules and tests."""
    texts = {**recipe.texts(blank_answers(recipe, answers)), "group": answers["target"], "output": output}
    members, name = members_of(answers), answers["target"]
    target = name if members == (name,) else f"{name}-nearest"
    drives = (f'actuator = "{output}"\n' if output else "") + f'target = "{target}"\n'
    rules, begins, tests = recipe.configuration.replace("{drives}", drives).partition("[[tests]]")
    tests = _MEMBER.sub(lambda line: "\n".join(line[0].replace("{member}", each) for each in members), tests)
    text = recipes.fill(rules, {**texts, "target": target}) + recipes.fill(
        begins + tests, {**texts, "target": members[0]}
    )
    if not text.startswith("[targets."):
        return "", text
    second, _, rest = text.partition("\n\n")
    return f"{second}\n", rest
