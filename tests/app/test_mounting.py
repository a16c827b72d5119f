"""The watch of a run over its camera: what it hands over, what it marks, and how it is confirmed; and the file."""

from __future__ import annotations

import math
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import pytest

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.mounting import (
    EVERY_S,
    PICTURES,
    judge_by,
    load_reference,
    make_reference,
    save_reference,
    watch_of,
)
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import MountingStatus
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.frame import Frame, Optics
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.errors import CalibrationError, StateError
from stadimeter.operator_actions import OperatorAction, OperatorCommand
from stadimeter.perception.mounting import MIN_ROTATION_RAD, MIN_ZOOM
from support.watched_room import FOCAL_PX, LENS, Pose, WatchedRoom

NOON = 720
CONFIGURATION = f"""
[camera]
driver = "images"
paths = "shots"
model = {{{{ width_px = 640, height_px = 480, fx_px = {FOCAL_PX} }}}}

[targets.tag]
detector = "tag"
side = "10 cm"
id = 1

[mounting]
when_moved = "{{when_moved}}"
"""
CONFIRM = OperatorCommand(id="7", action=OperatorAction.CONFIRM_MOUNTING, by="zoe")


@pytest.fixture(scope="module")
def pictures():
    """A dozen pictures of a camera where it was saved, and a dozen after it was turned by a degree."""
    room = WatchedRoom(seed=51)
    return {name: room.pictures(NOON, Pose(pan_deg=pan), count=12) for name, pan in (("saved", 0.0), ("turned", 1.0))}


def frames(images, from_s=0.0, optics=None):
    return [Frame(image, from_s + 0.2 * at, at, optics=optics) for at, image in enumerate(images)]


@pytest.fixture(scope="module")
def reference(pictures):
    return make_reference(frames(pictures["saved"]), LENS)


class Waiting:
    """In place of the thread: what it is to do waits until it is asked for."""

    def __init__(self) -> None:
        self.works = []

    def submit(self, work, *args):
        self.works.append((future := Future(), work, args))
        return future

    def attend(self) -> int:
        works, self.works = self.works, []
        for future, work, args in works:
            future.set_result(work(*args))
        return len(works)


class Rig:
    """A watch without a thread of its own, and a core: each picture is one cycle."""

    def __init__(self, folder: Path, reference, when_moved: str = "mark") -> None:
        self.configuration = folder / "run.toml"
        self.configuration.write_text(CONFIGURATION.format(when_moved=when_moved))
        save_reference(self.configuration, reference)
        self.watch, _ = watch_of(load_configuration(self.configuration))
        self.watch.close()
        self.watch._thread = self.thread = Waiting()
        self.state = initial_state(Plan(targets=(), rules=(), outputs=()))
        self.now_s = 0.0
        self.events = []

    def cycle(self, image=None, *commands):
        self.now_s += 0.2
        frame = None if image is None else Frame(image, self.now_s, round(5 * self.now_s))
        observation = Observation(
            now_s=self.now_s,
            frame=frame and FrameStamp(sequence=frame.sequence, captured_at_s=self.now_s),
            mounting=self.watch.mounting,
            operator_commands=commands,
        )
        self.state, decision = decide(self.state, observation)
        self.events += [each for each in decision.events if each.source == "mounting"]
        record = CycleRecord(observation=observation, applied=(), timings_s={}, decision=decision)
        self.watch(record, frame)
        return record

    def attend(self):
        """Do what was handed over to the thread, and let the loop see it."""
        waiting = self.thread.attend()
        self.cycle()
        return waiting

    def check(self, images):
        """Let a minute pass, with pictures, and a check."""
        self.now_s += EVERY_S
        for image in images:
            self.cycle(image)
        assert self.attend() == 1
        return self.cycle(images[0])


@pytest.mark.long
def test_a_camera_that_stays_is_as_saved(tmp_path, pictures, reference):
    rig = Rig(tmp_path, reference)
    assert rig.watch.mounting.status is MountingStatus.NOT_JUDGED, "before the first check nothing is known"
    rig.check(pictures["saved"])
    assert rig.watch.mounting.status is MountingStatus.AS_SAVED
    assert rig.events == []
    assert rig.watch.trouble() == ""


def test_a_turned_camera_marks_distances_until_a_person_confirms_it(tmp_path, pictures, reference):
    rig = Rig(tmp_path, reference)
    assert rig.check(pictures["turned"]).mark == ""
    assert rig.check(pictures["turned"]).mark == "unconfirmed"
    assert "turned by 1.0" in rig.watch.trouble()
    assert rig.check(pictures["saved"]).mark == "unconfirmed", "turned back by hand is not where it was"
    answers = rig.cycle(pictures["turned"][0], CONFIRM).decision.answers
    assert answers[0].accepted
    assert [each.kind.value for each in rig.events] == ["fault", "fault_cleared"]
    for image in pictures["turned"]:
        assert rig.cycle(image).mark == ""
    assert rig.attend() == 1
    assert load_reference(rig.configuration).saved_unix_s > reference.saved_unix_s, "the present view is kept"
    assert rig.check(pictures["turned"]).mark == ""
    assert rig.watch.mounting.status is MountingStatus.AS_SAVED


def test_a_confirmation_of_a_view_that_cannot_be_saved_leaves_it_unconfirmed(tmp_path, pictures, reference):
    rig = Rig(tmp_path, reference)
    rig.check(pictures["turned"])
    rig.check(pictures["turned"])
    white = np.full((480, 640, 3), 200, np.uint8)
    rig.cycle(white, CONFIRM)
    for _ in range(12):
        rig.cycle(white)
    rig.attend()
    assert "confirmed, but not saved" in rig.watch.mounting.reason
    assert load_reference(rig.configuration).saved_unix_s == reference.saved_unix_s


