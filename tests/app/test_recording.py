"""Recordings: what is in the MCAP file, and what is left of one that was cut off."""

import json
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from msgspec.structs import replace

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.recordings import recording as recording_module
from stadimeter.app.recordings.journal import FILE_NAME, RecordedConfiguration
from stadimeter.app.recordings.recording import ImageOptions, Recorded, RecordingWriter
from stadimeter.app.recordings.recording_messages import SCHEMAS
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.detection import RejectedCandidate
from stadimeter.core.frame import Frame
from stadimeter.core.plan import LevelOutput, Plan
from stadimeter.core.rule import AlarmRule
from stadimeter.errors import JournalError
from stadimeter.ranging.ball import BallShape
from stadimeter.workbench.replay import read_mcap, read_recording
from support.each_case import each_case
from support.observing import Rehearsal
from support.recordings import records_of

PLAN = Plan(
    targets=("ball",),
    rules=(AlarmRule(name="near", target="ball", output="buzzer", condition=DistanceCondition(below=1.0)),),
    outputs=(LevelOutput(name="buzzer"),),
)
LENS = CameraModel.with_focal_length(60.0, 64, 48)
RECORDED = Recorded(
    configuration=RecordedConfiguration(text="# configuration", files={"camera.toml": "# lens"}),
    camera=LENS,
    sizes={"ball": BallShape(diameter_m=0.2)},
)


class Recording(Rehearsal):
    """A rehearsal that records each cycle with a picture of its own."""

    def __init__(self, path, options=None, recorded=RECORDED):
        super().__init__(PLAN)
        self.writer = RecordingWriter(path, recorded, options)
        self.rejected = {}

    def cycle(self, observation):
        decision = super().cycle(observation)
        record = CycleRecord(
            observation=observation, decision=decision, applied=(), timings_s={"decide": 1e-4}, rejected=self.rejected
        )
        stamp = observation.frame
        self.writer.write(
            record, Frame(picture(stamp.sequence), stamp.captured_at_s, stamp.sequence) if stamp else None
        )
        return decision


def picture(number):
    return np.full((48, 64, 3), 10 + number % 200, np.uint8)


def recorded(path, *sights, options=None):
    recording = Recording(path, options)
    recording.see(*sights)
    recording.wait(0.5)
    recording.writer.close()
    return recording


def messages(path, topic):
    with path.open("rb") as file:
        return [
            (message.log_time, json.loads(message.data))
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(topics=[topic])
        ]


def test_what_is_read_is_what_was_written_to_the_last_bit(tmp_path):
    recording = recorded(tmp_path / "run.mcap", 5, 4, None, 0.1 + 0.2, 1 / 3, float("nan"))
    read = read_mcap(tmp_path / "run.mcap")
    decided = [(now_s, replace(decision, reasons={})) for now_s, decision in recording.decisions]  # they follow from it
    assert repr([(r.observation.now_s, r.decision) for r in records_of(read)]) == repr(decided)
    assert read.header.configuration == "# configuration"
    assert read.header.files == {"camera.toml": "# lens"}
    assert not read.is_cut_off()


def test_every_picture_comes_back_with_its_cycle(tmp_path):
    recorded(tmp_path / "run.mcap", 5, 4, 3)
    pairs = list(read_mcap(tmp_path / "run.mcap").cycles_and_images())
    frames = [image.frame_of(cycle) for cycle, image in pairs if image is not None]
    assert [frame.sequence for frame in frames] == [0, 1, 2]
    assert [int(frame.image.mean()) for frame in frames] == [10, 11, 12]
    assert [frame.captured_at_s for frame in frames] == [0.1, 0.2, 0.3]
    assert [image is None for _, image in pairs] == [False] * 3 + [True] * 5


