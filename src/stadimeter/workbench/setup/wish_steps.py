"""Questions about the wishes: which ones, their figures, and the outputs that they drive."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from stadimeter.config.driver_tables import ACTUATOR, MESSENGER
from stadimeter.errors import ConfigError
from stadimeter.ranging.similar_triangles import farthest_m
from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.setup.base_steps import BaseStep, option_steps
from stadimeter.workbench.setup.files import (
    NOTHING,
    SCREEN,
    WISHES,
    Blank,
    Wish,
    actuator_table,
    figure_si,
    find_wishes,
    messenger_table,
    ready_answers,
)
from stadimeter.workbench.setup.question import Accepted, Known, Option, Question, SetupStep, words_of
from stadimeter.workbench.setup.target import build_target, target_shape


class WishStep(SetupStep):
    """What shall happen."""

    key = "wish"

    asked = Question(
        text="What shall happen?",
        options=tuple(Option(wish.key, wish.title) for wish in WISHES),
        ready="near",
        form="several of them, such as near far",
    )

    def accept(self, known: Known, text: str) -> Accepted:  # noqa: ARG002
        """Take wishes by their names."""
        names = list(dict.fromkeys(words_of(text.replace(",", " "))))
        possible = [wish.key for wish in WISHES]
        wrong = [name for name in names if name not in possible]
        if wrong or not names:
            raise ConfigError(f"{' '.join(wrong) or text!r} is none of {', '.join(possible)}")
        return Accepted(answer=" ".join(names))


def wish_steps(answers: Mapping[str, str]) -> Iterator[SetupStep]:
    """Yield the questions that the chosen wishes leave open."""
    for wish in find_wishes(answers):
        yield from (BlankStep(wish, blank) for blank in wish.blanks)
        yield BaseStep() if wish.output == "base" else BrokerStep() if wish.output == "mqtt" else WishOutputStep(wish)
        if wish.output == "base":
            yield from option_steps(answers.get("base", SCREEN))


def reliable_range_m(known: Known) -> float:
    """Return how far away the camera finds the target reliably."""
    if known.camera_model is None:
        return math.inf
    return farthest_m(target_shape(build_target(known)), known.camera_model.for_frame(known.frame))


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
        reach = f"With this camera, the {known.answers['target']} is found reliably up to {seen_m:.2g} m."
        ready = ready_answers(self.wish, seen_m)
        return Question(
            text=f"{self.wish.title[0].upper()}{self.wish.title[1:]}. {self.blank.text}",
            found=(reach,) if self.blank.is_length else (),
            ready=ready[self.blank.key],
            form=f"such as {self.blank.ready}",
            sentence=self.wish.sentence,
            blanks=tuple({"key": each.key, "text": each.text, "ready": ready[each.key]} for each in self.wish.blanks),
        )

    def accept(self, known: Known, text: str) -> Accepted:
        """Check its unit, and whether the camera can serve it."""
        value = figure_si(text, self.blank)
        if before := self.blank.beyond or self.blank.within:
            other = known.answers[f"{self.wish.key}_{before}"]
            way, sign = ("farther", 1) if self.blank.beyond else ("nearer", -1)
            if sign * value <= sign * figure_si(other, self.blank):
                raise ConfigError(f"{text} is not {way} than {other}, as it must be")
        seen_m = reliable_range_m(known)
        if not self.blank.is_length or value <= seen_m:
            return Accepted(answer=text)
        far = f"That is farther than the {known.answers['target']} is found reliably, {seen_m:.2g} m."
        return Accepted(answer=text, notes=(far,), doubt=True)


@dataclass
class WishOutputStep(SetupStep):
    """What a wish drives."""

    wish: Wish
    kind = "output"

    def __post_init__(self) -> None:
        self.key = f"{self.wish.key}_output"

    def question(self, known: Known) -> Question:
        """Propose the usual output on a Raspberry Pi, on pin 24 where its own is taken, and the screen elsewhere."""
        driver, pin = self.wish.output.split()
        usual = f"{driver} 24" if self._other_on(known, pin, self.wish.output) else self.wish.output
        wired = Option(usual, "wired to a pin of the header, by its BCM number")
        screen = Option(SCREEN, "nothing is wired yet; the live view shows it")
        report = [Option(NOTHING, "it only reports")] if self.wish.key != "far" else []
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
        if text == NOTHING and self.wish.key != "far":
            return Accepted(answer=text)
        known.choose(ACTUATOR, ("actuators", driver), actuator_table(text))
        if pin and (other := self._other_on(known, pin[0], text)):
            raise ConfigError(f"pin {pin[0]} is taken by {other!r}")
        return Accepted(answer=text)

    def _other_on(self, known: Known, pin: str, output: str) -> str:
        """Return another output that is on a pin already, such as ``buzzer 23``; empty for none."""
        outputs = (answer for key, answer in known.answers.items() if key.endswith("_output") and key != self.key)
        return next((each for each in outputs if each.split()[1:] == [pin] and each != output), "")


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
