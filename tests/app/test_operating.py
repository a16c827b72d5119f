"""What people do to a run beside its rules: record it, move its ball, list its alarms. Through whole simulated runs."""

import json
import shutil
import threading

import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.control import recording
from stadimeter.app.control.messages import Reply, parse_request
from stadimeter.app.control.recording import Bounds, RecordingOnRequest, recordings_folder
from stadimeter.app.control.socket_server import Asked
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.watching import attend_to_requests
from stadimeter.config.loader import load_configuration
from stadimeter.errors import DriverError
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay import read_recording, replay_run
from support.simulated_run import SIMULATED_BALL

ROOM = (
    SIMULATED_BALL
    + """
[rules.near]
actuator = "motor"
when = { below = "1.6 m" }
on_delay = "0 s"
ack = "required"

[rules.far]
actuator = "motor"
ramp = { from = "2 m", to = "3 m" }

[world]
loop = false
path = [{ at = "0 s", x = "1 m", y = "0 m" }, { at = "3 s", x = "3 m", y = "0.4 m" }]
"""
)


class Room:
    """A simulated run that is asked for something after some of its frames."""

    def __init__(self, folder):
        self.path = folder / "room.toml"
        self.path.write_text(ROOM)
        self.loop = Loop(build(load_configuration(self.path), speed=None))
        self.waiting, self.answers, self.records, self.plans, self.told = [], [], [], {}, []
        self.loop.services.tell = self.told.append

    def take(self):
        taken, self.waiting = self.waiting, []
        return taken

    def at(self, frame, op, **args):
        """Ask for something after a frame; time waits until it is answered."""
        self.plans[frame] = {"op": op, "args": args}

    def listen(self, record, _frame):
        self.records.append(record)
        count = len(self.records)
        if count in self.plans:
            request = parse_request(json.dumps(self.plans[count]).encode())
            self.waiting.append(Asked(request, self.answers.append))
        begins = count - 1 in self.plans and self.plans[count - 1] == {"op": "record", "args": {"do": "start"}}
        if begins:  # the file is opened in a thread: simulated time waits for it
            assert eventually(lambda: not self.loop.services.recording._is_beginning)

    def run(self, frames=150):
        with attend_to_requests(self.loop, [self.take]):
            self.loop.listeners.append(self.listen)
            self.loop.run(Limits(frames=frames))
        assert eventually(lambda: len(self.answers) == len(self.plans))
        return [answer if isinstance(answer, Reply) else answer() for answer in self.answers]


@pytest.fixture
def room(tmp_path):
    return Room(tmp_path)


@pytest.fixture
def goes_on(monkeypatch):
    """Return what must be set before a recording's file is open."""
    opened, goes_on = RecordingOnRequest._opened, threading.Event()

    def open_late(begun, answer):
        file = opened(begun, answer)
        assert goes_on.wait(120)
        return file

    monkeypatch.setattr(RecordingOnRequest, "_opened", open_late)
    return goes_on


def replayed(path):
    """Return how many cycles a recording has; each must replay to the decision that is recorded."""
    cycles = 0
    for cycle, _, decision in replay_run(read_recording(path), None):
        assert cycle.record().decision == decision
        cycles += 1
    return cycles


class TestStopping:
    def test_every_output_is_safe_until_released_and_the_recording_replays(self, room):
        room.at(20, "record", do="start")
        room.at(60, "stop-outputs", by="zoe", why="a child")
        room.at(100, "release-outputs", by="ada")
        begun, stopped, released = room.run(frames=140)
        levels = [record.applied[0].level for record in room.records]
        assert any(levels[40:60])
        assert not any(levels[61:100])
        assert any(levels[101:])
        assert stopped.data["words"].startswith("the outputs are stopped until released")
        assert released.data["words"] == "the outputs are released; they were stopped by zoe: a child"
        assert replayed(room.path.parent / "recordings" / begun.data["file"]) > 90

    def test_whoever_stops_a_run_without_a_state_file_learns_that_its_end_is_the_end_of_the_stop(self, room):
        room.at(40, "stop-outputs")
        (stopped,) = room.run(frames=60)
        assert "keeps no state" in stopped.data["words"]

    def test_an_output_that_did_not_obey_is_named(self, room):
        def unplug(record, _frame):
            if len(room.records) == 39:
                motor = room.loop.parts.driven[0]
                motor._fail(DriverError("no answer"))

        room.at(40, "stop-outputs")
        room.loop.listeners.append(unplug)
        (stopped,) = room.run(frames=60)
        assert "motor did not confirm it (no answer)" in stopped.data["words"]


