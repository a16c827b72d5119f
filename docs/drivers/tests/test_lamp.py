import math

import numpy as np
import pytest

from my_package.lamp import LampDetector, LampOptions
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.testing.detector_contract import DetectorContract, DetectorRig, KnownTarget

CAMERA = CameraModel.with_focal_length(600, 640, 480)


def lamp_at(x_m, y_m, depth_m):
    """Return a lamp of 10 cm that faces the camera."""
    return KnownTarget(
        distance_m=math.hypot(x_m, y_m, depth_m),
        centre_px=(CAMERA.cx_px + 600 * x_m / depth_m, CAMERA.cy_px + 600 * y_m / depth_m),
        size_px=600 * 0.10 / depth_m,
    )


def drawn(*lamps):
    """Return a frame with lamps in it."""
    rows, columns = np.indices((480, 640))
    image = np.zeros((480, 640, 3), np.uint8)
    for lamp in lamps:
        off_px = np.hypot(columns - lamp.centre_px[0], rows - lamp.centre_px[1]) - lamp.size_px / 2
        image[off_px < 0] = 255
    return Frame(image, 0.0, 0)


class TestLamp(DetectorContract):
    @pytest.fixture
    def make_rig(self):
        near, far = lamp_at(-0.2, 0.1, 1.0), lamp_at(0.4, -0.1, 1.5)
        return lambda: DetectorRig(
            detector=LampDetector(LampOptions(diameter="10 cm"), "it"),
            camera=CAMERA,
            whole=drawn(near),
            target=near,
            empty=drawn(),
            cut_off=drawn(lamp_at(-0.52, 0.1, 1.0)),
            two=drawn(near, far),
            both=(near, far),
        )
