"""A real video of a green ball, through the whole program: camera file, motor, base and a real broker's stand-in."""

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.guard import LeasedOutput
from stadimeter.app.loop import Loop
from stadimeter.app.recordings.journal import JournalWriter, read_journal, to_be_recorded
from stadimeter.app.recordings.recorder import Recorder
from stadimeter.config.loader import load_configuration
from stadimeter.core.outputs import safe_command
from support.recording_doubles import RecordingActuator, RecordingBase, RecordingMessenger
from support.recordings import records_of
from support.replaying import replay
from support.simulated_run import LENS

# The base of a video does not move what is seen, so the ball seems to run away from it, and is turned after: with a
# small bearing the one may outweigh the other.
CLEAR_RAD = 0.2

# The ball's size is not known; with 6.4 cm and 600 px it moves between about 0.5 and 1 m.
CONFIGURATION = """
[camera]
driver = "video"
path = "{video}"
{lens}[targets.ball]
detector = "ball"
diameter = "6.4 cm"
hsv = "29,86,6:64,255,255"
[actuators.motor]
driver = "simulated"
[base]
driver = "simulated"
[rules.far]
actuator = "motor"
ramp = {{ from = "70 cm", to = "1.2 m" }}
[rules.follow]
actuator = "base"
follow = {{ distance = "60 cm", search = "off" }}
[rules.near]
severity = "alarm"
when = {{ below = "60 cm" }}
[world]
"""


@pytest.fixture(scope="module")
def run(real_pictures, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ball video")
    path = folder / "ball.toml"
    path.write_text(CONFIGURATION.format(lens=LENS, video=real_pictures / "ball_video" / "green_ball.mp4"))
    configuration = load_configuration(path)
    parts = build(configuration, speed=None)
    doubles = {"motor": RecordingActuator(parts.clock, "motor"), "base": RecordingBase(parts.clock, "base")}
    parts.outputs = parts.cycle.outputs = tuple(
        LeasedOutput(doubles[output.name], safe_command(output), 0.3, parts.clock)
        for output in configuration.plan.outputs
    )
    parts.messenger = RecordingMessenger()
    journal = Recorder(JournalWriter(folder / "ball.jsonl", to_be_recorded(configuration)), is_live=False)
    loop = Loop(parts, listeners=[journal])
    loop.run()
    journal.close()
    return loop, read_journal(folder / "ball.jsonl")


@pytest.fixture(scope="module")
def records(run):
    return list(records_of(run[1]))


pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


def test_the_video_ends_normally_after_all_its_frames(run):
    assert run[0].history.frames == 1004
    assert run[0].ending.endswith("green_ball.mp4 is at its end")


def test_the_ball_is_known_in_most_frames(run):
    statuses = run[0].history.track_statuses["ball"]
    assert statuses["tracking"] >= 740
    assert statuses["tracking"] + statuses["coasting"] >= 850


def test_the_motor_follows_its_ramp_in_every_frame(records):
    acted = 0
    for record in records:
        (track,) = record.decision.tracks
        level = record.applied[0].level
        if not track.is_valid or record.decision.safety != "active":
            assert level == 0.0
        elif track.distance_m > 0.7:
            assert level == pytest.approx(min(1.0, (track.distance_m - 0.7) / 0.5))
            acted += 1
    assert acted > 100


def test_the_base_turns_towards_the_ball_and_never_backs_off(records):
    turned = 0
    for record in records:
        (track,), base = record.decision.tracks, record.applied[1]
        assert base.linear_mps >= 0
        if track.is_valid and base.angular_radps:
            if abs(track.bearing_rad) > CLEAR_RAD:
                assert (base.angular_radps > 0) is (track.bearing_rad < 0)
            turned += 1
        if not track.is_valid:
            assert (base.linear_mps, base.angular_radps) == (0.0, 0.0)
    assert turned > 100


def test_a_replay_gives_identical_decisions(run):
    loop, journal = run
    result = replay(journal, loop.parts.configuration.plan)
    assert (result.cycles, result.identical) == (1004, 1004)
