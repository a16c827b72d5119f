"""Numbers that no one means: they are refused with what and where, or do no harm; nothing overflows or divides by 0."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from typer.testing import CliRunner

from stadimeter.app.bootstrap import build
from stadimeter.app.control.messages import parse_request
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.persistence.resumption import read_state, state_text
from stadimeter.cli.main import app
from stadimeter.config import units
from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.bounds import MAX_TIME_S
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.observation import Observation
from stadimeter.core.plan import Plan
from stadimeter.errors import ConfigError, ControlError, StateError
from support.simulated_run import SIMULATED_BALL

EVERYTHING = (
    SIMULATED_BALL
    + """
[base]
driver = "simulated"
lease = "300 ms"
max_speed = "0.5 m/s"
acceleration = "0.5 m/s2"
[tracking]
coast = "0.3 s"
acceleration = "2 m/s2"
noise_factor = 1.0
autocorrelation = 0.3
[safety]
max_frame_age = "200 ms"
[rules.far]
actuator = "motor"
ramp = { from = "0.5 m", to = "1 m" }
[rules.near]
when = { below = "1.5 m", deadband = "5 cm", probability = 0.9 }
on_delay = "1 s"
off_delay = "0.5 s"
cooldown = "3 s"
[rules.fast]
when = { closing_speed = { above = "0.1 m/s" } }
[rules.between]
when = { between = ["1 m", "2 m"] }
[rules.soon]
when = { time_to_contact = { below = "3 s" } }
[rules.gone]
when = { lost = "1 s" }
[rules.side]
when = { bearing = { above = "10 deg" } }
[rules.follow]
actuator = "base"
follow = { distance = "1 m", max_speed = "0.3 m/s" }
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }, { at = "3 s", x = "1 m", y = "0.2 m" }]
loop = false
"""
)
NUMBER = re.compile(r"(?<![\w.#-])-?\d+(?:\.\d+)?(?![\w.]*\")|(?<=\")-?\d+(?:\.\d+)?(?= )")
IN_JSON = re.compile(r"(?<=[:,\[])-?\d+(?:\.\d+)?(?:e-?\d+)?(?=[,\]}])")
EXTREME = [
    *("1e308", "-1e308", "1e200", "1e154", "1e30", "1e15", "-1e15", "1e7", "9223372036854775807"),
    *("1e-12", "1e-30", "1e-160", "1e-300", "1e-320", "0", "-1"),
]


def placed(text: str, which: int, number: str, pattern: re.Pattern[str] = NUMBER) -> str:
    """Return a text with another number in the place of one of its own."""
    found = list(pattern.finditer(text))
    at = found[which % len(found)]
    return text[: at.start()] + number + text[at.end() :]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("extreme")


PARSERS: list[tuple[Callable[[object], float], units.Units]] = [
    (units.parse_length, units.LENGTHS_M),
    (units.parse_length_or_zero, units.LENGTHS_M),
    (units.parse_duration, units.DURATIONS_S),
    (units.parse_velocity, units.SPEEDS_MPS),
    (units.parse_acceleration, units.ACCELERATIONS_MPS2),
    (units.parse_angle, units.ANGLES_RAD),
    (units.parse_turn_rate, units.TURN_RATES_RADPS),
    (units.parse_turn_acceleration, units.TURN_ACCELERATIONS_RADPS2),
    (units.parse_frequency, units.FREQUENCIES_HZ),
]


@given(st.sampled_from(PARSERS), st.floats(allow_nan=False), st.data())
def test_a_quantity_is_within_its_bounds_or_refused(
    parser: tuple[Callable[[object], float], units.Units], number: float, data: st.DataObject
) -> None:
    parse, known = parser
    text = f"{number!r} {data.draw(st.sampled_from(sorted(known)))}"
    try:
        value = parse(text)
    except ValueError:
        return
    assert value == 0 or 1e-12 <= abs(value) <= known.most


def check(folder: Path, text: str) -> None:
    file = folder / "configuration.toml"
    file.write_text(text)
    try:
        configuration = load_configuration(file)
    except ConfigError as error:
        problems = error.problems
    else:
        run(configuration)
        return
    assert all(problem.line and problem.key for problem in problems)


def run(configuration: Configuration) -> None:
    assert describe(configuration)
    assert all(warning.key for warning in feasibility_warnings(configuration))
    if configuration.camera.driver == "simulated":
        Loop(build(configuration, speed=None)).run(Limits(frames=20))


@pytest.mark.long
@given(st.integers(0, 1000), st.sampled_from(EXTREME))
@example(0, "1e-12")  # the camera's rate
def test_a_configuration_with_an_extreme_number_is_refused_by_key_or_runs(
    folder: Path, which: int, number: str
) -> None:
    check(folder, placed(EVERYTHING, which, number))


@pytest.fixture(scope="module")
def journal(folder: Path) -> list[str]:
    """Return the lines of a journal of three seconds."""
    configuration, path = folder / "run.toml", folder / "run.jsonl"
    configuration.write_text(EVERYTHING)
    done = CliRunner().invoke(
        app, ["run", str(configuration), "--seconds", "3", "--speed", "0", "--journal", str(path), "--no-state"]
    )
    assert done.exit_code == 0, done.output
    return path.read_text().splitlines()


COMMANDS = [["replay"], ["replay", "--json"], ["explain", "near", "--at", "2 s", "--journal"], ["tune", "near"]]


@pytest.mark.long
@given(st.sampled_from(COMMANDS), st.integers(1, 80), st.integers(0, 1000), st.sampled_from(EXTREME))
def test_a_journal_with_an_extreme_number_is_read_or_refused_in_a_line(
    folder: Path, journal: list[str], command: list[str], line: int, which: int, number: str
) -> None:
    lines = list(journal)
    lines[line] = placed(lines[line], which, number, IN_JSON)
    path = folder / "extreme.jsonl"
    path.write_text("\n".join(lines) + "\n")
    rules = ["--config", str(folder / "run.toml")] if command[0] == "tune" else []
    done = CliRunner().invoke(app, [*command, str(path), *rules])
    assert done.exception is None or isinstance(done.exception, SystemExit)
    assert done.exit_code in {0, 1, 2}


@pytest.mark.parametrize("key", ["now_s", "captured_at_s"])
def test_a_time_that_no_clock_shows_is_refused_with_its_line(folder: Path, journal: list[str], key: str) -> None:
    lines = list(journal)
    lines[40] = re.sub(rf'"{key}":[^,}}]+', f'"{key}":1e308', lines[40])
    path = folder / "time.jsonl"
    path.write_text("\n".join(lines) + "\n")
    done = CliRunner().invoke(app, ["replay", str(path)])
    assert done.exit_code == 2
    assert f"{path}:41: not a cycle of a recording: a time beyond 1e+10 s" in done.output


@pytest.fixture(scope="module")
def remembered(folder: Path) -> tuple[Plan, str]:
    """Return a plan, and what a run of it remembers at its end."""
    path = folder / "remembered.toml"
    path.write_text(EVERYTHING)
    configuration = load_configuration(path)
    loop = Loop(build(configuration, speed=None))
    loop.run(Limits(seconds=3))
    assert loop.state is not None
    return configuration.plan, state_text(loop.state)


@pytest.mark.long
@given(st.integers(0, 1000), st.sampled_from(EXTREME))
def test_what_a_run_restores_with_an_extreme_number_is_restored_or_refused(
    remembered: tuple[Plan, str], which: int, number: str
) -> None:
    plan, text = remembered
    try:
        state = read_state(placed(text, which, number, IN_JSON), initial_state(plan))
    except StateError:
        return
    for step in range(3):
        state, _ = decide(state, Observation(now_s=10.0 + step))


@given(st.sampled_from(["shelve", "explain"]), st.sampled_from(EXTREME))
def test_a_request_with_an_extreme_time_is_taken_within_bounds_or_refused(op: str, number: str) -> None:
    key = "for_s" if op == "shelve" else "ago_s"
    try:
        request = parse_request(f'{{"op": "{op}", "args": {{"rule": "near", "{key}": {number}}}}}'.encode())
    except ControlError:
        return
    assert 0 <= getattr(request.args, key) <= MAX_TIME_S
