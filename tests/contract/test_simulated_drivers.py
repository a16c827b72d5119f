"""The simulated camera keeps the contract. The other simulated drivers stand beside their real counterparts."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stadimeter.app.clock import MonotonicClock
from stadimeter.config.plugins import CAMERAS, WORLDS, DriverContext, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.clock import Clock
from stadimeter.testing.camera_contract import CameraContract, CameraRig
from stadimeter.testing.rig import ManualClock

LENS = CameraModel.with_focal_length(150.0, 160, 120)


def in_a_world(clock: Clock) -> DriverContext:
    context = DriverContext(name="it", clock=clock, camera_model=LENS)
    model = load_driver(WORLDS, "simulated")
    model().build(context)
    return context


class TestSimulatedCamera(CameraContract):
    @pytest.fixture(params=[ManualClock, MonotonicClock], ids=["stepped", "real"])
    def clock(self, request: pytest.FixtureRequest) -> Clock:
        made: Clock = request.param()
        return made

    @pytest.fixture(params=[True, False], ids=["drawn", "black"])
    def make_rig(self, clock: Clock, request: pytest.FixtureRequest) -> Callable[[], CameraRig]:
        def rig() -> CameraRig:
            model = load_driver(CAMERAS, "simulated")
            options = model.model_validate({"rate": "1 kHz", "render": request.param})
            return CameraRig(camera=options.build(in_a_world(clock)), clock=clock)

        return rig
