"""What there is to see of a run: as JSON, drawn into the picture, and in words on its health."""

import json
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.clock import MonotonicClock, SteppedClock
from stadimeter.app.live.health import FAILED_UPGRADE, Board, BoardState, LiveHealth, live_health
from stadimeter.app.live.history import RunHistory, Seen
from stadimeter.app.live.pictures import SHOWN_MAX_PX, Pictures, drawn
from stadimeter.app.live.snapshot import LiveFeed, outline_of, shared_data
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.messages import health_figures
from stadimeter.app.watching import live_feed
from stadimeter.config.loader import load_configuration
from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.core.message import Message
from support.broker import free_port
from support.cycle_records import cycle_record, tracked
from support.simulated_run import SIMULATED_BALL

NEAR = """
[rules.near]
when = { below = "2 m" }

[world]
path = [{ at = "0 s", x = "3 m", y = "0 m" }, { at = "2 s", x = "1 m", y = "0 m" }]
loop = false
"""


@pytest.fixture(scope="module")
def demonstration():
    """Return the loop of a demonstration that has run, and its feed."""
    loop = Loop(build(demo_configuration(), speed=None))
    feed = live_feed(loop)
    loop.run(Limits(frames=120))
    return loop, feed


def as_data(feed):
    """Return a snapshot as whoever watches reads it; a number that JSON does not have is refused."""
    shared = shared_data(feed.snapshot(), 1, feed.clock.now_s(), 1_790_000_000.0)
    return json.loads(json.dumps(shared), parse_constant=pytest.fail)


@pytest.mark.long
def test_it_tells_every_target_rule_and_output_of_the_run(demonstration):
    loop, feed = demonstration
    data, plan = as_data(feed), loop.parts.configuration.plan
    assert [target["name"] for target in data["targets"]] == list(plan.targets)
    assert [rule["rule"] for rule in data["rules"]] == [rule.name for rule in plan.rules]
    assert [output["output"] for output in data["outputs"]] == [output.name for output in plan.outputs]
    assert data["run"]["digest"]
    assert data["safety"] == {"mode": "active", "reason": ""}
    assert data["unix_s"] - data["now_s"] == pytest.approx(1_790_000_000.0)


def prepared(folder, text=""):
    """Return the loop of a run of a ball that comes nearer, before it begins, and its feed."""
    (folder / "run.toml").write_text(SIMULATED_BALL + text + NEAR)
    loop = Loop(build(load_configuration(folder / "run.toml"), speed=None))
    return loop, live_feed(loop)


def test_it_tells_where_messages_go_and_the_newest_of_each_topic(tmp_path):
    messenger = f'[messenger]\ndriver = "mqtt"\nport = {free_port()}\nnode = "garage"\ncommands = "all"\n'
    loop, feed = prepared(tmp_path, messenger)
    loop.run(Limits(frames=200))
    for payload in ("known", ""):
        loop.deliveries.note_published(9.0, Message(topic="rule/gone/state", payload=payload, qos=1, retain=True))
    link = as_data(feed)["messenger"]
    place = loop.parts.configuration.messenger.options.place
    assert (link["broker"], link["base"], link["commands"], link["deafness"]) == (place, "stadimeter/garage", "all", "")
    assert link["home_assistant"] == "homeassistant/device/stadimeter_garage/config"
    assert link["trouble"] == f"the messenger for {place} is not open"
    assert (link["undelivered"], link["given_up"]) == (len(loop.parts.messenger.undelivered()), 0)
    assert link["undelivered"] > 0
    assert link["dropped"] == loop.parts.messenger.dropped > 0
    topics = [each["topic"] for each in link["topics"]]
    assert {"target/ball/state", "rule/near/state", "event/system", "info"} <= set(topics)
    assert "rule/gone/state" not in topics, "it was cleared"
    assert len(topics) == len(set(topics))
    assert [each["at_s"] for each in link["topics"]] == sorted((each["at_s"] for each in link["topics"]), reverse=True)
    newest = {message.topic: message.payload for _, message in reversed(loop.deliveries.published)}
    assert newest.items() >= {each["topic"]: each["payload"] for each in link["topics"][:10]}.items()


