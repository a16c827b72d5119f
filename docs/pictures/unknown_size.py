"""The picture of things of unknown size in docs/how-it-measures.md: a ball that grows, and its distances on a line."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from measuring_round import ENLARGED, PANEL_PX, QUALITY, RED, YELLOW, Panel

from stadimeter.config.plugins import DETECTORS, DriverChoice, load_driver
from stadimeter.core.frame import Frame, Image
from stadimeter.ranging.size_from_motion import LearntSize, StepErrors, StepView, learn_size
from stadimeter.workbench.calibration.live_distance import SizeSession
from support.scenes import draw
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene

DIAMETER_M, START_M = 0.183, 2.0
WAYS_M = (0.0, 0.25, 0.5)
SIDE_PX = PANEL_PX * ENLARGED
"""The side of a panel."""

GREY = (120, 120, 120)
MARGIN_PX, AXIS_M, AXIS_ASSUMED_M = 44, 0.75, 1.25
"""Around the plot; how far its axes reach."""


def unknown_size_picture(path: Path) -> LearntSize:
    """Draw the ball from each place with its outline, and its distances as if it were 10 cm wide over the way."""
    options = load_driver(DETECTORS, "ball").model_validate({"diameter": "10 cm", "hsv": "29,86,6:64,255,255"})
    session = SizeSession(DriverChoice(name="ball", driver="ball", options=options), draw.CAMERA)
    views, panels = [], []
    for number, way_m in enumerate(WAYS_M):
        ball = BallTarget(position_m=(0.05, 0.02, START_M - way_m), diameter_m=DIAMETER_M)
        scene = Scene(camera=draw.CAMERA, target=ball, seed=number, backdrop=PlainBackdrop(bgr=(90, 84, 80)))
        image = render(scene).image
        found, view = session.look(f"{100 * way_m:.0f} cm", Frame(image, 0.0, number), (0.0, 0.0, way_m))
        if view is None:
            raise RuntimeError(f"the ball was not found: {found.reason}")
        panel = Panel(image, found.centre_px)
        panel.loop(found.outline_px, RED)
        views.append(view)
        panels.append(_named(panel.pixels, f"{found.width_px:.1f} px"))
    learnt = learn_size(views, draw.CAMERA, StepErrors())
    gap = np.full((SIDE_PX, 8, 3), 255, np.uint8)
    row = [each for panel in (*panels, _plot(views, learnt)) for each in (panel, gap)][:-1]
    cv2.imwrite(str(path), np.concatenate(row, axis=1), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return learnt


def _plot(views: list[StepView], learnt: LearntSize) -> Image:
    """Return the depths with the assumed size over the way, and the line of the learnt size."""
    plot = np.full((SIDE_PX, SIDE_PX, 3), 255, np.uint8)

    def place(way_m: float, depth_m: float) -> tuple[int, int]:
        reach = SIDE_PX - 2 * MARGIN_PX
        return round(MARGIN_PX + way_m / AXIS_M * reach), round(SIDE_PX - MARGIN_PX - depth_m / AXIS_ASSUMED_M * reach)

    cv2.line(plot, place(0, 0), place(AXIS_M, 0), GREY, 1, cv2.LINE_AA)
    cv2.line(plot, place(0, 0), place(0, AXIS_ASSUMED_M), GREY, 1, cv2.LINE_AA)
    middle_m = (
        float(np.mean([view.position_m[2] for view in views])),
        float(np.mean([view.moved_m[2] for view in views])),
    )
    ends = [place(way_m, middle_m[0] - (way_m - middle_m[1]) / learnt.factor) for way_m in (0.0, AXIS_M)]
    cv2.line(plot, *ends, RED, 1, cv2.LINE_AA)
    for view in views:
        spot = place(view.moved_m[2], view.position_m[2])
        cv2.circle(plot, spot, 5, YELLOW, cv2.FILLED, cv2.LINE_AA)
        cv2.circle(plot, spot, 5, GREY, 1, cv2.LINE_AA)
        _write(plot, f"{100 * view.moved_m[2]:.0f}", (place(view.moved_m[2], 0)[0] - 8, SIDE_PX - MARGIN_PX + 18))
        _write(plot, f"{view.position_m[2]:.3f}", (spot[0] + 6, spot[1] - 10))
    _write(plot, "way of the camera, cm", (SIDE_PX - 190, SIDE_PX - 8))
    _write(plot, "depth as of 10 cm, m", (8, 20))
    return plot


def _named(pixels: Image, name: str) -> Image:
    _write(pixels, name, (10, SIDE_PX - 12), (255, 255, 255))
    return pixels


def _write(pixels: Image, words: str, place_px: tuple[int, int], colour: tuple[int, int, int] = (60, 60, 60)) -> None:
    cv2.putText(pixels, words, place_px, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)


if __name__ == "__main__":
    print(unknown_size_picture(Path(__file__).parent / "how-unknown-size.jpg"))
