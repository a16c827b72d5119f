"""Questions about the wishes: which ones, their figures, and the outputs that they drive."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stadimeter.app.detectors import build_detectors
from stadimeter.config.driver_tables import ACTUATOR, BASE, MESSENGER
from stadimeter.config.units import parse_length, split_quantities
from stadimeter.errors import ConfigError
from stadimeter.ranging.feasibility import farthest_m
from stadimeter.workbench.setup.answers import words_of
from stadimeter.workbench.setup.question import Accepted, Known, Option, Question, SetupStep
from stadimeter.workbench.setup.target import build_target
from stadimeter.workbench.setup.wishes import WISHES, Blank, Wish, figure_si, ready_answers

# An output that only the views show.
SCREEN = "screen"

# No output: the rule reports and drives nothing.
NOTHING = "nothing"

_BY_KEY = {wish.key: wish for wish in WISHES}


class WishStep(SetupStep):
    """What shall happen."""

    key = "wish"

    def question(self, known: Known) -> Question:
        """Return the wishes that the target is good for."""
        options = tuple(Option(wish.key, wish.title) for wish in _possible(known))
        return Question(
            key=self.key,
            text="What shall happen?",
            options=options,
            ready="near",
            form="several of them, such as near far",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Take wishes by their names."""
        names = list(dict.fromkeys(words_of(text.replace(",", " "))))
        possible = [wish.key for wish in _possible(known)]
        wrong = [name for name in names if name not in possible]
        if wrong or not names:
            raise ConfigError(f"{' '.join(wrong) or text!r} is none of {', '.join(possible)}")
        return Accepted(answer=" ".join(names))


def _possible(known: Known) -> list[Wish]:
    return [wish for wish in WISHES if not wish.targets or known.answers["target"] in wish.targets]


def chosen_wishes(answers: Mapping[str, str]) -> tuple[Wish, ...]:
    """Return the wishes of the answers."""
    return tuple(_BY_KEY[key] for key in answers.get("wish", "").split())


def wish_steps(answers: Mapping[str, str]) -> Iterator[SetupStep]:
    """Yield the questions that the chosen wishes leave open."""
    for wish in chosen_wishes(answers):
        yield from (BlankStep(wish, blank) for blank in wish.blanks)
        if wish.key == "apart":
            yield SecondTargetStep()
        yield BaseStep() if wish.output == "base" else BrokerStep() if wish.output == "mqtt" else WishOutputStep(wish)
        if wish.output == "base" and answers.get("base", SCREEN) != SCREEN:
            yield WheelsStep()


