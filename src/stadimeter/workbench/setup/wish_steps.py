"""Questions about the wishes: which ones, their figures, and the outputs that they drive."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from pydantic.fields import FieldInfo
from pydantic.json_schema import WithJsonSchema

from stadimeter.config.driver_tables import ACTUATOR, BASE, DRIVER_KINDS, MESSENGER, TARGET
from stadimeter.config.extras import require
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import DriverOptions, driver_names, load_driver
from stadimeter.config.schema import documented_fields
from stadimeter.config.toml_source import as_toml
from stadimeter.config.units import PortMark
from stadimeter.errors import ConfigError, DriverError, Problem
from stadimeter.ranging.similar_triangles import RELIABLE_PX, farthest_m
from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.setup.files import (
    NO_BUTTON,
    NOTHING,
    SCREEN,
    VISIT_S,
    WISHES,
    Blank,
    Wish,
    actuator_table,
    base_table,
    blank_answers,
    button_table,
    configuration_files,
    figure_si,
    find_wishes,
    messenger_table,
    place_table,
    ready_answers,
    tag_name,
    tag_table,
)
from stadimeter.workbench.setup.question import Accepted, Known, Option, Question, SetupStep, words_of
from stadimeter.workbench.setup.target import WHOLE_SHARE, build_target, kind_of, members_of, target_shape, target_table

# Questions about the robot's base: which driver, of those that are installed, and the options that it needs -----------

# What most who build a robot that follows have.
USUAL = "gpio-motors"


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
            options=(*options, Option(SCREEN, "no robot yet; the live view shows what it would do")),
            ready=USUAL if Computer().is_pi else SCREEN,
        )

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Check that there is such a driver."""
        names = base_drivers()
        if text != SCREEN and text not in names:
            raise ConfigError(f"{text!r} is none of {', '.join(names)} and {SCREEN}")
        if text != SCREEN:
            load_driver(BASE.group, text)
        return Accepted(answer=text)


def option_steps(driver: str) -> Iterator[BaseOptionStep]:
    """Yield a question for each option of a base that it needs, or has an example for."""
    model = base_drivers().get(driver)
    for name, field in (model.model_fields if model else {}).items():
        if model and (field.is_required() or field.examples):
            yield BaseOptionStep(model, name)