def test_every_message_is_json_of_the_shape_that_its_schema_says(tmp_path):
    recording = Recording(tmp_path / "run.mcap")
    looked_at = RejectedCandidate(centre_px=(1.0, 2.0), size_px=3.0, reason="support 0.31, limit 0.60")
    recording.rejected = {"ball": (looked_at,)}
    recording.see(5, 0.8, 0.8, 0.8, float("nan"), None)
    recording.writer.close()
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        names = set()
        for schema, channel, message in reader.iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            found = json.loads(message.data, parse_constant=no_constant)
            if schema.name != "stadimeter.Cycle":  # of which the schema names parts only
                check(found, json.loads(schema.data))
            names.add((channel.topic, schema.name))
    assert names == {
        ("/cycle", "stadimeter.Cycle"),
        ("/camera/image", "foxglove.CompressedImage"),
        ("/camera/calibration", "foxglove.CameraCalibration"),
        ("/camera/annotations", "foxglove.ImageAnnotations"),
        ("/targets/ball", "stadimeter.Target"),
        ("/log", "foxglove.Log"),
    }


def no_constant(name):
    raise AssertionError(f"{name} is no JSON")


def check(value, schema):
    """Check a message; of JSON Schema there is nothing in our schemas but types, properties and items."""
    if value is None or (value == "NaN" and schema["type"] == "number"):
        return
    types = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float), "boolean": bool}
    assert isinstance(value, types[schema["type"]]), (value, schema)
    if isinstance(value, dict) and schema["properties"]:
        assert set(value) <= set(schema["properties"])
        for name, part in value.items():
            check(part, schema["properties"][name])
    if isinstance(value, list):
        assert schema.get("minItems", 0) <= len(value)
        for part in value:
            check(part, schema["items"])


@each_case("schema", SCHEMAS.values(), ids=SCHEMAS)
def test_schemas_are_as_plain_as_every_viewer_takes_them(schema):
    def look(part):
        assert part["type"] in {"object", "array", "string", "integer", "number", "boolean"}
        assert not {"$ref", "anyOf", "oneOf", "allOf", "$defs"} & set(part)
        if part["type"] == "object":
            for each in part["properties"].values():
                look(each)
        if part["type"] == "array":
            assert part["items"]["type"] != "array"
            look(part["items"])

    assert schema["type"] == "object"
    look(schema)


def test_a_target_is_marked_where_it_was_found(tmp_path):
    recorded(tmp_path / "run.mcap", 2.0)
    ((_, found),) = messages(tmp_path / "run.mcap", "/camera/annotations")
    (circle,), (text,) = found["circles"], found["texts"]
    assert circle["position"] == {"x": 32.0, "y": 24.0}
    assert circle["diameter"] == 6.0
    assert text["text"] == "ball 2.00 m"


def test_times_are_on_one_anchor_however_the_wall_clock_is_set_meanwhile(tmp_path, monkeypatch):
    recording = Recording(tmp_path / "run.mcap")
    recording.see(5)
    monkeypatch.setattr(recording_module.time, "time_ns", lambda: 0)
    recording.see(4, 3)
    recording.writer.close()
    times_ns = [time_ns for time_ns, _ in messages(tmp_path / "run.mcap", "/cycle")]
    steps_s = [(after - before) / 1e9 for before, after in pairwise(times_ns)]
    assert steps_s == pytest.approx([0.1, 0.1], abs=1e-6)
    assert times_ns[0] > 1e18


