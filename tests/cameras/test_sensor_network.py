"""A network on the sensor of an AI camera: its boxes come with the frames, and the object detector measures by them."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stadimeter.cameras.picamera2_camera import Picamera2Camera, Picamera2Options
from stadimeter.config.plugins import DriverContext
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, SensorBoxes
from stadimeter.detectors.object import ObjectOptions
from stadimeter.errors import DeviceOpenError, LinkLostError
from stadimeter.ranging.measure import measure
from stadimeter.testing.rig import ManualClock
from support.picamera2_double import Sensor

LENS = CameraModel.with_focal_length(600.0, 640, 480)
PERSON_YX = (0.25, 0.5, 0.75, 0.6)
"""Top, left, bottom and right, as shares of the whole sensor."""


class Imx500:
    """What is used of ``picamera2.devices.IMX500``: the network's outputs for a frame, and what its file says of it."""

    files: list[str] = []  # noqa: RUF012
    outputs: Any = None
    network_intrinsics: Any = None

    def __init__(self, network_file: str) -> None:
        if not Path(network_file).is_file():
            raise RuntimeError(f"Firmware file {network_file} does not exist.")
        self.files.append(network_file)

    def get_outputs(self, metadata: dict[str, Any], add_batch: bool = False) -> Any:
        assert "ScalerCrop" in metadata
        return self.outputs

    def get_input_size(self) -> tuple[int, int]:
        return 320, 320


def outputs(*boxes: tuple[float, ...], scores: tuple[float, ...] = (0.9,), classes: tuple[float, ...] = (0,)) -> Any:
    return [np.array(boxes, np.float32).reshape(-1, 4), np.array(scores), np.array(classes), np.array([len(boxes)])]


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock(1000.0)


@pytest.fixture
def imx500(monkeypatch: pytest.MonkeyPatch) -> type[Imx500]:
    kind = type("Imx500OfTest", (Imx500,), {"files": [], "network_intrinsics": SimpleNamespace(
        bbox_normalization=False, bbox_order="yx", labels=["person", "bicycle"]
    )})  # fmt: skip
    for name in ("picamera2", "picamera2.devices"):
        module = ModuleType(name)
        module.IMX500 = kind  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, name, module)
    return kind


@pytest.fixture
def camera(clock: ManualClock, imx500: type[Imx500], tmp_path: Path) -> Any:
    network = tmp_path / "ssd_pp.rpk"
    network.write_bytes(b"network")
    sensor = Sensor(clock, keeps={"ScalerCrop": (0, 0, 4056, 3040)})
    table = {"width_px": 640, "height_px": 480, "network": str(network)}

    def make(**options: Any) -> Picamera2Camera:
        return Picamera2Camera(
            Picamera2Options.model_validate({**table, **options}), clock, sensor.package, monotonic=clock.now_s
        )

    return make


def test_boxes_of_the_network_come_with_the_frame_in_its_pixels(camera: Any, imx500: type[Imx500]) -> None:
    imx500.outputs = outputs(PERSON_YX, (0.1, 0.1, 0.2, 0.2), scores=(0.8, 0.6), classes=(0, 7))
    made = camera()
    made.open()
    boxes = made.read().boxes
    assert len(imx500.files) == 1, "the network is put on the sensor once for each time that the camera is opened"
    # The whole sensor is the picture: half of 640 px, less the half pixel by which the first one is centred.
    assert boxes.corners_px[0] == pytest.approx((319.5, 119.5, 383.5, 359.5), abs=1e-3)
    assert boxes.scores.tolist() == [0.8, 0.6]
    assert boxes.classes == ("person", "7")
    made.close()


def test_a_crop_of_the_sensor_moves_and_enlarges_the_boxes(
    camera: Any, imx500: type[Imx500], clock: ManualClock
) -> None:
    imx500.outputs = outputs(PERSON_YX)
    made = camera(crop_px=[1014, 760, 2028, 1520])
    made._load = Sensor(clock, keeps={"ScalerCrop": (1014, 760, 2028, 1520)}).package
    made.open()
    assert made.read().boxes.corners_px[0] == pytest.approx((319.5, -0.5, 447.5, 479.5), abs=1e-3)
    made.close()


