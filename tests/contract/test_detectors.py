"""The detector contract over every registered detector, and that it catches mistakes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from stadimeter.config.plugins import DETECTORS, driver_names
from stadimeter.testing.detector_contract import DetectorContract, DetectorRig
from support.detector_rigs import detector_rig

pytestmark = [pytest.mark.vision, pytest.mark.oldest_opencv]


class TestEveryDetector(DetectorContract):
    @pytest.fixture(params=sorted(driver_names(DETECTORS)))
    def make_rig(self, request: pytest.FixtureRequest) -> Callable[[], DetectorRig]:
        return partial(detector_rig, request.param)
