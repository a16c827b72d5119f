"""Tests of rules: what passes, what fails and what a failure says; and the made-up distances that they go by."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median, pstdev

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.recordings.journal import JournalWriter, read_journal, to_be_recorded
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.rule_test_tables import MotionTable, PathPoint, SpanTable
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.similar_triangles import expect
from stadimeter.workbench.rule_tests import (
    Failure,
    RuleTestResult,
    SensorModel,
    SyntheticTrack,
    position_at,
    run_rule_test,
    sensor_models,
)
from stadimeter.workbench.tune import settings_of, with_settings
from support import two_cameras
from support.recordings import records_of
from support.simulated_run import SIMULATED_BALL

# Tests of rules: what passes, what fails, and what a failure says.

RULES = """
[actuators.buzzer]
driver = "simulated"

[base]
driver = "simulated"

[rules.far]
actuator = "motor"
ramp = { from = "1 m", to = "2 m" }

[rules.near]
actuator = "buzzer"
when = { below = "50 cm" }

[rules.follow]
actuator = "base"
follow = { distance = "1 m", max_speed = "0.3 m/s" }

[world]
"""

Load = Callable[[str], Configuration]
Run = Callable[[str], RuleTestResult]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Return a function that loads rules with tests."""

    def of(tests: str, rules: str = RULES) -> Configuration:
        file = tmp_path / "tested.toml"
        file.write_text(SIMULATED_BALL + rules + tests, encoding="utf-8")
        return load_configuration(file)

    return of


@pytest.fixture
def run(load: Load) -> Run:
    """Return a function that runs one test, given what stands below its ``[[tests]]``."""

    def of(text: str) -> RuleTestResult:
        configuration = load(f"[[tests]]\n{text}\n")
        return run_rule_test(configuration, configuration.tests[0])

    return of


def hovering(distance: str, seconds: str, expect: str, more: str = "") -> str:
    return f'input = {{ hover = {{ at = "{distance}", for = "{seconds}" }}{more} }}\nexpect.{expect}'


def approaching(expect: str, more: str = "") -> str:
    return f'input = {{ approach = {{ from = "3 m", to = "30 cm", speed = "2 m/s" }}{more} }}\nexpect.{expect}'


def failure_of(result: RuleTestResult) -> Failure:
    (failure,) = result.failures
    return failure


@pytest.mark.parametrize(
    "text",
    [
        hovering("50 cm", "60 s", "near = { transitions_max = 2 }", ", dropouts = 0.05"),
        hovering("1 m", "5 s", 'near = { raised = 0, cleared = 0, inactive_at = "5 s", status = "idle" }'),
        hovering(
            "30 cm", "5 s", 'near = { raised = 1, raised_by = "0.3 s", active_at = { from = "1 s", for = "4 s" } }'
        ),
        approaching('near = { raised = 1, raised_after = "2 s", raised_by = "2.7 s", status = "active" }'),
        approaching('buzzer = { stopped_at = "1 s", acts_at = "3 s", level_at = { at = "3 s", level = 1 } }'),
        hovering("3 m", "3 s", 'base = { speed_max = "0.3 m/s", acts_at = "3 s" }'),
        hovering("1 m", "3 s", 'base = { stopped_at = { from = "0 s", for = "3 s" } }'),
        'input = { skip = { from = "3 m", to = "40 cm" } }\nexpect.near = { raised = 1, raised_by = "1.5 s" }',
    ],
)
def test_what_is_as_expected_passes(run: Run, text: str) -> None:
    result = run(text)
    assert result.failures == ()
    assert result.trouble == ""
    assert result.passed


def test_a_rule_that_is_late_fails_with_the_moment_and_the_reason_of_that_moment(run: Run) -> None:
    failure = failure_of(run(approaching('near = { raised_by = "1 s" }')))
    assert (failure.subject, failure.key, failure.expected) == ("near", "raised_by", "raised by 1.00 s")
    assert failure.got.startswith("raised at 2.")
    assert failure.got.endswith(" late")
    assert failure.at_s == pytest.approx(1.0)
    assert failure.why.startswith("not raised: ")
    assert "below 0.50 m" in failure.why


def test_too_few_and_too_many_are_told_with_their_times(run: Run) -> None:
    few = failure_of(run(hovering("30 cm", "5 s", "near = { raised = 2 }")))
    assert few.expected == "2 raises"
    assert few.got.startswith("1 raise (at 0.")
    many = failure_of(run(hovering("30 cm", "5 s", "near = { raised = 0 }")))
    assert many.expected == "0 raises"
    assert many.why.startswith("raised: so from the start: 0.3")