@pytest.mark.parametrize(("order", "is_normalised"), [("xy", False), ("yx", True), ("xy", True)])
def test_the_order_and_scale_that_the_network_s_file_states_are_used(
    camera: Any, imx500: type[Imx500], order: str, is_normalised: bool
) -> None:
    top, left, bottom, right = PERSON_YX
    box = PERSON_YX if order == "yx" else (left, top, right, bottom)
    imx500.outputs = outputs(tuple(each * (320 if is_normalised else 1) for each in box))
    imx500.network_intrinsics.bbox_order = order
    imx500.network_intrinsics.bbox_normalization = is_normalised
    made = camera()
    made.open()
    assert made.read().boxes.corners_px[0] == pytest.approx((319.5, 119.5, 383.5, 359.5), abs=1e-3)
    made.close()


def test_a_frame_with_which_the_network_has_not_ended_has_no_boxes(camera: Any, imx500: type[Imx500]) -> None:
    imx500.outputs = None
    made = camera()
    made.open()
    assert made.read().boxes is None
    made.close()


def test_a_network_that_gives_no_boxes_is_said(camera: Any, imx500: type[Imx500]) -> None:
    imx500.outputs = [np.zeros(1000)]
    made = camera()
    made.open()
    with pytest.raises(LinkLostError, match="no boxes, scores and classes; name another"):
        made.read()
    made.close()


def test_a_network_that_is_not_there_and_a_turned_picture_are_refused(camera: Any) -> None:
    with pytest.raises(DeviceOpenError, match=r"the network /none\.rpk cannot be used: Firmware file"):
        camera(network="/none.rpk").open()
    with pytest.raises(DeviceOpenError, match="leave out upside_down or network"):
        camera(upside_down=True).open()


def person(seconds: float, boxes: SensorBoxes | None) -> Frame:
    image = np.random.default_rng(4).integers(0, 255, (480, 640, 3), np.uint8)
    return Frame(image, seconds, round(10 * seconds), boxes=boxes)


def found(*boxes: tuple[float, float, float, float], classes: tuple[str, ...] = ("person",)) -> SensorBoxes:
    return SensorBoxes(np.array(boxes, float).reshape(-1, 4), np.full(len(boxes), 0.9), classes)


def detector(**options: Any) -> Any:
    made = ObjectOptions.model_validate({"height": "1.72 m ± 7 cm", **options})
    return made.build(DriverContext(name="who", clock=ManualClock()))


def test_a_target_without_a_model_is_measured_by_the_boxes_of_the_camera() -> None:
    box = (300.0, 100.0, 380.0, 300.0)
    seen: Detection = detector().detect(person(0.0, found(box, (10.0, 10.0, 90.0, 90.0), classes=("person", "dog"))))
    assert seen.status is DetectionStatus.FOUND
    assert seen.outline_px[0].tolist() == [300.0, 100.0]
    measured = measure(seen, detector().target_shape, LENS, 0.0)
    assert measured.depth_m == pytest.approx(1.72 * 600 / 200, rel=1e-6)


def test_another_class_is_looked_for_by_its_name() -> None:
    box = (300.0, 100.0, 380.0, 300.0)
    assert detector(**{"class": "dog"}).detect(person(0.0, found(box))).reason == "no dog"
    assert detector(**{"class": "7"}).detect(person(0.0, found(box, classes=("7",)))).status is DetectionStatus.FOUND


def test_between_two_results_the_box_is_followed_and_without_any_the_reason_is_said() -> None:
    box = (300.0, 100.0, 380.0, 300.0)
    looks = detector()
    none = looks.detect(person(0.0, None))
    assert none.status is DetectionStatus.NOT_FOUND
    assert "set network in [camera]" in none.reason
    assert looks.detect(person(0.1, found(box))).status is DetectionStatus.FOUND
    followed = looks.detect(person(0.3, None))
    assert followed.status is DetectionStatus.FOUND
    assert followed.outline_px[0] == pytest.approx((300.0, 100.0), abs=0.5)


def test_eyes_are_not_found_by_a_network_on_the_sensor() -> None:
    with pytest.raises(ValueError, match="a network on the sensor finds no eyes"):
        ObjectOptions.model_validate({"eye_distance": "63 mm ± 3 mm"})
