r"""A base that speaks lines of text, in a protocol that stands in the configuration.

**Whether and when it stops by itself, you say** with ``auto_stop``: nothing else knows. As an example, OpenBot::

    [base]
    driver = "ascii"
    port = "/dev/ttyUSB0"
    drive = "h500\nc{left:d},{right:d}\n"
    stop = "c0,0\n"
    question = "f\n"
    answers = { identity = "f[A-Z].*", battery = "v([0-9.]+)" }
    full_units = 255
    full_speed = "0.8 m/s"
    track_width = "15 cm"
    auto_stop = "500 ms"

Its time-out is fed by ``h`` only, never by ``c``. So ``h500`` stands in ``drive``, not in ``opening``: a line that
feeds a time-out belongs to the command that a fresh frame justifies. Source: ``openbot.ino`` of ob-f/OpenBot.
"""

from __future__ import annotations

import math
import re
from string import Formatter
from typing import Annotated, ClassVar, Self

from pydantic import AfterValidator, Field, model_validator

from stadimeter.bases import serial_base
from stadimeter.bases.protocol import DifferentialDrive, Motion, WheelSpeeds
from stadimeter.config.plugins import OptionsTable
from stadimeter.config.units import Duration

# What stops a base from outside has at most this many bytes, with what ends a line before it.
MAX_FRAME_BYTES = 63

MAX_UNITS = 32767.0

_MAX_LINE_BYTES = 256
_WHEELS, _TWIST = {"left", "right"}, {"linear", "angular"}
_LINE_ENDS = ("\n", "\r")


def _check_line(text: str) -> str:
    if not text.endswith(_LINE_ENDS):
        raise ValueError(f'{text!r} does not end its line: write "\\n", or "\\r" where the firmware waits for that')
    if not text.isascii() or len(text) > MAX_FRAME_BYTES:
        raise ValueError(f"{text!r} is not up to {MAX_FRAME_BYTES} characters of ASCII")
    return text


class LineTemplate:
    """A line with numbers to be filled in, such as ``c{left:d},{right:d}``.

    Attributes:
        fields: The format of each number, by its name.

    Raises:
        ValueError: Braces do not match.
    """

    def __init__(self, text: str) -> None:
        self._parts = [(literal, name, spec or "") for literal, name, spec, _ in Formatter().parse(text)]
        self.fields = {name: spec for _, name, spec in self._parts if name is not None}

    def fill(self, values: dict[str, float]) -> tuple[bytes, dict[str, float]]:
        """Return the line with these values, and the values as they are written, which may be rounded."""
        written = {name: _written(values[name], spec) for name, spec in self.fields.items()}
        line = "".join(literal + (written[name] if name else "") for literal, name, _ in self._parts)
        return line.encode(), {name: float(text) for name, text in written.items()}


def _written(value: float, spec: str) -> str:
    return format(round(value) if spec.endswith("d") else value, spec)


def _check_drive(text: str) -> str:
    """Check that a line can be filled in, with both wheels or with speed and rate of turn, as numbers."""
    _check_line(text)
    try:
        template = LineTemplate(text)
    except ValueError as error:
        raise ValueError(f"{text!r} is no template: {error}; write a brace that is sent as {{{{ or }}}}") from error
    fields = template.fields
    if fields.keys() not in (_WHEELS, _TWIST):
        raise ValueError(
            f"{text!r} has the fields {', '.join(sorted(fields)) or 'none'}; write {{left:d}} and {{right:d}}, or "
            "{linear:.2f} and {angular:.2f}"
        )
    for name, spec in fields.items():
        for value in (-MAX_UNITS, 0.0, MAX_UNITS):
            _check_number(name, spec, value)
    if len(template.fill(dict.fromkeys(fields, -MAX_UNITS))[0]) > MAX_FRAME_BYTES:
        raise ValueError(f"{text!r} is longer than {MAX_FRAME_BYTES} bytes when it is filled in")
    return text