def test_an_output_fails_with_who_commands_it_and_why(run: Run) -> None:
    failure = failure_of(run(hovering("30 cm", "2 s", 'buzzer = { level_at = { at = "1 s", max = 0.5 } }')))
    assert failure.got.startswith("level 1.00 at 1.")
    assert failure.why.startswith("level 1.00, commanded by near: 0.3")
    failure = failure_of(run(hovering("3 m", "3 s", 'base = { stopped_at = "3 s" }')))
    assert failure.why.startswith("0.30 m/s, 0 deg/s, commanded by follow: ")
    failure = failure_of(run(hovering("3 m", "3 s", 'base = { speed_max = "0.1 m/s" }')))
    assert failure.expected == "never faster than 0.10 m/s"


def test_a_frozen_camera_gives_no_frames_and_cycles_all_the_same(run: Run) -> None:
    frozen = ', frozen = [{ from = "2 s", for = "4 s" }]'
    result = run(
        hovering("2 m", "8 s", 'motor = { stopped_at = { from = "2.5 s", for = "3 s" }, acts_at = "8 s" }', frozen)
    )
    assert result.passed
    assert result.cycles == pytest.approx(4 * 30 + 40, abs=3)
    faults = [(event.kind.value, round(at_s)) for at_s, event in result.events if event.source == "camera"]
    assert faults == [("fault", 2), ("fault_cleared", 6)]


@pytest.mark.parametrize("seconds", ["3.75 s", "3.74 s", "10 ms"])
def test_a_test_ends_when_it_says_though_no_frame_comes_at_its_end(run: Run, seconds: str) -> None:
    result = run(
        hovering("1 m", seconds, f'near = {{ inactive_at = ["{seconds}", {{ from = "0 s", for = "{seconds}" }}] }}')
    )
    assert result.failures == ()
    assert f"{result.took_s:.4g} s" in {seconds, "0.01 s"}


def test_a_schedule_goes_by_the_time_of_day_that_the_test_names(load: Load) -> None:
    rules = RULES.replace(
        'when = { below = "50 cm" }',
        'when = { all = [{ below = "50 cm" }, { time = { between = ["22:00", "06:00"] } }] }',
    )
    hover = 'hover = { at = "30 cm", for = "4 s" }'
    tests = (
        f'[[tests]]\ninput = {{ {hover}, clock = "21:59:58" }}\nexpect.near = {{ raised = 1, raised_after = "2 s" }}\n'
        f'[[tests]]\ninput = {{ {hover}, clock = "12:00" }}\nexpect.near = {{ raised = 0, status = "idle" }}\n'
        f'[[tests]]\ninput = {{ {hover} }}\nexpect.near = {{ raised = 0, status = "unknown" }}\n'
    )
    configuration = load(tests, rules)
    assert [run_rule_test(configuration, test).failures for test in configuration.tests] == [(), (), ()]


def test_what_people_do_at_certain_times_is_done(load: Load) -> None:
    rules = RULES.replace('when = { below = "50 cm" }', 'when = { below = "50 cm" }\nlatch = true\nack = "required"')
    far = '{ at = "2 s", distance = "2 m" }, { at = "9 s", distance = "2 m" }'
    leaving = f'points = [{{ at = "0 s", distance = "30 cm" }}, {far}]'
    orders = '{ at = "5 s", do = "acknowledge", rule = "near" }, { at = "6 s", do = "reset", rule = "near" }'
    tests = (
        f"[[tests]]\ninput = {{ {leaving} }}\n"
        'expect.near = { cleared = 0, status = "latched", acknowledged = false }\nexpect.buzzer = { acts_at = "9 s" }\n'
        f"[[tests]]\ninput = {{ {leaving}, operator = [{orders}] }}\n"
        'expect.near = { raised = 1, active_at = "5.9 s", status = "idle", acknowledged = true }\n'
        'expect.buzzer = { acts_at = "5.9 s", stopped_at = "6.2 s" }\n'
    )
    configuration = load(tests, rules)
    assert [run_rule_test(configuration, test).failures for test in configuration.tests] == [(), ()]


def test_what_an_alarm_sends_is_counted_and_nothing_is_sent(load: Load) -> None:
    rules = (
        RULES.replace("[rules.far]", '[messenger]\ndriver = "simulated"\n\n[rules.far]')
        .replace(
            "[rules.follow]",
            '[[rules.near.escalation]]\ntopic = "door"\ntext = "{rule}"\n'
            '[[rules.near.escalation]]\nafter = "2 s"\nonly_unacknowledged = true\ntopic = "again"\ntext = "{rule}"\n\n'
            "[rules.follow]",
        )
        .replace('when = { below = "50 cm" }', 'when = { below = "50 cm" }\nack = "required"')
    )
    seen = 'operator = [{ at = "1.5 s", do = "acknowledge", rule = "near" }]'
    tests = (
        f"[[tests]]\n{hovering('30 cm', '4 s', 'near = { sent = 2 }')}\n"
        f"[[tests]]\n{hovering('30 cm', '4 s', 'near = { sent = 1 }', f', {seen}')}\n"
        f"[[tests]]\n{hovering('30 cm', '4 s', 'near = { sent = 0 }')}\n"
    )
    configuration = load(tests, rules)
    both, one, wrong = (run_rule_test(configuration, test) for test in configuration.tests)
    assert (both.failures, one.failures) == ((), ())
    failure = failure_of(wrong)
    assert (failure.expected, failure.got.partition(" (")[0]) == ("0 messages", "2 messages")