@pytest.mark.long
def test_the_figures_are_those_of_the_cycle_and_the_outline_lies_where_the_ball_was_found(demonstration):
    _, feed = demonstration
    record, (target,) = feed.history.record, as_data(feed)["targets"]
    (track,) = record.decision.tracks
    assert target["distance_m"] == pytest.approx(track.distance_m, abs=1e-4)
    found = target["detection"]
    across = np.ptp(np.array(found["outline_px"]), axis=0)
    assert across == pytest.approx([found["width_px"], found["height_px"]], rel=0.05)
    assert len(found["outline_px"]) <= 64
    assert target["thresholds_m"] == sorted(target["thresholds_m"])


def test_what_is_no_number_is_null():
    feed = LiveFeed(SteppedClock())
    broken = Detection(
        target="ball",
        status=DetectionStatus.TRUNCATED,
        centre_px=(math.nan, math.inf),
        width_px=math.inf,
        outline_px=np.array([[1.0, 2.0], [math.nan, 3.0], [math.inf, 4.0]]),
        rejected=(RejectedCandidate(centre_px=(1.0, math.nan), size_px=math.inf, reason="too large"),),
    )
    track = tracked(distance_m=math.nan, sigma_m=math.inf, bearing_rad=-math.inf)
    feed.history.add(replace(cycle_record(1.0, tracks=(track,)), detections=(broken,)), None)
    (target,) = as_data(feed)["targets"]
    assert (target["distance_m"], target["sigma_m"], target["bearing_rad"]) == (None, None, None)
    assert target["detection"]["centre_px"] == [None, None]
    assert target["detection"]["outline_px"] == [[1.0, 2.0]]
    assert target["rejected"][0]["centre_px"] == [1.0, None]


def test_the_outline_of_a_sheet_is_its_corners_in_order_and_that_of_a_ball_goes_round_it():
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [9.0, 8.0], [1.0, 9.0]])
    sheet = Detection(target="paper", status=DetectionStatus.FOUND, outline_px=corners)
    assert outline_of(sheet, has_corners=True) == corners.tolist()
    angles = np.random.default_rng(1).permutation(np.linspace(-3.1, 3.1, 200))
    limb = 50 + 20 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ball = Detection(target="ball", status=DetectionStatus.FOUND, outline_px=limb)
    around = np.array(outline_of(ball, has_corners=False))
    assert len(around) == 64
    assert (np.diff(np.arctan2(around[:, 1] - 50, around[:, 0] - 50)) > 0).all()


def a_frame(width_px=640, height_px=480):
    return Frame(image=np.full((height_px, width_px, 3), 90, np.uint8), captured_at_s=1.0, sequence=3)


def found_at(centre_px, radius_px):
    angles = np.linspace(0, 2 * np.pi, 60)
    limb = np.array(centre_px) + radius_px * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return Detection(target="ball", status=DetectionStatus.FOUND, outline_px=limb, centre_px=centre_px)


def test_outline_centre_and_words_are_drawn_into_a_copy():
    frame = a_frame()
    record = replace(cycle_record(1.0), detections=(found_at((300.0, 200.0), 50.0),))
    picture = drawn(frame.image, record, frame.width_px)
    changed = (picture != frame.image).any(axis=2)
    assert changed[200, 348:353].any()  # the outline
    assert changed[200, 300]  # the centre
    assert changed[125:148, 250:400].any()  # the words above it
    assert changed[0:60, 0:200].any()  # the rules that do something
    assert not changed[300:, 400:].any()
    assert (frame.image == 90).all()


def test_a_large_frame_is_shown_smaller_and_drawn_at_the_same_place():
    frame = a_frame(3840, 2160)
    record = replace(cycle_record(1.0, rules=()), detections=(found_at((1920.0, 1080.0), 300.0),))
    jpeg = Pictures().jpeg(Seen(record, frame), "drawn", 95)
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (720, SHOWN_MAX_PX, 3)
    rows, columns = np.nonzero(np.ptp(picture.astype(int), axis=2) > 60)  # what is green
    assert (columns.min() + columns.max()) / 2 == pytest.approx(640, abs=40)
    assert rows.max() == pytest.approx(360 + 100, abs=4)


@pytest.mark.parametrize("outline", [[[math.nan, 1.0]], [[1e300, -1e300], [5.0, 5.0]], [[-1e9, 1e9]]])
def test_what_is_far_outside_or_no_number_is_drawn_nowhere_and_breaks_nothing(outline):
    frame = a_frame()
    detection = Detection(
        target="ball", status=DetectionStatus.FOUND, outline_px=np.array(outline), centre_px=(1e300, math.nan)
    )
    record = replace(cycle_record(1.0, rules=()), detections=(detection,))
    assert (drawn(frame.image, record, frame.width_px) == frame.image).all()