def _check_number(name: str, spec: str, value: float) -> None:
    try:
        said = float(_written(value, spec))
    except ValueError as error:
        raise ValueError(f"'{spec}' does not write {{{name}}} as a number: use d, or .2f") from error
    if abs(said - value) > 0.5:
        raise ValueError(f"'{spec}' writes {{{name}}} = {value:g} as {said:g}: use d, or .2f")


def _check_pattern(pattern: str, groups: int) -> str:
    try:
        found = re.compile(pattern).groups
    except re.error as error:
        raise ValueError(f"{pattern!r} is no regular expression: {error}") from error
    if found < groups:
        raise ValueError(f"{pattern!r} needs {groups} group{'s' if groups > 1 else ''} in round brackets, one a number")
    return pattern


Line = Annotated[str, AfterValidator(_check_line)]
Drive = Annotated[str, AfterValidator(_check_drive)]
Pattern = Annotated[str, AfterValidator(lambda pattern: _check_pattern(pattern, 0))]
PatternOfOne = Annotated[str, AfterValidator(lambda pattern: _check_pattern(pattern, 1))]
PatternOfTwo = Annotated[str, AfterValidator(lambda pattern: _check_pattern(pattern, 2))]
Scale = Annotated[float, Field(gt=0)]


class AsciiAnswers(OptionsTable):
    """The answers of the base: regular expressions, each for a whole line. Other lines mean nothing."""

    identity: Pattern | None = None
    """A line that only this base says, and says once it runs."""
    done: Pattern | None = None
    """What it answers to each command that it obeys, to ``stop`` and to the lines of ``opening``."""
    refused: Pattern | None = None
    """What it answers to a command that it does not obey."""
    battery: PatternOfOne | None = None
    """A line with the voltage of the battery."""
    battery_unit: Scale = 1.0
    """Volts of 1 in that line, such as 0.01."""
    travel: PatternOfTwo | None = None
    """A line with what the encoders of the left and the right wheel have counted in all, in this order."""
    travel_unit: Scale = 1.0
    """Metres of 1 in that line."""

    @model_validator(mode="after")
    def _check_base_is_recognised(self) -> Self:
        if self.identity is None and self.done is None:
            raise ValueError("write identity, a line that shows that the base runs, or done")
        return self


class AsciiBaseOptions(serial_base.DutyBaseOptions):
    """The options of a base that obeys lines of text, in a protocol of your own."""

    title: ClassVar = "a base of your own, with lines of text as its protocol"
    auto_stop_advice: ClassVar = (
        'give its program a time-out of 500 ms that every command feeds, and write auto_stop = "500 ms"'
    )

    drive: Drive = Field(examples=["c{left:d},{right:d}\n"])
    """What drives the wheels, with ``{left:d}`` and ``{right:d}``, or ``{linear:.2f}`` and ``{angular:.2f}``."""
    stop: Line = Field(examples=["c0,0\n"])
    """What makes the base stand."""
    full_units: float = Field(default=255, gt=0, le=MAX_UNITS)
    """What is written at ``full_speed``, and never more: 255 for a duty of 8 bits, 1000 at 1 m/s for mm/s."""
    angular_units: float = Field(default=1.0, gt=0, le=MAX_UNITS)
    """What is written as ``{angular}`` at 1 rad/s: 1000 for mrad/s."""
    opening: tuple[Line, ...] = ()
    """What is sent once when the base has answered."""
    question: Line | None = None
    """What it answers with its identity, asked until it does, and then five times a second."""
    answers: AsciiAnswers | None = None
    """What it says. Without this table it is driven blindly: nothing notices whether it is there."""
    auto_stop: Duration = Field(examples=["500 ms"])
    """The wheels stop when no command came for this long, by the program of the base; ``"0 s"`` for never."""

    @model_validator(mode="after")
    def _check_question_has_an_answer(self) -> Self:
        if self.question is not None and self.answers is None:
            raise ValueError("question has no answer: write answers = { identity = … }")
        return self

    def codec(self) -> AsciiCodec:
        """Return a new codec."""
        return AsciiCodec(self)

    def stops_by_itself_after_s(self) -> float:
        """Return the time that the configuration says."""
        return self.auto_stop or math.inf


