"""Questions on what shall happen, of recipes, blanks and outputs; and the configuration that all answers come to."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from stadimeter.config.camera_file import camera_file_text
from stadimeter.config.driver_tables import BASE, TARGET
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import DriverOptions, driver_names, load_driver
from stadimeter.config.units import parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ConfigError, DriverError, Problem
from stadimeter.ranging.similar_triangles import RELIABLE_PX, farthest_m
from stadimeter.workbench.doctor.checks import Computer
from stadimeter.workbench.setup import recipes
from stadimeter.workbench.setup.camera_step import SIMULATED, table_of
from stadimeter.workbench.setup.question import (
    CAMERA_FILE,
    CONFIGURATION,
    Accepted,
    Known,
    Option,
    Question,
    SetupStep,
    words_of,
)
from stadimeter.workbench.setup.target import (
    IN_ROOM,
    WHOLE_SHARE,
    build_target,
    members_of,
    target_shape,
    target_table,
    thing_of,
)

# What most who build a robot that follows have.
USUAL = "gpio-motors"

# Ready distances are within this share of how far away the target is found reliably: hysteresis needs the rest.
WITHIN_REACH = 0.8


class RecipeStep(SetupStep):
    """The wish for what shall happen: the name of a recipe, or of several."""

    key = "recipe"

    asked = Question(
        text="What shall happen?",
        options=tuple(Option(each.key, each.title, each.group) for each in recipes.load_recipes().values()),
        ready="near",
        form="several of them, by name or number, such as near far",
    )

    def accept(self, known: Known, text: str) -> Accepted:
        """Take recipes by their names."""
        names = list(dict.fromkeys(words_of(text.replace(",", " "))))
        possible = recipes.load_recipes()
        wrong = [name for name in names if name not in possible]
        if wrong or not names:
            raise ConfigError(f"{' '.join(wrong) or text!r} is none of {', '.join(possible)}")
        chosen = [possible[name] for name in names]
        robots = [each.key for each in chosen if each.output == "base"]
        if len(robots) > 1:
            raise ConfigError(f"{' and '.join(robots)} would drive one robot; choose one of them")
        if not any(each.configuration and not each.brings_lens for each in chosen):
            raise ConfigError(f"{' '.join(names)} alone does nothing; add what shall happen, such as near")
        file = "the stereo file" if any(each.brings_lens for each in chosen) else known.model_file
        if file and any(each.lens for each in chosen):
            raise ConfigError(f"write medium and port_m into {file} for that, if it was calibrated in air")
        if any(each.needs_several for each in chosen) and len(members_of(known.answers)) == 1:
            raise ConfigError("crowd is for several of one kind; go back to the target: choose balls, tags or people")
        return Accepted(answer=" ".join(names))


def recipe_steps(answers: Mapping[str, str]) -> Iterator[SetupStep]:
    """Yield the questions that the chosen recipes leave open."""
    for recipe in chosen_recipes(answers):
        yield from (BlankStep(recipe, blank) for blank in recipe.blanks)
        if recipe.output == "base":
            yield BaseStep()
            if (model := base_drivers().get(answers.get("base", recipes.SCREEN))) is not None:
                yield from (PartStep(recipe, blank) for blank in recipes.driver_blanks(model, "base_"))
        elif recipe.output == "mqtt":
            yield PartStep(recipe, BROKER)
        elif recipe.output:
            yield OutputStep(recipe)


def complete_answers(known: Known, changed: Mapping[str, str]) -> dict[str, str] | None:
    """Return answers that make a configuration: those given, those that are being changed, else the ready ones.

    Outputs that are not chosen yet are shown on the screen only. None where a question is left without a ready answer.
    """
    answers = {**known.answers, **changed}
    for step in recipe_steps(answers):
        is_output = step.kind == "output" or step.key == "base"
        answers.setdefault(step.key, recipes.SCREEN if is_output else step.question(known).ready)
        if not answers[step.key]:
            return None
    return answers


def check_answer(known: Known, recipe: recipes.Recipe, key: str, text: str) -> None:
    """Load the configuration that the answers so far and this one make; raise what is wrong with it.

    Where it stands is nothing that a person has written, so only the sentences are kept.
    """
    before, _, _ = f"{known.answers['recipe']} ".partition(f"{recipe.key} ")  # what is behind is asked later
    answers = complete_answers(known, {key: text, "recipe": before + recipe.key})
    if answers is None:
        return
    try:
        files = configuration_files(answers, known.lens, known.model_file)
        load_configuration(known.file, texts={known.path(name): each for name, each in files.items()})
    except (ConfigError, ValueError) as error:
        problems = error.problems if isinstance(error, ConfigError) else (Problem(str(error)),)
        raise ConfigError(Problem(each.message, hint=each.hint) for each in problems) from error


def reach_m(known: Known) -> tuple[float, float]:
    """Return from which distance on the target is whole in the picture, and up to which it is found reliably."""
    if known.camera_model is None:
        return 0.0, math.inf
    if known.reach_m is None:
        shape, lens = target_shape(build_target(known)), known.camera_model.for_frame(known.frame)
        whole_px = WHOLE_SHARE * min(lens.width_px, lens.height_px)
        known.reach_m = farthest_m(shape, lens, whole_px), farthest_m(shape, lens, RELIABLE_PX)
    return known.reach_m


def is_distance(recipe: recipes.Recipe, blank: recipes.Blank) -> bool:
    """Check whether a blank is how far away the target is, rather than a size, or something of camera and lens."""
    return blank.unit == "m" and bool(recipe.output) and blank.key != "side"


@dataclass
class BlankStep(SetupStep):
    """A blank of a recipe."""

    recipe: recipes.Recipe
    blank: recipes.Blank
    kind = "blank"

    def __post_init__(self) -> None:
        self.key = f"{self.recipe.key}_{self.blank.key}"

    def question(self, known: Known) -> Question:
        """Ask for it, with an answer ready that this camera can serve."""
        _, seen_m = reach_m(known)
        reach = f"With this camera, the {thing_of(known.answers)} is found reliably up to {seen_m:.2g} m."
        return Question(
            text=f"{self.recipe.title[0].upper()}{self.recipe.title[1:]}. {self.blank.text}",
            found=(reach,) if is_distance(self.recipe, self.blank) else (),
            ready=self._ready(known),
            form="; ".join(filter(None, (f"such as {self.blank.ready}", self.blank.form))),
        )

    def _ready(self, known: Known) -> str:
        """Return the ready answer: of a second tag the first number that is not the target itself.

        Distances are all nearer, or all farther, where the camera would not see the target at one of them.
        """
        if self.blank.kind == "part":
            return self.blank.ready if Computer().is_pi else recipes.SCREEN
        if self.blank.kind == "number":
            return next(text for text in (self.blank.ready, "8") if not _is_target(known, text))
        if not is_distance(self.recipe, self.blank):
            return self.blank.ready
        whole_m, seen_m = reach_m(known)
        lengths_m = [parse_length(each.ready) for each in self.recipe.blanks if is_distance(self.recipe, each)]
        nearer = min(1.0, WITHIN_REACH * seen_m / max(lengths_m))
        scale = max(nearer, whole_m / min(lengths_m))
        return self.blank.ready if scale == 1 else f"{scale * parse_length(self.blank.ready):.2g} m"

    def accept(self, known: Known, text: str) -> Accepted:
        """Check its limits and what follows from it; and whether the camera can serve it."""
        self.blank.check(text, {**known.answers, **blank_answers(self.recipe, known.answers)})
        if self.blank.kind == "number" and _is_target(known, text):
            raise ConfigError(f"{text!r} is the target itself, or would be taken for it; choose another number")
        check_answer(known, self.recipe, self.key, text)
        _, seen_m = reach_m(known)
        if not is_distance(self.recipe, self.blank) or parse_length(text) <= seen_m:
            return Accepted(answer=text)
        far = f"That is farther than the {thing_of(known.answers)} is found reliably, {seen_m:.2g} m."
        return Accepted(answer=text, notes=(far,), doubt=True)


def _is_target(known: Known, number: str) -> bool:
    """Check whether the target may be this tag of the usual family: it has the same number, or any."""
    own = target_table(known.answers)
    is_of_family = own["detector"] == "tag" and own.get("family") in {"36h11", "apriltag-36h11"}
    return is_of_family and number in {str(own.get("id", number)), *map(str, own.get("ids", ()))}


@dataclass
class PartStep(SetupStep):
    """An option of a base, or the broker: what there is one of for all recipes."""

    recipe: recipes.Recipe
    blank: recipes.Blank
    kind = "blank"

    def __post_init__(self) -> None:
        self.key = self.blank.key

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """Ask what its description says; a port is one of those that there are."""
        options = tuple(Option(name, "a serial port of this computer") for name in self.blank.names)
        return Question(text=self.blank.text, options=options, ready=self.blank.ready, form=self.blank.form)

    def accept(self, known: Known, text: str) -> Accepted:
        """Check what follows from it."""
        check_answer(known, self.recipe, self.key, text)
        return Accepted(answer=text)


BROKER = recipes.Blank(
    key="broker",
    text="Where is the MQTT broker?",
    ready="127.0.0.1",
    form="its name or address, such as homeassistant.local; a port behind a colon if it is not 1883",
    kind="text",
)


def base_drivers() -> dict[str, type[DriverOptions] | None]:
    """Return the installed drivers of real bases that drive, by name; None for one whose library is missing."""
    found: dict[str, type[DriverOptions] | None] = {}
    for name in driver_names(BASE.group):
        try:
            model = load_driver(BASE.group, name)
        except DriverError:
            found[name] = None
        else:
            if not model.needs_world and not model.only_turns:
                found[name] = model
    return found


class BaseStep(SetupStep):
    """The question of what moves the robot."""

    key = "base"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """List the bases that have a driver, and the screen."""
        options = [
            Option(name, model.title if model else "its library is not installed")
            for name, model in base_drivers().items()
        ]
        return Question(
            text="What is the robot's base?",
            options=(*options, Option(recipes.SCREEN, "no robot yet; the live view shows what it would do")),
            ready=USUAL if Computer().is_pi else recipes.SCREEN,
        )

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Check that there is such a driver."""
        names = base_drivers()
        if text != recipes.SCREEN and text not in names:
            raise ConfigError(f"{text!r} is none of {', '.join(names)} and {recipes.SCREEN}")
        if text != recipes.SCREEN:
            load_driver(BASE.group, text)
        return Accepted(answer=text)


