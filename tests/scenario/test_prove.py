"""The proof finds every defect that is planted in the program, and none in the program as it is."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from scenario.prove import staging
from scenario.prove.faults import PlannedFault
from scenario.prove.proof import MOMENTS_S, Proof, prove, sequences
from scenario.prove.staging import stage
from stadimeter.app import capture, guard
from stadimeter.bases import pan_servo, serial_base, waveshare_ugv
from stadimeter.bases.protocol import WheelSpeeds
from stadimeter.config.loader import load_configuration
from stadimeter.core import decide, outputs, safety
from stadimeter.core.plan import Tracking
from stadimeter.core.rules import follow
from stadimeter.errors import ConfigError, StadimeterError
from support.ready_bases import FOLLOW_BALL, follow_ball

CONFIG = Path(__file__).parents[2] / "config"
ROBOT = Path("robot.toml")
SENSOR = '\n[sensors.front]\ndriver = "tf-luna"\nport = "/dev/serial0"\nstop_below = "20 cm"\n'

Plant = Callable[[pytest.MonkeyPatch], None]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_robot("ros-arduino-bridge")


def write_robot(base: str, change: Callable[[str], str] = lambda text: text) -> None:
    """Write the ball follower with another of the bases in its file, or with another change."""
    ROBOT.write_text(change(follow_ball(base)), encoding="utf-8")


def proven(faults: int, *only: str) -> Proof:
    return prove(ROBOT, faults, Path("counter-example.jsonl"), only)


def ignore_the_age_of_frames(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(safety, "_fault", lambda frame, *_: "" if frame else "no frame yet")


def never_end_a_lease(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(guard.LeasedOutput, "_is_stale", lambda *_: False)


def take_any_picture_for_new(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(capture.FreezeDetector, "_what_is_old", lambda *_: "")


def recover_without_rest(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(guard, "REST_S", 0.0)


def stay_armed(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(decide, "_cause_to_disarm", lambda *_: "")


def coast_for_ever(patch: pytest.MonkeyPatch) -> None:
    step = decide.step_track

    def step_hopefully(track: Any, seen: Any, now_s: float, settings: Tracking) -> Any:
        return step(track, seen, now_s, replace(settings, coast_s=60.0))

    patch.setattr(decide, "step_track", step_hopefully)


def send_no_stop_at_the_end(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(serial_base.SerialBase, "stop", lambda _: None)


def exceed_the_speed(patch: pytest.MonkeyPatch) -> None:
    def ease_not(_output: Any, _before: Any, wanted: tuple[float, float], _step_s: float) -> Any:
        return (9 * wanted[0], 9 * wanted[1]), (0.0, 0.0)

    patch.setattr(outputs, "ease_twist", ease_not)
    patch.setattr(outputs, "limit_twist", lambda *given: ease_not(*given)[0])


# A camera on two servos, as its page has it.
PAGE = (CONFIG.parent / "docs" / "robots" / "pan-servo.md").read_text(encoding="utf-8")
(ON_SERVOS,) = re.findall(r"```toml\n(.*?)```", PAGE.replace("#tilt", "tilt"), re.DOTALL)

# Each defect with the faults that show it.
DEFECTS: tuple[tuple[Plant, tuple[str, ...]], ...] = (
    (ignore_the_age_of_frames, ("block-camera",)),
    (never_end_a_lease, ("hang-loop",)),
    (take_any_picture_for_new, ("freeze-picture",)),
    (recover_without_rest, ("unplug-base",)),
    (coast_for_ever, ("hide-target",)),
    (send_no_stop_at_the_end, ("end-process",)),
    (exceed_the_speed, ()),
)


@pytest.mark.long
def test_a_run_that_arms_itself_again_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    write_robot("ros-arduino-bridge", lambda text: f'{text}\n[safety]\narm = "by-button"\n')
    assert proven(1, "unplug-base", "block-camera").counter_example is None
    stay_armed(monkeypatch)
    found = proven(1, "unplug-base", "block-camera").counter_example
    assert found is not None
    assert found.violation is not None
    assert "without being armed again" in found.violation.words


def send_no_time_out(patch: pytest.MonkeyPatch) -> None:
    make = waveshare_ugv.WaveshareUgvCodec.__init__

    def make_silent(codec: Any, auto_stop_s: float) -> None:
        make(codec, auto_stop_s)
        codec.opening = tuple(each for each in codec.opening if b'"T":136' not in each)

    patch.setattr(waveshare_ugv.WaveshareUgvCodec, "__init__", make_silent)


def spoil_wheels(patch: pytest.MonkeyPatch, spoil: Callable[[float, float], tuple[float, float]]) -> None:
    """Have other wheel speeds sent than those that are told to have been applied."""
    encode = waveshare_ugv.WaveshareUgvCodec.encode

    def encode_wrong(codec: Any, wheels: WheelSpeeds) -> Any:
        left_mps, right_mps = spoil(wheels.left_mps, wheels.right_mps)
        wrong = encode(codec, WheelSpeeds(left_mps=left_mps, right_mps=right_mps))
        return replace(wrong, sent=encode(codec, wheels).sent)

    patch.setattr(waveshare_ugv.WaveshareUgvCodec, "encode", encode_wrong)


def double_the_speed_backwards(patch: pytest.MonkeyPatch) -> None:
    spoil_wheels(patch, lambda left_mps, right_mps: (min(left_mps, 2 * left_mps), min(right_mps, 2 * right_mps)))


def turn_one_wheel_the_wrong_way(patch: pytest.MonkeyPatch) -> None:
    spoil_wheels(patch, lambda left_mps, right_mps: (left_mps, -right_mps))


@pytest.mark.parametrize(
    ("plant", "fault", "words"),
    [
        (send_no_time_out, "cut-cable", "the wheels still turn"),
        (double_the_speed_backwards, "", "wheel turns at -"),
        (turn_one_wheel_the_wrong_way, "", "the right wheel turns at"),
    ],
)
def test_a_defect_of_a_driver_that_says_what_is_right_is_found_by_what_the_base_does(
    plant: Plant, fault: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_robot("waveshare-ugv")
    assert proven(1, fault or "hide-target").counter_example is None
    plant(monkeypatch)
    found = proven(1, fault or "hide-target").counter_example
    assert found is not None
    assert found.violation is not None
    assert words in found.violation.words
    assert [planned.fault for planned in found.sequence] == ([fault] if fault else [])


@pytest.mark.long
@pytest.mark.parametrize(("plant", "shown_by"), DEFECTS, ids=[plant.__name__ for plant, _ in DEFECTS])
def test_a_planted_defect_is_found(plant: Plant, shown_by: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    assert proven(1, *shown_by or ["hide-target"]).counter_example is None
    plant(monkeypatch)
    found = proven(1, *shown_by or ["hide-target"]).counter_example
    assert found is not None
    assert {planned.fault for planned in found.sequence} == set(shown_by)


def test_a_proof_that_ends_early_counts_what_it_tried() -> None:
    proof = prove(ROBOT, 2, Path("counter-example.jsonl"), ["hide-target", "end-process"], within_s=0.0)
    assert (proof.trials, proof.planned) == (1, len(list(sequences(["hide-target", "end-process"], 2))))


@pytest.mark.long
def test_one_fault_of_any_kind_keeps_no_limit_from_holding() -> None:
    proof = proven(1)
    assert proof.counter_example is None
    assert proof.trials == 1 + len(proof.alphabet)
    # Without the program, or beyond its reach, the base has its own 0.5 s; else there is a lease of 0.3 s.
    assert 0.5 < proof.longest["program"][0] < 0.9
    assert 0.5 < proof.longest["cable"][0] < 0.9
    assert all(proof.longest[reason][0] < 0.8 for reason in ("frames", "target", "end"))


def test_each_sequence_is_tried_once() -> None:
    names = [tuple(map(str, sequence)) for sequence in sequences(["hide-target", "kill-process"], 2)]
    assert len(names) == len(set(names))
    assert names[0] == ()
    assert ("hide-target at 1.50 s", "kill-process at 1.50 s") in names
    assert ("kill-process at 1.50 s", "hide-target at 1.50 s") not in names
    assert ("kill-process at 1.50 s", "hide-target at 1.60 s") not in names  # nothing moves the base any more
    # None, each alone, both at once; and after a first hidden target each at every later moment.
    assert len(names) == 1 + 2 + 1 + 2 * (len(MOMENTS_S) - 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[: text.index("[base]")], "nothing drives"),
        (lambda text: text.replace('below = "40 cm"', 'below = "40 m"'), "nothing can be proven"),
    ],
    ids=["no base", "a rule that always stops it"],
)
def test_what_cannot_be_proven_is_refused(change: Callable[[str], str], words: str) -> None:
    write_robot("ros-arduino-bridge", change)
    with pytest.raises(StadimeterError, match=words):
        proven(1, "hide-target")


@pytest.mark.long
@pytest.mark.parametrize("fault", ["kill-process", "hang-process"])
def test_the_watchdog_process_stops_pins_that_nothing_else_stops(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    write_robot("gpio-motors")
    assert proven(1, fault).counter_example is None
    monkeypatch.setattr(staging, "safe_lines", lambda _: ())
    found = proven(1, fault).counter_example
    assert found is not None
    assert found.violation is not None
    assert "after the process was stopped" in found.violation.words


def test_a_base_without_a_time_out_is_a_counter_example() -> None:
    write_robot("ros-arduino-bridge", lambda text: text.replace('auto_stop = "500 ms"', 'auto_stop = "0 s"'))
    found = proven(1, "kill-process", "cut-cable").counter_example
    assert found is not None
    assert found.violation is not None
    assert found.sequence == (PlannedFault(1.5, "cut-cable"),)  # killed, it is stopped by the watchdog process


def write_camera_on_servos() -> None:
    head = FOLLOW_BALL[FOLLOW_BALL.index("[camera]") : FOLLOW_BALL.index("[base]")]
    ROBOT.write_text(head + ON_SERVOS, encoding="utf-8")


@pytest.mark.long
def test_one_fault_of_any_kind_keeps_no_servo_turning() -> None:
    write_camera_on_servos()
    proof = proven(1)
    assert proof.counter_example is None
    assert proof.trials == 1 + len(proof.alphabet) > 20
    assert proof.parts == "servos"
    assert 0.05 < proof.longest["program"][0] < 0.3, "it stands with its last pulse"
    assert 0.3 < max(seconds for seconds, _ in proof.longest.values()) < 0.6


def forget_where_servos_were(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(pan_servo.PanServoBase, "_sent_rad", property(lambda _: None, lambda *_: None), raising=False)


def tilt_without_a_target(patch: pytest.MonkeyPatch) -> None:
    requests = follow._requests
    patch.setattr(follow, "_requests", lambda rule, base, twist, _, **how: requests(rule, base, twist, 0.3, **how))


@pytest.mark.long
@pytest.mark.parametrize(
    ("plant", "fault"), [(forget_where_servos_were, "hold-bus"), (tilt_without_a_target, "hide-target")]
)
def test_a_planted_defect_of_a_camera_on_servos_is_found(
    plant: Plant, fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_camera_on_servos()
    assert proven(1, fault).counter_example is None
    plant(monkeypatch)
    found = proven(1, fault).counter_example
    assert found is not None
    assert found.violation is not None
    assert "servo" in found.violation.words


@pytest.mark.long
@pytest.mark.parametrize("base", ["gpio-motors", "pca9685"])
def test_pins_are_proven_too(base: str) -> None:
    write_robot(base)
    proof = proven(1, "block-camera", "hang-loop", "end-process", "fail-in-loop")
    assert proof.counter_example is None
    assert proof.longest["frames"][0] > 0.3  # the lease of a loop that hangs


def test_a_base_without_an_emulator_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    configuration = load_configuration(ROBOT)
    base = replace(configuration.base, driver="home-made") if configuration.base else None
    drivers: Any = {**configuration.drivers, ("base",): base}
    with pytest.raises(ConfigError, match="no emulator of the base 'home-made'"):
        stage(replace(configuration, drivers=drivers))


@pytest.mark.long
@pytest.mark.timeout(3000)
@pytest.mark.parametrize(("base", "turns_s"), [("ros-arduino-bridge", 1.2), ("gpio-motors", 1.6)])
def test_no_two_faults_keep_the_wheels_of_the_ball_follower_turning(base: str, turns_s: float) -> None:
    write_robot(base, lambda text: text + SENSOR)
    proof = proven(2)
    assert proof.counter_example is None
    assert proof.trials == proof.planned > 1800
    assert max(seconds for seconds, _ in proof.longest.values()) < turns_s