class AsciiCodec(serial_base.SerialCodec):
    """The protocol that the configuration describes."""

    name: ClassVar = "the protocol in the configuration"
    hint: ClassVar = "check its question and its pattern identity, that the baud rate is right, that it is switched on"
    refusal_hint: ClassVar = "see what its program answers with `refused`"

    def __init__(self, options: AsciiBaseOptions) -> None:
        self._options = options
        self._drive = DifferentialDrive(track_width_m=options.track_width, max_wheel_mps=math.inf)
        self._units_per_mps = options.full_units / options.full_speed
        self._template = LineTemplate(options.drive)
        self._lines = serial_base.LineReader(_MAX_LINE_BYTES)
        self._answers = options.answers or AsciiAnswers(done="(?!)")
        self.answers = _answers_mode(options)  # type: ignore[misc] # one class for three kinds of base
        self.ends_cut_frame = options.stop[-1].encode()
        self.opening = tuple(line.encode() for line in options.opening)
        self.question = (options.question or "").encode()
        self.polls = (self.question,) if self.question else ()

    @property
    def stop(self) -> bytes:
        """The frame that makes the base stand."""
        return self._options.stop.encode()

    def encode(self, wheels: WheelSpeeds) -> serial_base.WheelCommand:
        """Return the command for wheel speeds, and the speeds that are written, as they are rounded."""
        motion = self._drive.motion(wheels)
        values = {
            "left": wheels.left_mps * self._units_per_mps,
            "right": wheels.right_mps * self._units_per_mps,
            "linear": motion.linear_mps * self._units_per_mps,
            "angular": motion.angular_radps * self._options.angular_units,
        }
        frame, said = self._template.fill(values)
        speeds = {name: value / self._units_per_mps for name, value in said.items()}
        if "left" in said:
            sent = WheelSpeeds(left_mps=speeds["left"], right_mps=speeds["right"])
        else:
            angular_radps = said["angular"] / self._options.angular_units
            sent = self._drive.wheels(Motion(linear_mps=speeds["linear"], angular_radps=angular_radps))
        return serial_base.WheelCommand(frame=frame, sent=sent)

    def feed(self, data: bytes) -> list[serial_base.BaseMessage]:
        """Return the meaning of the lines that are complete now, oldest first."""
        return [message for line in self._lines.feed(data) if (message := self._meaning(line))]

    def _meaning(self, line: serial_base.TextLine) -> serial_base.BaseMessage | None:
        """Return the meaning of a line. Numbers behind noise are not trusted: it may have eaten a digit."""
        answers = self._answers
        message = None
        if _fits(answers.done, line.text):
            message = serial_base.BaseMessage(was_done=True, is_identity=answers.identity is None)
        elif _fits(answers.refused, line.text):
            message = serial_base.BaseMessage(was_done=False)
        elif _fits(answers.identity, line.text):
            message = serial_base.BaseMessage(is_identity=True)
        elif not line.noise and (volts := _numbers(answers.battery, line.text)):
            message = serial_base.BaseMessage(battery_v=volts[0] * answers.battery_unit)
        elif not line.noise and (ticks := _numbers(answers.travel, line.text)):
            message = serial_base.BaseMessage(
                left_m=ticks[0] * answers.travel_unit, right_m=ticks[1] * answers.travel_unit
            )
        self.dropped_bytes += line.noise + (len(line.text) if message is None else 0)
        return message


def _answers_mode(options: AsciiBaseOptions) -> serial_base.Answers:
    if options.answers is None:
        return serial_base.Answers.NEVER
    return serial_base.Answers.EACH_COMMAND if options.answers.done is not None else serial_base.Answers.STREAM


def _fits(pattern: str | None, text: str) -> bool:
    return pattern is not None and re.fullmatch(pattern, text) is not None


def _numbers(pattern: str | None, text: str) -> tuple[float, ...] | None:
    """Return the numbers in the groups of a pattern, if it fits and they are finite."""
    found = re.fullmatch(pattern, text) if pattern is not None else None
    try:
        numbers = tuple(float(group) for group in found.groups()) if found else ()
    except (TypeError, ValueError):
        return None
    return numbers if numbers and all(map(math.isfinite, numbers)) else None