class TestRecording:
    def test_what_is_recorded_from_the_middle_of_a_run_replays_to_the_same_decisions(self, room):
        room.at(40, "record", do="start")
        room.at(120, "record", do="stop")
        begun, ended = room.run()
        assert (begun.error, ended.error) == ("", "")
        path = room.path.parent / "recordings" / begun.data["file"]
        assert path.stat().st_size == ended.data["bytes"] > 0
        assert 60 < replayed(path) < 90

    def test_a_second_one_is_refused_and_so_is_the_end_of_none(self, room):
        room.at(10, "record", do="stop")
        room.at(40, "record", do="start")
        room.at(60, "record", do="start")
        none, begun, second = room.run()
        assert none.error == "nothing is recorded"
        assert begun.error == ""
        assert second.error == "a recording is under way already; end it first"

    def test_one_before_which_the_configuration_is_reloaded_replays_to_the_same_decisions(self, room, goes_on):
        def reload_meanwhile(record, _frame):
            requests = {20: '{"op": "record", "args": {"do": "start"}}', 22: '{"op": "reload"}'}
            room.records.append(record)
            count = len(room.records)
            if count in requests:
                room.path.write_text(ROOM.replace("1.6 m", "2.9 m").replace('"0 s"\nack', '"0.6 s"\nack'))
                room.waiting.append(Asked(parse_request(requests[count].encode()), room.answers.append))
            if count == 23:
                assert eventually(lambda: room.loop.services.control._reloader._ready or room.answers)
            if count == 34:
                goes_on.set()
                assert eventually(lambda: not room.loop.services.recording._is_beginning)

        with attend_to_requests(room.loop, [room.take]):
            room.loop.listeners.append(reload_meanwhile)
            room.loop.run(Limits(frames=150))
        assert [answer.error for answer in room.answers] == ["", ""]
        assert replayed(room.path.parent / "recordings" / room.answers[1].data["file"]) > 90

    def test_one_whose_folder_vanishes_ends_and_a_person_is_told(self, room, monkeypatch):
        monkeypatch.setattr(recording, "LOOK_EVERY_S", 0.01)

        def vanish(record, _frame):
            begun = room.loop.services.recording._begun
            if len(room.records) == 60:
                shutil.rmtree(begun.path.parent)
            if len(room.records) == 61 and begun is not None:  # which looks at the disk, unless it has already
                assert eventually(lambda: begun.recorder.failure)

        room.at(40, "record", do="start")
        room.loop.listeners.append(vanish)
        room.run()
        assert "has ended: " in room.told[-1]
        assert "No such file" in room.told[-1], "of the folder, or of the file, whichever was noticed first"

    @pytest.mark.parametrize(
        ("bounds", "words"),
        [(Bounds(folder_bytes=-1), "delete recordings first"), (Bounds(free_bytes=10**18), "make room first")],
    )
    def test_none_begins_while_folder_or_disk_is_full(self, room, bounds, words, monkeypatch):
        monkeypatch.setattr(recording, "Bounds", lambda: bounds)
        room.at(40, "record", do="start")
        (refused,) = room.run()
        assert words in refused.error
        assert list((room.path.parent / "recordings").iterdir()) == []

    @pytest.mark.parametrize(
        ("bounds", "words"), [(Bounds(file_bytes=-1), "0 MB"), (Bounds(seconds=1.5), "it is 0 min long")]
    )
    def test_one_that_reaches_a_bound_ends_whole_and_a_person_is_told(self, room, bounds, words, monkeypatch):
        monkeypatch.setattr(recording, "Bounds", lambda: bounds)
        room.at(40, "record", do="start")
        (begun,) = room.run()
        assert words in room.told[-1]
        assert 0 < replayed(room.path.parent / "recordings" / begun.data["file"]) < 90

    def test_a_service_records_to_the_folder_of_its_state(self, tmp_path, monkeypatch):
        monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/stadimeter")
        assert str(recordings_folder(tmp_path / "room.toml")) == "/var/lib/stadimeter/recordings"


class TestWorld:
    def test_the_ball_goes_where_it_is_put_and_back_to_its_path(self, room):
        room.at(10, "world", x_m=2.5, y_m=0.5)
        room.at(40, "world", release=True)
        put, released = room.run()
        assert released.error == ""
        assert put.data["targets"][0]["name"] == "ball"
        seen_m = [record.decision.tracks[0].distance_m for record in room.records]
        assert seen_m[35] == pytest.approx((2.5**2 + 0.5**2 + 0.15**2) ** 0.5, abs=0.05)
        path_m = room.loop.parts.world.ball.position_m(room.records[-1].observation.now_s)
        assert seen_m[-1] == pytest.approx((path_m[0] ** 2 + path_m[1] ** 2) ** 0.5, abs=0.1)

    def test_it_is_put_where_the_camera_shall_see_it(self, room):
        room.at(10, "world", bearing_rad=0.2, distance_m=2.0)
        room.run(60)
        track = room.records[-1].decision.tracks[0]
        assert track.distance_m == pytest.approx(2.0, abs=0.05)
        assert track.bearing_rad == pytest.approx(0.2, abs=0.02)

    def test_what_cannot_be_done_is_refused_in_words(self, room):
        room.at(10, "world", fault="hide-tarket")
        room.at(11, "world", target="bull", x_m=1.0, y_m=0.0)
        room.at(12, "world", x_m=1.0)
        room.at(13, "world")
        misspelt, other, half, empty = (refused.error for refused in room.run(20))
        assert "did you mean 'hide-target'" in misspelt
        assert "there is no target 'bull'" in other
        assert "x_m and y_m" in half
        assert "x_m and y_m" in empty


def alarms_of(reply):
    return {alarm["rule"]: alarm for alarm in reply.data["alarms"]}


class TestAlarms:
    def test_an_alarm_says_since_when_it_stands_and_who_has_acknowledged_it(self, room):
        room.at(20, "alarms")
        room.at(30, "ack", rule="near", by="Zoë", why="on my way")
        room.at(120, "alarms")
        before, _, after = room.run()
        assert list(alarms_of(before)) == ["near"], "rules that are no alarms are not listed"
        raised = alarms_of(before)["near"]
        assert (raised["status"], raised["acknowledged"], raised["acknowledged_by"]) == ("active", False, "")
        near = alarms_of(after)["near"]
        assert (near["acknowledged_by"], near["why"], near["count"]) == ("Zoë", "on my way", 1)
        assert near["raised_unix_s"] < near["acknowledged_unix_s"] < near["cleared_unix_s"]
        kinds = [event["kind"] for event in after.data["events"] if event["source"] == "near"]
        assert sorted(kinds) == ["acknowledged", "cleared", "raised"]