@dataclass
class OutputStep(SetupStep):
    """The question of what a recipe drives."""

    recipe: recipes.Recipe
    kind = "output"

    def __post_init__(self) -> None:
        self.key = f"{self.recipe.key}_output"

    def question(self, known: Known) -> Question:
        """Propose the usual output on a Raspberry Pi, on pin 24 where its own is taken, and the screen elsewhere."""
        driver, pin = self.recipe.output.split()
        others = {answer for key, answer in known.answers.items() if key.endswith(("_output", "_button"))}
        is_taken = any(each != self.recipe.output and each.split()[1:] == [pin] for each in others)
        usual = f"{driver} 24" if is_taken else self.recipe.output
        wired = Option(usual, f"wired to GPIO {usual.split()[1]} of a Raspberry Pi")
        screen = Option(recipes.SCREEN, "nothing is wired yet; the live view shows it")
        report = [] if self.recipe.needs_output else [Option(recipes.NOTHING, "it only reports")]
        both = [wired, screen] if Computer().is_pi else [screen, wired]
        return Question(
            text=f"What shall “{self.recipe.title}” drive?",
            options=(*both, *report),
            ready=both[0].answer,
            form="buzzer, led, relay or vibration-motor with its GPIO, such as buzzer 24",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check that there is such an output, and that the pin is free."""
        if text != recipes.NOTHING or self.recipe.needs_output:
            check_answer(known, self.recipe, self.key, text)
        return Accepted(answer=text)


# The configuration that recipes and the other answers come to ---------------------------------------------------------

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