@pytest.fixture
def recorded(load: Load, tmp_path: Path) -> Path:
    """Return the journal of a run in which the ball came near once."""
    path = tmp_path / "run.jsonl"
    world = """
camera_height = "12 cm"
path = [
  { at = "0 s", x = "1.5 m", y = "0 m" },
  { at = "3 s", x = "0.4 m", y = "0 m" },
  { at = "6 s", x = "1.5 m", y = "0 m" },
]
loop = false
"""
    loop = Loop(build(load(world), speed=None))
    recorder = Recorder(JournalWriter(path, to_be_recorded(loop.parts.configuration)), is_live=False)
    loop.listeners.append(recorder)
    loop.run(Limits(seconds=8))
    recorder.close()
    return path


def test_a_recording_that_is_no_recording_is_trouble_and_the_other_tests_go_on(load: Load, tmp_path: Path) -> None:
    (tmp_path / "broken.jsonl").write_text("no journal\n", encoding="utf-8")
    tests = (
        '[[tests]]\ninput = { journal = "broken.jsonl" }\nexpect.near = { raised = 1 }\n'
        '[[tests]]\ninput = { journal = "missing.jsonl" }\nexpect.near = { raised = 1 }\n'
        f"[[tests]]\n{hovering('30 cm', '2 s', 'near = { raised = 1 }')}\n"
    )
    configuration = load(tests)
    broken, missing, sound = (run_rule_test(configuration, test) for test in configuration.tests)
    assert "not a journal" in broken.trouble
    assert "missing.jsonl" in missing.trouble
    assert not broken.passed
    assert sound.passed


def test_a_recording_of_another_target_is_trouble(load: Load, recorded: Path) -> None:
    tests = f'[[tests]]\ninput = {{ journal = "{recorded.name}" }}\nexpect.near = {{ raised = 0 }}\n'
    text = load(tests).text.replace("[targets.ball]", "[targets.tag]")
    recorded.with_name("other.toml").write_text(text, encoding="utf-8")
    configuration = load_configuration(recorded.with_name("other.toml"))
    result = run_rule_test(configuration, configuration.tests[0])
    assert "holds only ball, and the rules are about tag" in result.trouble


def test_a_test_decides_as_a_run_would_to_the_last_bit(load: Load, recorded: Path) -> None:
    """The journal's own events are those of the test on it."""
    configuration = load(f'[[tests]]\ninput = {{ journal = "{recorded.name}" }}\nexpect.near = {{ raised = 1 }}\n')
    result = run_rule_test(configuration, configuration.tests[0])
    recorded_events = [event for record in records_of(read_journal(recorded)) for event in record.decision.events]
    assert [event for _, event in result.events] == recorded_events


@pytest.mark.long
@pytest.mark.vision
def test_two_cameras_are_as_sure_of_a_ball_of_unknown_size_in_a_test_as_in_a_run(tmp_path: Path) -> None:
    configuration = two_cameras.load(tmp_path, targets_ball='tolerance = "unknown"')
    model = sensor_models(configuration)["ball"]
    watched = two_cameras.Watched(configuration, 2.0).run()
    ratios = [
        model.sigmas_m(measured.distance_m)[0] / measured.sigma_m
        for record, _ in watched.cycles
        for measured in record.observation.measurements
        if measured.distance_m is not None and measured.sigma_m
    ]
    assert len(ratios) > 20
    assert 0.6 < median(ratios) < 1.2, "where pictures are apart in time, a run is less sure"


# Every configuration that ships carries tests of its rules, and they pass.

