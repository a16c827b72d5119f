"""The speed of this computer, measured in a process of its own: where a library is broken, only that one ends."""

from __future__ import annotations

from statistics import median
from time import perf_counter

import numpy as np

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import DETECTORS, DriverContext, load_driver
from stadimeter.core.frame import Frame
from stadimeter.detectors.protocol import Detector

# So many looks take a tenth of a second on the slowest board, and their median is not that of a cold start.
LOOKS = 15


def pictures_a_second() -> float:
    """Measure how many pictures of 640x480 it can look through for a ball of one colour."""
    driver = load_driver(DETECTORS, "ball").model_validate({"diameter": "20 cm", "hsv": "25,128,128:35,255,255"})
    detector: Detector = driver.build(DriverContext(name="ball", clock=SteppedClock()))
    rows, columns = np.ogrid[:480, :640]
    image = np.full((480, 640, 3), 90, np.uint8)
    image[np.hypot(rows - 240, columns - 320) < 40] = (0, 220, 220)
    times_s = []
    for number in range(LOOKS):
        began_s = perf_counter()
        detector.detect(Frame(image, 0.0, number))
        times_s.append(perf_counter() - began_s)
    return 1 / median(times_s)


if __name__ == "__main__":
    print(f"{pictures_a_second():.0f}")
