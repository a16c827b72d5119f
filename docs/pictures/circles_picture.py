"""The picture of three circles in docs/how-it-measures.md: every disc, the three that fit, and where that is."""

from __future__ import annotations

import math
from itertools import combinations
from pathlib import Path

import numpy as np
from measuring_round import RED, YELLOW, Panel, save

from stadimeter.core.detection import DetectionStatus
from stadimeter.core.frame import Frame
from stadimeter.detectors.circles import CirclesDetector, CirclesOptions
from stadimeter.detectors.disc import DiscDetector, DiscOptions
from stadimeter.detectors.disc.edges import EdgePicture, Lens
from stadimeter.detectors.sampling import Region
from stadimeter.ranging.measure import measure
from support.scenes import draw
from support.scenes.backdrop import PlainBackdrop
from support.scenes.circles import DIAMETER_M, CirclesTarget
from support.scenes.plane import INK_BGR, DiscTarget, Pose
from support.scenes.render import render
from support.scenes.scene import Scene

ENLARGED = 2
TILT_RAD, TOWARDS_RAD = math.radians(35), 0.4
CIRCLES = CirclesTarget(
    pose=Pose(position_m=(0.05, -0.02, 1.2), tilt_rad=TILT_RAD, tilt_towards_rad=TOWARDS_RAD, roll_rad=0.3)
)
OTHERS = tuple(
    DiscTarget(pose=Pose(position_m=place_m), diameter_m=DIAMETER_M, bgr=INK_BGR)
    for place_m in ((-0.095, 0.07, 1.2), (0.195, -0.165, 1.2))
)
MIDDLE_PX = 344.0, 228.0
"""What is in the middle of each panel."""


def circles_picture(path: Path) -> None:
    """Draw every disc, the three whose distances are right in diameters, and the circles of the pose with it."""
    wall = PlainBackdrop(bgr=(170, 165, 160))
    image = render(Scene(camera=draw.CAMERA, target=CIRCLES, others=OTHERS, seed=7, backdrop=wall)).image
    table = {"diameter": "5 cm", "spacing": "10 cm"}
    detector = CirclesDetector("circles", CirclesOptions.model_validate(table))
    found = detector.detect(Frame(image, 0.0, 0), lens=draw.CAMERA)
    if found.status is not DetectionStatus.FOUND:
        raise RuntimeError(f"the circles were not found: {found.reason}")
    measured = measure(found, detector.target_shape, draw.CAMERA, 0.0)
    every, taken, fitted = (Panel(image, MIDDLE_PX, ENLARGED) for _ in range(3))
    discs = DiscDetector("disc", DiscOptions.model_validate({"diameter": "5 cm"}))
    picture = EdgePicture(image=image, lens=Lens(camera=draw.CAMERA))
    for disc in discs.judge_all(picture, Region.whole(image)).discs:
        every.loop(disc.edges.ellipse.rim(90).points_px, YELLOW)
    rims = found.outline_px.reshape(3, -1, 2)
    centres = rims.mean(axis=1)
    for pair in combinations(range(3), 2):
        (start, end), way = centres[list(pair)], np.subtract(*centres[list(pair)])
        length_px = float(np.linalg.norm(way))
        taken.lines(start[None], end[None], YELLOW)
        # As long as how many diameters of both discs, in its own direction.
        diameter_px = float(np.mean([np.ptp(rims[each] @ way) / length_px for each in pair]))
        taken.write(f"{length_px / diameter_px:.2f}", (start + end) / 2, RED)
    for rim in rims:
        fitted.loop(rim, RED)
    corner = np.array(MIDDLE_PX) - (85, -85)
    fitted.write(f"{measured.distance_m:.4f} m +- {measured.sigma_m:.4f}", corner, RED)
    fitted.write(f"truly {math.hypot(*CIRCLES.position_m):.4f} m", corner - (0, 10), RED)
    save(path, every, taken, fitted)


if __name__ == "__main__":
    circles_picture(Path(__file__).parent / "measuring-circles.jpg")