def test_pictures_of_events_are_those_in_which_something_changed(tmp_path):
    recorded(tmp_path / "run.mcap", *[5] * 10, *[0.5] * 10, options=ImageOptions(images="events"))
    pairs = read_mcap(tmp_path / "run.mcap").cycles_and_images()
    taken = [image.sequence for _, image in pairs if image is not None]
    assert 2 <= len(taken) < 12
    assert taken[0] == 0
    assert any(sequence >= 10 for sequence in taken)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the bytes of a recording, which is made once for all that is damaged."""
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    recorded(path, *[5] * 30)
    return path.read_bytes()


@settings(max_examples=40)
@given(share=st.floats(0, 1))
def test_a_recording_cut_anywhere_is_read_as_far_as_it_is_whole_or_refused(tmp_path_factory, whole, share):
    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    path.write_bytes(whole[: int(share * (len(whole) - 1))])
    with refusing(path):
        read = read_recording(path)
        assert len(list(records_of(read))) <= 35
        assert read.is_cut_off()


def test_a_recording_cut_before_its_configuration_is_not_blamed_on_that(tmp_path, whole):
    path = tmp_path / "run.mcap"
    path.write_bytes(whole[: whole.index(FILE_NAME.encode())])
    with pytest.raises(JournalError, match="the recording ends before its first cycle"):
        read_recording(path)


@contextmanager
def refusing(path):
    """Let what is wrong with a recording be told in no other way than by one error that names it."""
    error = None
    try:
        yield
    except JournalError as raised:
        error = raised
    assert error is None or str(path) in str(error)


@pytest.mark.parametrize("length", [3, 25])
def test_a_recording_that_a_cut_ended_in_its_beginning_keeps_no_run_from_recording(tmp_path, length):
    path = tmp_path / "run.mcap"
    recorded(path, 5)
    left = path.read_bytes()[:length]
    path.write_bytes(left)
    recorded(path, 5, 4)
    assert len(list(records_of(read_mcap(path)))) > 2
    assert (tmp_path / "run-1.mcap").read_bytes() == left


def test_a_recording_that_was_not_finished_loses_no_more_than_its_last_second(tmp_path):
    recording = Recording(tmp_path / "run.mcap")
    recording.see(*[5] * 45)
    recording.writer.abandon()
    read = read_mcap(tmp_path / "run.mcap")
    assert read.is_cut_off()
    assert 35 <= len(list(records_of(read))) <= 45


def test_an_mcap_file_of_another_program_is_not_read_and_not_overwritten(tmp_path):
    path = tmp_path / "robot.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="robot 1.0")
        writer.finish()
    before = path.read_bytes()
    with pytest.raises(JournalError, match=r"written by robot 1\.0, and not by `stadimeter run --record`"):
        read_recording(path)
    recorded(path, 5)
    assert path.with_name("robot-1.mcap").read_bytes() == before
    path.write_text("a diary\n")
    with pytest.raises(JournalError, match="holds something else than a recording; choose another file"):
        RecordingWriter(path, RECORDED)


def test_what_a_file_is_its_content_tells_and_not_its_name(tmp_path):
    recorded(tmp_path / "run.jsonl", 5)
    assert len(list(records_of(read_recording(tmp_path / "run.jsonl")))) == 6
    (tmp_path / "text.mcap").write_text("hello\n")
    with pytest.raises(JournalError, match="not a journal"):
        read_recording(tmp_path / "text.mcap")
    (tmp_path / "empty.mcap").touch()
    with pytest.raises(JournalError, match="empty"):
        read_recording(tmp_path / "empty.mcap")


def test_what_the_run_took_over_from_an_earlier_one_is_in_the_recording(tmp_path):
    recording = Recording(tmp_path / "run.mcap")
    recording.writer.note_resumption('{"alarms": []}')
    recording.see(5)
    recording.writer.close()
    assert read_mcap(tmp_path / "run.mcap").header.resumed == '{"alarms": []}'


def test_another_configuration_that_was_taken_over_stands_before_its_first_cycle(tmp_path):
    recording = Recording(tmp_path / "run.mcap")
    recording.see(5, 4)
    recording.writer.note_reload(recording.now_s, RecordedConfiguration(text="# another"))
    recording.see(3)
    recording.writer.close()
    reloaded = [cycle.reloaded for cycle in read_mcap(tmp_path / "run.mcap").cycles()]
    assert reloaded == [None, None, RecordedConfiguration(text="# another")]


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity"])
def test_what_is_no_number_is_written_as_text_and_read_as_it_was(tmp_path, text):
    recorded(tmp_path / "run.mcap", 5, float(text))
    *_, (_, last) = messages(tmp_path / "run.mcap", "/cycle")[:2]
    assert last["observation"]["measurements"][0]["distance_m"] == text
    read = list(records_of(read_mcap(tmp_path / "run.mcap")))[1].observation.measurements[0].distance_m
    assert repr(read) == repr(float(text))
