"""The camera contract catches mistakes: each wrong camera fails the test that is named beside it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError
from stadimeter.testing.camera_contract import CameraContract, CameraRig
from stadimeter.testing.rig import ManualClock
from support.cameras import NodeDevice, NodeHandle
from support.each_case import each_case


class NodeCamera:
    """A right camera over a device that counts its handles, until a subclass is wrong."""

    is_live = True
    remarks: tuple[str, ...] = ()
    not_for_motion = ""

    def __init__(self, device: NodeDevice, clock: ManualClock) -> None:
        self.device, self.clock = device, clock
        self.handle: NodeHandle | None = None
        self.number = 0

    def open(self) -> None:
        self.close()
        self.handle = self.device()

    def read(self) -> Frame:
        if self.handle is None:
            raise DeviceClosedError("not open")
        self.clock.advance_s(0.1)
        frame = Frame(self.image(self.handle), self.captured_at_s(), self.number)
        self.number += 1
        return frame

    def image(self, handle: NodeHandle) -> Any:
        try:
            return handle.retrieve()[1]
        except cv2.error as error:
            raise CaptureTimeoutError("no picture came") from error

    def captured_at_s(self) -> float:
        return self.clock.now_s()

    def close(self) -> None:
        if self.handle is not None:
            self.handle.release()
            self.handle = None


class LetsVendorErrorsOut(NodeCamera):
    def image(self, handle: NodeHandle) -> Any:
        return handle.retrieve()[1]


class GoesOnWithTheLastPicture(NodeCamera):
    last: Any = None

    def image(self, handle: NodeHandle) -> Any:
        try:
            self.last = super().image(handle)
        except CaptureTimeoutError:
            return self.last
        return self.last


class LeaksTheFirstHandle(NodeCamera):
    def open(self) -> None:
        self.handle = self.device()


class KeepsTheDevice(NodeCamera):
    def close(self) -> None:
        self.handle = None


class ReadsAfterClose(NodeCamera):
    def close(self) -> None:
        if self.handle is not None:
            self.handle.release()


class UsesFourBuffersInTurn(NodeCamera):
    def __init__(self, device: NodeDevice, clock: ManualClock) -> None:
        super().__init__(device, clock)
        self.buffers = [np.zeros((48, 64, 3), np.uint8) for _ in range(4)]

    def image(self, handle: NodeHandle) -> Any:
        buffer = self.buffers[self.number % 4]
        buffer[:] = super().image(handle)
        return buffer


class StampsGoBackAtTimes(NodeCamera):
    def captured_at_s(self) -> float:
        return self.clock.now_s() - (0.5 if self.number == 7 else 0.0)


class StampsBeginAnew(NodeCamera):
    def open(self) -> None:
        super().open()
        self.opened_at_s = self.clock.now_s()

    def captured_at_s(self) -> float:
        return 90.0 + self.clock.now_s() - self.opened_at_s


class NumbersBeginAnew(NodeCamera):
    def open(self) -> None:
        super().open()
        self.number = 0


MISTAKES: dict[type[NodeCamera], str] = {
    LetsVendorErrorsOut: "test_a_lost_device_ends_reading_with_an_error_of_ours",
    GoesOnWithTheLastPicture: "test_a_lost_device_ends_reading_with_an_error_of_ours",
    LeaksTheFirstHandle: "test_opening_an_open_camera_takes_the_device_once",
    KeepsTheDevice: "test_the_device_is_taken_by_open_and_let_go_by_close",
    ReadsAfterClose: "test_reading_after_closing_raises",
    UsesFourBuffersInTurn: "test_a_frames_image_is_not_changed_by_later_reads",
    StampsGoBackAtTimes: "test_capture_times_never_go_back_nor_ahead_of_the_clock",
    StampsBeginAnew: "test_a_closed_camera_opens_again_and_time_and_numbers_go_on",
    NumbersBeginAnew: "test_a_closed_camera_opens_again_and_time_and_numbers_go_on",
}


def rig_of(kind: type[NodeCamera]) -> CameraRig:
    device, clock = NodeDevice(), ManualClock(100.0)
    return CameraRig(camera=kind(device, clock), clock=clock, held=lambda: len(device.handles), lose=device.fail)


@each_case("wrong", MISTAKES)
def test_a_wrong_camera_fails_the_test_for_its_mistake(wrong: type[NodeCamera]) -> None:
    with pytest.raises((AssertionError, pytest.fail.Exception)):
        getattr(CameraContract(), MISTAKES[wrong])(rig_of(wrong))


@each_case("test", sorted(set(MISTAKES.values())))
def test_a_right_camera_passes_the_same_tests(test: str) -> None:
    getattr(CameraContract(), test)(rig_of(NodeCamera))
