"""An hour in the simulated world, without pictures: world, camera and detector only."""

from __future__ import annotations

import math

import pytest

from stadimeter.config.plugins import CAMERAS, DETECTORS
from stadimeter.core.detection import DetectionStatus


@pytest.mark.long
def test_an_hour_of_following_a_ball_passes_in_seconds_and_measures_true(make_run) -> None:
    run = make_run(faults=[{"at": "30 min", "for": "1 min", "kind": "hide-target"}])
    camera, detector = run.build(CAMERAS, rate="5 Hz", render=False), run.build(DETECTORS, "ideal", noise_px=0.1)
    camera.open()
    counts = dict.fromkeys(DetectionStatus, 0)
    worst = 0.0
    for _ in range(5 * 3600):
        frame = camera.read()
        seen = detector.detect(frame)
        counts[seen.status] += 1
        turn = 0.0
        if seen.status is DetectionStatus.FOUND:
            depth_m = math.hypot(600 * 0.1 / (seen.width_px / 2), 0.1)
            worst = max(worst, abs(depth_m / run.world.target_in_camera(frame.captured_at_s)[2] - 1))
            turn = (run.lens.cx_px - seen.centre_px[0]) / 3000
        run.world.robot.drive_wheels(-turn, turn, until_s=run.clock.now_s() + 0.2)
    assert counts[DetectionStatus.NOT_FOUND] == 5 * 60
    assert counts[DetectionStatus.FOUND] == 5 * 3540
    assert worst < 0.02
