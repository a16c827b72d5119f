"""A run in the simulated world, made as the app makes it: drivers by name, options as a configuration has them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec import Struct, field

from stadimeter.config.plugins import WORLDS, DriverContext, Shared, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.simulation.world import World
from stadimeter.testing.rig import ManualClock

LENS = CameraModel.with_focal_length(600.0, 640, 480)


class Run(Struct):
    clock: ManualClock
    lens: CameraModel | None = LENS
    shared: Shared = field(default_factory=Shared)

    def context(self, name: str) -> DriverContext:
        return DriverContext(name=name, clock=self.clock, camera_model=self.lens, shared=self.shared)

    def build(self, group: str, driver: str = "simulated", /, name: str = "it", **options: Any) -> Any:
        model = load_driver(group, driver)
        return model.model_validate(options).build(self.context(name))

    @property
    def world(self) -> World:
        found: World = self.shared.parts["world"]
        return found


MakeRun = Callable[..., Run]


@pytest.fixture
def make_run() -> MakeRun:
    """Return a function that starts a run with the given options of the world, the clock at 100 s."""

    def make(lens: CameraModel | None = LENS, **options: Any) -> Run:
        run = Run(clock=ManualClock(100.0), lens=lens)
        run.build(WORLDS, name="world", **options)
        return run

    return make


@pytest.fixture
def run(make_run: MakeRun) -> Run:
    """Return a run with the world as it comes."""
    return make_run()