def board(tmp_path, temperature="48312", throttled="0"):
    for path, text in (
        ("sys/class/thermal/thermal_zone0/temp", temperature),
        ("sys/bus/platform/drivers/raspberrypi-firmware/soc:firmware/get_throttled", throttled),
        ("proc/self/statm", "100 50 1 1 0 1 0"),
    ):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text + "\n")
    return Board(folder=tmp_path, root=tmp_path, clock=lambda: 0.0)


def words_of(health):
    return {note.what: (note.words, note.is_good) for note in health.notes}


def test_a_pi_says_how_warm_it_is_and_what_throttles_it(tmp_path):
    state = board(tmp_path, "84000", "50005").state()
    assert state.temperature_c == pytest.approx(84.0)
    assert state.memory_bytes == 50 * 4096
    words = words_of(LiveHealth(board=state))
    assert words["processor"] == ("84 °C, cool it", False)
    assert words["supply and heat"] == ("under-voltage, throttled", False)
    assert "supply and heat" not in words_of(LiveHealth(board=board(tmp_path).state()))


def test_an_upgrade_that_failed_is_a_trouble_in_words_and_in_what_is_published(tmp_path):
    words = "the upgrade to stadimeter 1.2 failed its self-test, and 1.1 stays: no numpy"
    (tmp_path / FAILED_UPGRADE).parent.mkdir(parents=True)
    (tmp_path / FAILED_UPGRADE).write_text(f"{words}\n")
    health = live_health(RunHistory(), board(tmp_path), "", "the disk is full")
    assert words_of(health)["trouble"] == (f"the disk is full; {words}", False)
    assert health_figures(health, 0, 0)["trouble"] == f"the disk is full; {words}"


def test_a_picture_that_is_old_a_disk_that_is_full_and_a_broker_that_is_away_are_not_good():
    health = LiveHealth(
        frame_rate_hz=0.0,
        frame_age_s=3.2,
        broker="the broker is away",
        board=BoardState(disk_free_bytes=1_000_000),
        trouble="the broker is away",
    )
    words = words_of(health)
    assert words["camera"] == ("0.0 pictures a second, 3.2 s old", False)
    assert words["disk"] == ("1 MB free", False)
    assert words["broker"] == ("the broker is away", False)
    assert not words_of(replace(health, frame_age_s=0.03, broker="connected"))["trouble"][1]


@pytest.mark.parametrize(
    ("clock", "real_s_each", "pace", "rate_hz"),
    [
        (SteppedClock(speed=1.0), 0.1, 1 / 3, 10.0),  # at a third of real time
        (SteppedClock(speed=1.0), 1 / 30, 1.0, 30.0),
        (SteppedClock(speed=0.5), 2 / 30, 1.0, 30.0),  # as slow as it was asked for
        (SteppedClock(), 0.1, 1.0, 30.0),  # as fast as this computer can
        (MonotonicClock(), 1 / 30, 1.0, 30.0),
    ],
)
def test_a_run_that_falls_behind_its_speed_is_not_well_whatever_rate_its_own_clock_gives(
    clock, real_s_each, pace, rate_hz
):
    real_s = [100.0]
    feed = LiveFeed(clock, RunHistory(real_time_s=lambda: real_s[0]))
    for number in range(90):
        frame = Frame(np.zeros((2, 2, 3), np.uint8), number / 30, number)
        feed.history.add(cycle_record(number / 30), frame)
        real_s[0] += real_s_each
    health = feed.snapshot().health
    assert health.pace == pytest.approx(pace, rel=0.01)
    assert health.frame_rate_hz == pytest.approx(rate_hz, rel=0.02)
    assert ("pace" in words_of(health)) == (pace < 0.9)
    assert all(note.is_good for note in health.notes if note.what != "pace")


# Figures on a run that tell what the program took.


DEMO = Path(__file__).parents[2] / "config" / "demo.toml"


@pytest.mark.long
def test_a_run_tells_its_first_command_and_its_memory():
    told = subprocess.run(
        [sys.executable, "-m", "stadimeter", "run", str(DEMO), "--frames", "2", "--speed", "0", "--json"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    summary = json.loads(told.stdout)
    assert summary["first_command_s"] > 0
    assert summary["peak_memory_mb"] > 40
