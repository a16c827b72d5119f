"""A whole run with a live camera on the computer's clock: any camera, a detector that always sees a ball, a motor."""

import threading
from dataclasses import dataclass, field

import numpy as np

from stadimeter.app.bootstrap import Parts
from stadimeter.app.capture import LiveCapture
from stadimeter.app.clock import MonotonicClock
from stadimeter.app.cycle import Cycle
from stadimeter.app.guard import LeasedOutput
from stadimeter.app.loop import Loop
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.command import LevelCommand
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.errors import CaptureTimeoutError, DeviceClosedError
from stadimeter.ranging.ball import BallShape
from support.recording_doubles import RecordingActuator
from support.simulated_run import SIMULATED_BALL


@dataclass
class LiveDouble:
    """A live camera that delivers a new picture every 5 ms, until it is told to block."""

    clock: MonotonicClock
    is_live: bool = True
    remarks: tuple = ()
    not_for_motion: str = ""
    blocked: threading.Event = field(default_factory=threading.Event)
    closed: threading.Event = field(default_factory=threading.Event)
    count: int = 0

    def open(self):
        self.closed.clear()

    def read(self):
        if self.closed.wait(0.005):
            raise DeviceClosedError("closed")
        if self.blocked.is_set():
            self.closed.wait(120)
            raise CaptureTimeoutError("nothing came")
        self.count += 1
        image = np.full((48, 64, 3), self.count % 250, np.uint8)
        image[0, 0] = (*divmod(self.count // 250, 250), 0)  # no two pictures are the same
        return Frame(image=image, captured_at_s=self.clock.now_s(), sequence=self.count)

    def close(self):
        self.closed.set()


class Detector:
    """Always sees a ball at 2 m."""

    target_shape = BallShape(diameter_m=0.2)

    def detect(self, frame, prediction=None, *, lens=None):
        found = DetectionStatus.FOUND
        return Detection(
            target="ball",
            status=found,
            centre_px=(31.5, 23.5),
            width_px=6.0,
            height_px=6.0,
            size_sigma_px=0.05,
            outline_px=31.5 + 3 * np.stack((np.cos(np.arange(60)), np.sin(np.arange(60))), axis=1) - (0, 8),
        )


class Rig:
    def __init__(self, tmp_path, make_camera=LiveDouble):
        path = tmp_path / "run.toml"
        path.write_text(
            SIMULATED_BALL + '[rules.far]\nactuator = "motor"\nramp = { from = "1 m", to = "1.5 m" }\n[world]\n'
        )
        self.clock = MonotonicClock()
        self.camera = make_camera(self.clock)
        self.motor = RecordingActuator(self.clock, "motor")
        capture = LiveCapture(self.camera, self.clock)
        outputs = (LeasedOutput(self.motor, LevelCommand(output="motor", level=0.0), 0.3, self.clock),)
        cycle = Cycle(
            clock=self.clock,
            capture=capture,
            camera_model=CameraModel.with_focal_length(60, 64, 48),
            detectors={"ball": Detector()},
            outputs=outputs,
            max_frame_age_s=0.2,
        )
        self.loop = Loop(
            Parts(
                configuration=load_configuration(path),
                clock=self.clock,
                capture=capture,
                outputs=outputs,
                messenger=None,
                cycle=cycle,
                is_live=True,
            )
        )