def test_what_was_found_before_a_confirmation_does_not_come_after_it(tmp_path, pictures, reference):
    rig = Rig(tmp_path, reference)
    rig.check(pictures["turned"])
    rig.check(pictures["turned"])
    rig.now_s += EVERY_S
    for image in pictures["turned"][:PICTURES]:
        rig.cycle(image)
    rig.cycle(pictures["turned"][0], CONFIRM)
    assert rig.attend() == 1
    assert not rig.watch.mounting.is_unconfirmed


def test_between_checks_nothing_is_handed_over_and_after_a_gap_it_is_at_once(tmp_path, pictures, reference):
    rig = Rig(tmp_path, reference)
    rig.check(pictures["saved"])
    for _ in range(50):
        rig.cycle(pictures["saved"][0])
    assert rig.attend() == 0
    for _ in range(15):
        rig.cycle(None)
    for image in pictures["saved"][:PICTURES]:
        rig.cycle(image)
    assert rig.attend() == 1


def test_outputs_stand_only_where_the_configuration_says_so(tmp_path, pictures, reference):
    for when_moved, stops in (("mark", False), ("stop", True)):
        rig = Rig(tmp_path, reference, when_moved)
        rig.check(pictures["turned"])
        rig.check(pictures["turned"])
        assert bool(rig.watch.why_not_for_motion()) is stops


def test_pictures_of_another_size_are_not_judged_and_the_reason_names_both(tmp_path, pictures, reference):
    rig = Rig(tmp_path, reference)
    rig.check([image[::2, ::2].copy() for image in pictures["saved"]])
    assert "640x480" in rig.watch.mounting.reason
    assert "320x240" in rig.watch.mounting.reason


def test_another_camera_and_another_camera_file_are_refused_in_words(pictures, reference):
    wide, tele = (
        Optics(sensor=name, sensor_size_px=(1640, 1232), crop_px=(0, 0, 3280, 2464)) for name in ("imx219", "imx708")
    )
    saved = msgspec.structs.replace(reference, sensor="imx219")
    (frame,) = frames(pictures["saved"][:1], optics=tele)
    assert "imx219" in saved.why_not_for(frame, LENS)
    assert "imx708" in saved.why_not_for(frame, LENS)
    (frame,) = frames(pictures["saved"][:1], optics=wide)
    assert saved.why_not_for(frame, LENS) == ""
    other = CameraModel.with_focal_length(600.0, 640, 480)
    assert "another camera file" in saved.why_not_for(frame, other)


def test_limits_follow_what_the_configuration_states(tmp_path, reference):
    configuration = Rig(tmp_path, reference).configuration
    judge = judge_by(reference, load_configuration(configuration), LENS)
    assert (judge.rotation_rad, judge.zoom) == (MIN_ROTATION_RAD, MIN_ZOOM)
    text = configuration.read_text().replace(
        'paths = "shots"', 'paths = "shots"\nheight = "1 m"\ntilt = "5 deg ± 1 deg"'
    )
    configuration.write_text(text)
    rough = msgspec.structs.replace(LENS, focal_relative_sigma=0.02)
    judge = judge_by(reference, load_configuration(configuration), rough)
    assert (judge.rotation_rad, judge.zoom) == (pytest.approx(math.radians(1)), 0.02)


def test_a_damaged_file_is_refused_with_its_path_and_the_remedy(tmp_path, reference):
    path = save_reference(tmp_path / "run.toml", reference)
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], b"\xc1" + whole, whole.replace(b"views", b"vuews")):
        path.write_bytes(damaged)
        with pytest.raises(StateError, match=r"run\.mounting: .*stadimeter site save"):
            load_reference(tmp_path / "run.toml")
    for at in range(len(whole) - sum(len(view.data) for view in reference.views)):
        with suppress(StateError):
            path.write_bytes(whole[:at] + b"\xff" + whole[at + 1 :])
            load_reference(tmp_path / "run.toml")
    view = msgspec.structs.replace(reference.views[0], blur_slope=math.nan)
    save_reference(tmp_path / "run.toml", msgspec.structs.replace(reference, views=[view]))
    with pytest.raises(StateError, match="damaged"):
        load_reference(tmp_path / "run.toml")


def test_a_view_of_a_camera_on_a_robot_is_not_watched_and_that_is_said(tmp_path, reference, monkeypatch):
    rig = Rig(tmp_path, reference)
    loaded = load_configuration(rig.configuration)
    monkeypatch.setattr(type(loaded), "base", object())
    watch, why = watch_of(loaded)
    assert watch is None
    assert "sees another background all the time" in why


def test_a_view_that_does_not_fit_the_camera_file_is_refused_when_it_is_saved(pictures):
    with pytest.raises(CalibrationError, match="another aspect"):
        make_reference(frames([image[:300] for image in pictures["saved"]]), LENS)


def test_where_the_folder_of_the_configuration_cannot_be_written_it_goes_to_the_state_of_the_service(
    tmp_path, reference, monkeypatch
):
    state = tmp_path / "state"
    state.mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", str(state))
    configuration = tmp_path / "missing" / "run.toml"
    assert save_reference(configuration, reference) == state / "run.mounting"
    assert load_reference(configuration).saved_unix_s == reference.saved_unix_s