FILES = sorted((Path(__file__).parents[2] / "config").glob("*.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_what_its_rules_promise_holds(file: Path) -> None:
    configuration = load_configuration(file)
    assert configuration.tests
    assert {test.name: run_rule_test(configuration, test).failures for test in configuration.tests} == {
        test.name: () for test in configuration.tests
    }


# Made-up distances: where a target truly is, and what noise, dropouts and gross errors make of it.

CAMERA = CameraModel(
    width_px=640, height_px=480, fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5, focal_relative_sigma=0.02
)
SENSOR = SensorModel(size=BallShape(diameter_m=0.2, relative_sigma=0.01), camera=CAMERA)
_, NOISE_M = SENSOR.sigmas_m(2.0)


def path_of(**motion: object) -> tuple[PathPoint, ...]:
    return MotionTable.model_validate(motion).path()


def measured(path: tuple[PathPoint, ...], frames: int = 2000, seed: int = 1, **nuisances: object) -> list[Measurement]:
    track = SyntheticTrack(target="ball", path=path, sensor=SENSOR, seed=seed, **nuisances)
    return [track.measure(frame / 30) for frame in range(frames)]


def standing(distance_m: float = 2.0) -> tuple[PathPoint, ...]:
    return (PathPoint(at_s=0.0, distance_m=distance_m),)


def distances(measurements: list[Measurement]) -> list[float]:
    return [each.distance_m for each in measurements if each.distance_m is not None]


def test_a_target_that_is_too_small_in_the_picture_is_not_found() -> None:
    assert not distances(measured(standing(41.0), frames=20))
    assert distances(measured(standing(30.0), frames=20))


def test_a_target_that_approaches_waits_then_goes_evenly_then_stays() -> None:
    path = path_of(approach={"from": "4 m", "to": "1 m", "speed": "2 m/s", "stay": "2 s"})
    assert [position_at(path, at_s).distance_m for at_s in (0, 1, 1.5, 2.5, 3, 9)] == [4, 4, 3, 1, 1, 1]
    assert path[-1].at_s == 4.5


def test_the_noise_is_what_camera_and_target_are_expected_to_have() -> None:
    found = distances(measured(standing(), 20_000, correlation=0.6))
    assert fmean(found) == pytest.approx(2.0, abs=0.1 * NOISE_M)
    assert pstdev(found) == pytest.approx(NOISE_M, rel=0.05)
    errors = [each - 2.0 for each in found]
    correlation = sum(a * b for a, b in pairwise(errors)) / sum(a * a for a in errors)
    assert correlation == pytest.approx(0.6, abs=0.03)


def test_the_stated_sigma_holds_what_is_the_same_in_every_frame_too() -> None:
    (seen,) = measured(standing(), 1, noise=0.0)
    assert seen.distance_m == 2.0
    assert seen.noise_m == NOISE_M
    assert seen.sigma_m == pytest.approx(math.hypot(NOISE_M, 2.0 * 0.02, 2.0 * 0.01))
    without_size_error = SensorModel(size=BallShape(diameter_m=0.2), camera=CAMERA)
    assert without_size_error.sigmas_m(2.0)[0] == pytest.approx(expect(BallShape(diameter_m=0.2), CAMERA, 2.0).sigma_m)


def test_out_of_sight_there_is_nothing_to_measure_and_the_reason_says_so() -> None:
    span = SpanTable.model_validate({"from": "1 s", "for": "0.5 s"})
    found = measured(standing(), 60, lost=[span])
    missing = [index for index, each in enumerate(found) if each.status is MeasurementStatus.NOT_FOUND]
    assert missing == list(range(30, 45))
    assert {found[index].reason for index in missing} == {"out of sight"}
    assert all(each.status is MeasurementStatus.NOT_FOUND for each in measured((), 10))


# A threshold is written back to where it stands, in each form that a condition has.

AROUND = """\
[camera]
driver = "simulated"
height = "1 m"
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[world]
[base]
driver = "simulated"
[targets.ball]
detector = "ideal"
[rules.it]
"""
FORMS = [
    ('below = "1 m"', "below", "2 m"),
    ('lost = "5 min"', "lost", "10 s"),
    ('seen = "5 s"', "seen", "6 s"),
    ('still = { for = "1 s" }', "still.for", "2 s"),
    ('base = { battery_below = "11 V" }', "base.battery_below", "10 V"),
    ('place = { axis = "height", above = "1 m" }', "place.above", "2 m"),
    ('speed = { axis = "sideways", above = "1 m/s" }', "speed.above", "2 m/s"),
]


def test_a_threshold_is_written_where_it_stands_and_every_other_setting_can_be_too(
    tmp_path: Path, subtests: pytest.Subtests
) -> None:
    path = tmp_path / "it.toml"
    for when, key, value in FORMS:
        with subtests.test(when=when):
            path.write_text(f"{AROUND}when = {{ {when} }}\n")
            configuration = load_configuration(path)
            text = with_settings(configuration, path.read_text(), "it", {key: value})
            assert text.endswith(f"= {{ {when} }}\n".replace(when.split('"')[-2], value))
            path.write_text(text)
            known = settings_of(load_configuration(path), "it")
            for other, setting in known.items():
                if other not in ("on_delay", "off_delay"):
                    path.write_text(with_settings(configuration, text, "it", {other: setting.value}))
                    load_configuration(path)