def reliable_range_m(known: Known) -> float:
    """Return how far away the camera finds the target reliably."""
    if known.camera_model is None:
        return math.inf
    (named,) = build_detectors([build_target(known)], None)
    return farthest_m(named.detector.target_shape, known.camera_model.for_frame(known.frame))


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
        seen_m, name = reliable_range_m(known), f"the {known.answers['target']}"
        ready = ready_answers(self.wish, seen_m)
        return Question(
            key=self.key,
            text=f"{self.wish.title[0].upper()}{self.wish.title[1:]}. {self.blank.text}",
            found=(f"With this camera, {name} is found reliably up to {seen_m:.2g} m.",)
            if self.blank.is_length
            else (),
            ready=ready[self.blank.key],
            form=f"such as {self.blank.ready}",
            sentence=self.wish.sentence,
            blanks=tuple({"key": each.key, "text": each.text, "ready": ready[each.key]} for each in self.wish.blanks),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check its unit, and whether the camera can serve it."""
        try:
            value = figure_si(text, self.blank)
            self._compare(known, text, value)
        except ValueError as error:
            raise ConfigError(str(error)) from error
        seen_m = reliable_range_m(known)
        if not self.blank.is_length or value <= seen_m:
            return Accepted(answer=text)
        far = f"That is farther than the {known.answers['target']} is found reliably, {seen_m:.2g} m."
        return Accepted(answer=text, notes=(far,), doubt=True)

    def _compare(self, known: Known, text: str, value: float) -> None:
        """Raise a ValueError if it is on the wrong side of a figure before it."""
        before = self.blank.beyond or self.blank.within
        if not before:
            return
        other = known.answers[f"{self.wish.key}_{before}"]
        other_value = figure_si(other, self.blank)
        if value <= other_value if self.blank.beyond else value >= other_value:
            way = "farther" if self.blank.beyond else "nearer"
            raise ValueError(f"{text} is not {way} than {other}, as it must be")


@dataclass
class WishOutputStep(SetupStep):
    """What a wish drives."""

    wish: Wish
    kind = "output"

    def __post_init__(self) -> None:
        self.key = f"{self.wish.key}_output"

    def question(self, known: Known) -> Question:
        """Propose the usual output on a Raspberry Pi, and the screen elsewhere."""
        usual = Option(self.wish.output, "wired to a pin of the header, by its BCM number")
        screen = Option(SCREEN, "nothing is wired yet; the live view shows it")
        report = [Option(NOTHING, "it only reports")] if self.wish.key != "far" else []
        both = [usual, screen] if is_raspberry_pi() else [screen, usual]
        taken = self._free(known, usual.answer)
        if taken:
            both = [each if each != usual else Option(taken, each.meaning) for each in both]
        return Question(
            key=self.key,
            text=f"What shall “{self.wish.title}” drive?",
            options=(*both, *report),
            ready=both[0].answer,
            form="buzzer, led, relay or vibration-motor, and a pin, such as buzzer 23; screen; or nothing",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check that there is such an output, and that the pin is free."""
        words = text.split()
        if words == [NOTHING] and self.wish.key != "far":
            return Accepted(answer=text)
        table = actuator_table(text)
        name = words[0] if words else ""
        known.chosen(ACTUATOR, ("actuators", name), table)
        for key, other in known.answers.items():
            if key.endswith("_output") and key != self.key and other.split()[1:] == words[1:] != [] and other != text:
                raise ConfigError(f"pin {words[1]} is taken by {other!r}")
        return Accepted(answer=text)

    def _free(self, known: Known, usual: str) -> str:
        """Return the output on another pin if its pin is taken by another kind of output; empty if it is not."""
        others = [answer for key, answer in known.answers.items() if key.endswith("_output") and key != self.key]
        clash = [each for each in others if each.split()[1:] == usual.split()[1:] and each != usual]
        return f"{usual.split(maxsplit=1)[0]} 24" if clash else ""


class SecondTargetStep(SetupStep):
    """The other of two targets."""

    key = "apart_second"
    kind = "blank"

    def question(self, known: Known) -> Question:
        """Ask what tells it from the first."""
        if known.answers["target"] == "tag":
            return Question(key=self.key, text="What is the number of the second tag?", form="a number such as 7")
        return Question(
            key=self.key,
            text="What colour is the second ball? It is as large as the first.",
            form='a range that `stadimeter colour` has found, such as "100,86,60:130,255,255"',
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check it as part of the target."""
        if known.answers["target"] == "tag":
            family, _, first = known.answers["tag"].partition(" ")
            if not first or first.strip() == text.strip():
                raise ConfigError("two tags need two numbers; go back and give the first tag's too, such as 36h11 3")
            build_target(known, tag=f"{family} {text}")
        else:
            build_target(known, colour=text)
        return Accepted(answer=text)


class BaseStep(SetupStep):
    """What moves the robot."""

    key = "base"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """List serial ports, and the screen."""
        ports = sorted(map(str, Path("/dev/serial/by-id").glob("*")))
        options = [Option(port, "an Arduino with the ros_arduino_bridge sketch") for port in ports]
        options.append(Option(SCREEN, "no robot yet; the live view shows what it would do"))
        return Question(
            key=self.key,
            text="Where is the robot's base?",
            options=tuple(options),
            ready=options[0].answer,
            form="a serial port such as /dev/ttyUSB0, or screen",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the port's form."""
        if text != SCREEN and not text.startswith("/dev/"):
            raise ConfigError(f"{text!r} is not a serial port; write it such as /dev/ttyUSB0, or {SCREEN}")
        known.chosen(BASE, ("base",), base_table({**known.answers, "base": text}))
        return Accepted(answer=text)


class WheelsStep(SetupStep):
    """The robot's wheels."""

    key = "wheels"
    kind = "blank"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """Ask for all figures at once."""
        return Question(
            key=self.key,
            text="The robot's wheels: their diameter, encoder ticks a turn, and how far apart they are?",
            ready="6.5 cm, 1440, 20 cm",
            form="three figures with commas between them",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check the figures as the base's."""
        parts = _wheel_figures(text)
        if len(parts) != 3 or not parts[1].isdecimal():
            raise ConfigError(f"{text!r} are not three figures; write them such as 6.5 cm, 1440, 20 cm")
        try:
            parse_length(parts[0]), parse_length(parts[2])
        except ValueError as error:
            raise ConfigError(str(error)) from error
        known.chosen(BASE, ("base",), base_table({**known.answers, "wheels": text}))
        return Accepted(answer=text)


class BrokerStep(SetupStep):
    """The MQTT broker."""

    key = "broker"

    def question(self, known: Known) -> Question:  # noqa: ARG002
        """Ask for its address."""
        return Question(
            key=self.key,
            text="Where is the MQTT broker?",
            ready="127.0.0.1",
            form="its name or address, such as homeassistant.local; a port behind a colon if it is not 1883",
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check it as the messenger's."""
        known.chosen(MESSENGER, ("messenger",), messenger_table(text))
        return Accepted(answer=text)


def actuator_table(text: str) -> dict[str, Any]:
    """Return the table of an output such as ``buzzer 23``."""
    driver, *pin = text.split() or [""]
    if driver == SCREEN:
        return {"driver": "simulated"}
    return {"driver": driver, **({"pin": int(pin[0]) if pin[0].isdecimal() else pin[0]} if pin else {})}


def _wheel_figures(text: str) -> list[str]:
    plain = [part.strip() for part in text.split(",")]
    return plain if len(plain) == 3 else split_quantities(text)  # "6.5 cm,1440,20 cm" has no decimal comma


def base_table(answers: Mapping[str, str]) -> dict[str, Any]:
    """Return the table ``[base]``."""
    limits = {"max_speed": answers.get("follow_speed", "0.3 m/s"), "max_turn_rate": "60 deg/s"}
    if answers["base"] == SCREEN:
        return {"driver": "simulated", **limits}
    wheel, ticks, track = _wheel_figures(answers.get("wheels", "6.5 cm, 1440, 20 cm"))
    wheels = {"wheel_diameter": wheel, "ticks_per_turn": int(ticks), "track_width": track}
    return {"driver": "ros-arduino-bridge", "port": answers["base"], **wheels, **limits}


def messenger_table(broker: str) -> dict[str, Any]:
    """Return the table ``[messenger]``."""
    host, _, port = broker.partition(":")
    return {"driver": "mqtt", "host": host, **({"port": int(port) if port.isdecimal() else port} if port else {})}


def is_raspberry_pi() -> bool:
    """Return whether this computer is a Raspberry Pi."""
    try:
        return Path("/proc/device-tree/model").read_text(encoding="utf-8").startswith("Raspberry Pi")
    except OSError:
        return False