@dataclass
class BaseOptionStep(SetupStep):
    """An option of a base."""

    model: type[DriverOptions]
    option: str
    kind = "blank"

    def __post_init__(self) -> None:
        self.key = f"base_{self.option}"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """Ask what the option's description says; a port is one of those that there are."""
        field = self.model.model_fields[self.option]
        found = _ports() if any(isinstance(mark, PortMark) for mark in field.metadata) else []
        example = found[0] if found else _example(field)
        words = dict(documented_fields(self.model)).get(self.option, "")
        return Question(
            text=f"{self.option}: {words}",
            options=tuple(Option(port, "a serial port of this computer") for port in found),
            ready=example,
            form=f"such as {example}" if example else "",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the option; the last one together with the others."""
        answers = {**known.answers, self.key: text}
        is_last = all(step.key in answers for step in option_steps(answers["base"]))
        known.check(BASE, ("base",), base_table(answers), None if is_last else [self.option])
        return Accepted(answer=text)


def _ports() -> list[str]:
    return sorted(map(str, Path("/dev/serial/by-id").glob("*")))


def _example(field: FieldInfo) -> str:
    """Return an example as a person would write it: the option's own, else that of its type; empty for none."""
    of_type = [
        example
        for mark in field.metadata
        if isinstance(mark, WithJsonSchema)
        for example in (mark.json_schema or {}).get("examples", ())
    ]
    if any(isinstance(mark, PortMark) for mark in field.metadata):
        of_type = ["/dev/ttyUSB0"]
    for example in (*(field.examples or ()), *of_type):
        return example if isinstance(example, str) and example.isprintable() else as_toml(example)
    return ""


class WishStep(SetupStep):
    """The question of what shall happen."""

    key = "wish"

    asked = Question(
        text="What shall happen?",
        options=tuple(Option(wish.key, wish.title, wish.group) for wish in WISHES),
        ready="near",
        form="several of them, by name or number, such as near far",
    )

    def accept(self, known: Known, text: str) -> Accepted:
        """Take wishes by their names."""
        names = list(dict.fromkeys(words_of(text.replace(",", " "))))
        possible = [wish.key for wish in WISHES]
        wrong = [name for name in names if name not in possible]
        if wrong or not names:
            raise ConfigError(f"{' '.join(wrong) or text!r} is none of {', '.join(possible)}")
        chosen = find_wishes({"wish": " ".join(names)})
        robots = [wish.key for wish in chosen if wish.output == "base"]
        if len(robots) > 1:
            raise ConfigError(f"{' and '.join(robots)} would drive one robot; choose one of them")
        if not any(wish.rules and not wish.brings_lens for wish in chosen):
            raise ConfigError(f"{' '.join(names)} alone does nothing; add what shall happen, such as near")
        file = "the stereo file" if any(wish.brings_lens for wish in chosen) else known.model_file
        if file and any(wish.lens for wish in chosen):
            raise ConfigError(f"write medium and port_m into {file} for that, if it was calibrated in air")
        if any(wish.needs_several for wish in chosen) and len(members_of(known.answers)) == 1:
            raise ConfigError("crowd is for several of one kind; go back to the target, and choose balls or tags")
        return Accepted(answer=" ".join(names))


def wish_steps(answers: Mapping[str, str]) -> Iterator[SetupStep]:
    """Yield the questions that the chosen wishes leave open."""
    for wish in find_wishes(answers):
        yield from (BlankStep(wish, blank) for blank in wish.blanks)
        if wish.output == "base":
            yield from (BaseStep(), *option_steps(answers.get("base", SCREEN)))
        elif wish.output:
            yield BrokerStep() if wish.output == "mqtt" else WishOutputStep(wish)


def complete_answers(known: Known, changed: Mapping[str, str]) -> dict[str, str]:
    """Return answers that make a configuration: those given, those that are being changed, else the ready ones.

    Outputs that are not chosen yet are shown on the screen only.

    Raises:
        ConfigError: There is no wish yet, or no lens.
    """
    if known.camera_model is None or "wish" not in known.answers:
        raise ConfigError("first choose what shall happen")
    answers = {**known.answers, **changed}
    for step in wish_steps(answers):
        is_output = step.kind == "output" or step.key == "base"
        answers.setdefault(step.key, SCREEN if is_output else step.question(known).ready)
    return answers


def reliable_range_m(known: Known, size_px: float = RELIABLE_PX) -> float:
    """Return the distance up to which the target is found reliably; of another size, where it looks that large."""
    if known.camera_model is None:
        return math.inf
    return farthest_m(target_shape(build_target(known)), known.camera_model.for_frame(known.frame), size_px)


def ready_for(wish: Wish, known: Known) -> dict[str, str]:
    """Return the ready answers to the blanks that this camera can serve."""
    whole_m = reliable_range_m(known, WHOLE_SHARE * min(known.frame.image.shape[:2])) if known.camera_model else 0.0
    return ready_answers(wish, reliable_range_m(known), whole_m)


# Second targets that are proposed where the usual one is the target itself.
OTHER_TAGS = ("36h11 8, 8 cm", "25h9 7, 8 cm")

# How an answer may look beside the example.
_FORMS = {
    "tag": "; `stadimeter print tag` makes one",
    "button": f"; {NO_BUTTON} if there is no button yet",
    "place": " for Berlin, with south and west below zero",
}


def taken_by(known: Known, pin: object, key: str, same: str = "") -> str:
    """Return the output or button that is on a pin already, such as ``buzzer 23``; empty for none.

    Args:
        key: Of the answer that asks.
        same: An output that may share its pin.
    """
    parts = [answer for other, answer in known.answers.items() if other.endswith("_output") and other != key]
    parts += [f"button {answer}" for other, answer in blank_answers(known.answers, "button").items() if other != key]
    return next((each for each in parts if each.split()[1:] == [str(pin)] and each != same), "")


def _is_seen_as_target(known: Known, tag: str) -> bool:
    """Check whether the target may be this tag: it is one of the same family, with the same number or any."""
    own, other = target_table(known.answers), tag_table(tag)
    return own.get("family") == other["family"] and own.get("id", other.get("id")) == other.get("id")


@dataclass
class BlankStep(SetupStep):
    """A figure that a wish leaves open."""

    wish: Wish
    blank: Blank
    kind = "blank"

    def __post_init__(self) -> None:
        self.key = f"{self.wish.key}_{self.blank.key}"

    def question(self, known: Known) -> Question:
        """Ask for it, with an answer ready that this camera can serve."""
        seen_m = reliable_range_m(known)
        reach = f"With this camera, the {kind_of(known.answers).thing} is found reliably up to {seen_m:.2g} m."
        ready = {**ready_for(self.wish, known), self.blank.key: self._ready(known)}
        return Question(
            text=f"{self.wish.title[0].upper()}{self.wish.title[1:]}. {self.blank.text}",
            found=(reach,) if self.blank.is_length else (),
            ready=ready[self.blank.key],
            form=f"such as {self.blank.ready}{_FORMS.get(self.blank.kind, '')}",
            sentence=self.wish.sentence,
            blanks=tuple({"key": each.key, "text": each.text, "ready": ready[each.key]} for each in self.wish.blanks),
        )

    def _ready(self, known: Known) -> str:
        """Return the ready answer; of tags the first that is not the target itself."""
        if self.blank.kind == "button":
            return self.blank.ready if Computer().is_pi else NO_BUTTON
        if self.blank.kind == "tag":
            given = [answer for key, answer in blank_answers(known.answers, "tag").items() if key != self.key]
            others = (*given, self.blank.ready, *OTHER_TAGS)
            return next((each for each in others if not _is_seen_as_target(known, each)), "")
        return ready_for(self.wish, known)[self.blank.key]

    def accept(self, known: Known, text: str) -> Accepted:
        """Check its unit, and whether the camera can serve it; of a part, whether there can be such a one."""
        match self.blank.kind:
            case "tag":
                self._check_tag(known, text)
            case "button":
                choice = known.choose(DRIVER_KINDS["buttons"], ("buttons", self.wish.key), button_table(text))
                if other := taken_by(known, getattr(choice.options, "pin", None), self.key):
                    raise ConfigError(f"pin {text} is taken by {other!r}")
            case "place":
                place_table(text)
                require("sun", "the sun's times")
            case "setting" | "metres" | "landmarks" | "camera":
                self._check_setting(known, text)
            case _:
                return self._accept_figure(known, text)
        return Accepted(answer=text)

    def _check_tag(self, known: Known, text: str) -> None:
        table = tag_table(text)
        known.choose(TARGET, ("targets", tag_name(text)), table)
        if "id" not in table:
            raise ConfigError(f"{text!r} has no number; write it such as {self.blank.ready!r}")
        if _is_seen_as_target(known, text):
            raise ConfigError(f"{text!r} is the target itself, or would be taken for it; choose another number")
        others = {key: each for key, each in blank_answers(known.answers, "tag").items() if key != self.key}
        if other := next((each for each in others.values() if tag_name(each) == tag_name(text) and each != text), ""):
            raise ConfigError(f"{tag_name(text)} is {other!r} already")

    def _check_setting(self, known: Known, text: str) -> None:
        """Check what follows from it in the configuration that the answers make so far."""
        before, _, _ = f"{known.answers['wish']} ".partition(f"{self.wish.key} ")  # what is behind is asked later
        changed = {self.key: text, "wish": before + self.wish.key}
        try:
            files = configuration_files(complete_answers(known, changed), known.lens, known.model_file)
            load_configuration(known.file, texts={known.path(name): each for name, each in files.items()})
        except (ConfigError, ValueError) as error:  # where it stands is nothing that a person has written
            problems = error.problems if isinstance(error, ConfigError) else (Problem(str(error)),)
            raise ConfigError(Problem(each.message, hint=each.hint) for each in problems) from error

    def _accept_figure(self, known: Known, text: str) -> Accepted:
        value = figure_si(text, self.blank)
        if before := self.blank.beyond or self.blank.within:
            other = known.answers[f"{self.wish.key}_{before}"]
            way, sign = ("farther", 1) if self.blank.beyond else ("nearer", -1)
            if sign * value <= sign * figure_si(other, self.blank):
                raise ConfigError(f"{text} is not {way} than {other}, as it must be")
        if self.blank.holds and value < VISIT_S * int(visits := known.answers[f"{self.wish.key}_{self.blank.holds}"]):
            raise ConfigError(f"{text} is too short for {visits} visits, each of about {VISIT_S:.0f} s")
        times = [answer for key, answer in blank_answers(known.answers, "time").items() if key != self.key]
        if self.blank.kind == "time" and self.wish.output != "mqtt" and text in times:
            raise ConfigError(f"{text} is when it begins")
        seen_m = reliable_range_m(known)
        if not self.blank.is_length or value <= seen_m:
            return Accepted(answer=text)
        far = f"That is farther than the {kind_of(known.answers).thing} is found reliably, {seen_m:.2g} m."
        return Accepted(answer=text, notes=(far,), doubt=True)


@dataclass
class WishOutputStep(SetupStep):
    """The question of what a wish drives."""

    wish: Wish
    kind = "output"

    def __post_init__(self) -> None:
        self.key = f"{self.wish.key}_output"

    def question(self, known: Known) -> Question:
        """Propose the usual output on a Raspberry Pi, on pin 24 where its own is taken, and the screen elsewhere."""
        driver, pin = self.wish.output.split()
        usual = f"{driver} 24" if taken_by(known, pin, self.key, self.wish.output) else self.wish.output
        wired = Option(usual, "wired to a pin of the header, by its BCM number")
        screen = Option(SCREEN, "nothing is wired yet; the live view shows it")
        report = [] if self.wish.needs_output else [Option(NOTHING, "it only reports")]
        both = [wired, screen] if Computer().is_pi else [screen, wired]
        return Question(
            text=f"What shall “{self.wish.title}” drive?",
            options=(*both, *report),
            ready=both[0].answer,
            form="buzzer, led, relay or vibration-motor, and a pin, such as buzzer 23; screen; or nothing",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check that there is such an output, and that the pin is free."""
        driver, *pin = text.split() or [""]
        if text == NOTHING and not self.wish.needs_output:
            return Accepted(answer=text)
        known.choose(ACTUATOR, ("actuators", driver), actuator_table(text))
        if pin and (other := taken_by(known, pin[0], self.key, text)):
            raise ConfigError(f"pin {pin[0]} is taken by {other!r}")
        return Accepted(answer=text)


class BrokerStep(SetupStep):
    """The MQTT broker."""

    key = "broker"

    asked = Question(
        text="Where is the MQTT broker?",
        ready="127.0.0.1",
        form="its name or address, such as homeassistant.local; a port behind a colon if it is not 1883",
    )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check it as the messenger's."""
        known.choose(MESSENGER, ("messenger",), messenger_table(text))
        return Accepted(answer=text)
