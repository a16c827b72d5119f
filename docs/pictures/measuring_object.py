"""The picture of an object in docs/how-it-measures.md: boxes of a network, the best one, and how it is followed.

The network is one whose weights are written down (`support.networks`); it finds what is bright, as a trained one finds
people.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
from gallery import CAMERA, JPEG_QUALITY
from how_it_measures import GREEN, PANEL_PX, YELLOW

from stadimeter.config.plugins import DriverContext
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.object import ObjectOptions
from stadimeter.detectors.object.detector import BoxPattern, take_pattern
from stadimeter.detectors.object.families import WantedClass, fit_picture, recognise
from stadimeter.detectors.object.model_file import load_model
from stadimeter.detectors.object.network import OpenCvEngine, to_blob
from stadimeter.ranging.measure import measure
from stadimeter.testing.rig import ManualClock
from support.networks import bright_figure, write_network
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene


def make_object_picture(folder: Path) -> None:
    """Write the picture."""
    with tempfile.TemporaryDirectory() as made:
        known = recognise(load_model(write_network(Path(made) / "net.onnx", "yolox")), "yolox")
        first, later = _picture(0.30, 4.0), _picture(0.34, 3.7)
        width, height = known.input_for(first.shape[1], first.shape[0], None)
        fitted = fit_picture(first, width, height, known.family.fill)
        outputs = OpenCvEngine(known.file).run(to_blob(fitted.image, known.family))
        boxes = fitted.in_picture(known.family.decode(outputs, WantedClass(0, 0.5, width, height)))
        options = ObjectOptions.model_validate({"model": str(known.file.path), "height": "1.72 m ± 7 cm"})
        detector = options.build(DriverContext(name="person", clock=ManualClock()))
        lens = CAMERA.scaled_to(first.shape[1], first.shape[0])
        found = [detector.detect(Frame(image, t, 0), lens=lens) for image, t in ((first, 0.0), (later, 0.3))]
        measured = measure(found[1], detector.target_shape, lens, 0.3)
        pattern = take_pattern(first, boxes.corners[0])
    panels = [first.copy(), first.copy(), later.copy()]
    for left, top, right, bottom in boxes.corners:
        cv2.rectangle(panels[0], (round(left), round(top)), (round(right), round(bottom)), YELLOW, 2, cv2.LINE_AA)
    for panel, seen in zip(panels[1:], found, strict=True):
        cv2.polylines(panel, [seen.outline_px.round().astype(np.int32)], True, GREEN, 3, cv2.LINE_AA)
    if isinstance(pattern, BoxPattern):
        centre = (boxes.corners[0, :2] + boxes.corners[0, 2:]) / 2
        for x, y in pattern.around_px + centre:
            cv2.circle(panels[1], (round(x), round(y)), 5, YELLOW, -1, cv2.LINE_AA)
    text = f"{measured.distance_m:.2f} m +- {measured.sigma_m:.2f}"
    cv2.rectangle(panels[2], (0, later.shape[0] - 60), (430, later.shape[0]), (255, 255, 255), -1)
    place = (12, later.shape[0] - 18)
    cv2.putText(panels[2], text, place, cv2.FONT_HERSHEY_SIMPLEX, 1.2, (30, 30, 30), 2, cv2.LINE_AA)
    row = np.hstack([cv2.resize(panel, PANEL_PX, interpolation=cv2.INTER_AREA) for panel in panels])
    cv2.imwrite(str(folder / "measuring-object.jpg"), row, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])


def _picture(x_share: float, depth_m: float) -> Image:
    """Return a dim room with a person of 1.72 m in bright clothes."""
    room = render(Scene(camera=CAMERA, target=None, seed=12, backdrop=RoomBackdrop(things=8))).image
    image = (room * 0.45).astype(np.uint8)
    height = round(1.72 * CAMERA.fy_px / depth_m)
    width = round(0.3 * height)
    shape = np.zeros((height, width), np.uint8)
    middle, head = width // 2, round(0.07 * height)
    cv2.circle(shape, (middle, head), head, 1, -1, cv2.LINE_AA)
    cv2.rectangle(shape, (0, round(0.17 * height)), (width, round(0.55 * height)), 1, -1)
    for leg in (0.32, 0.68):
        thick = max(2, round(0.3 * width))
        cv2.line(shape, (round(leg * width), height // 2), (round(leg * width), height), 1, thick)
    figure = bright_figure(height, width, 4)
    left, top = round(x_share * image.shape[1] - width / 2), (image.shape[0] - height) // 2
    image[top : top + height, left : left + width][shape > 0] = figure[shape > 0]
    return image


if __name__ == "__main__":
    make_object_picture(Path(__file__).parent)
