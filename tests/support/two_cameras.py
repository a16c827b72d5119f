"""A simulated run with two cameras beside each other that see one ball."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stadimeter.app.bootstrap import Parts, build
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Limits, Loop
from stadimeter.config.camera_file import stereo_file_text
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig, with_uncertainties

BASELINE_M = 0.12
LENS = CameraModel.with_focal_length(600.0, 640, 480)
BESIDE = with_uncertainties(
    StereoRig(
        left=LENS,
        right=LENS,
        turn_rad=(0.0, 0.0, 0.0),
        place_m=(BASELINE_M, 0.0, 0.0),
        covariance=np.diag([0.0] * (UNKNOWNS - 3) + [1e-8] * 3),
    )
)
"""Two equal cameras 12 cm apart, a tenth of a millimetre well known."""

THERE_AND_BACK = (
    '[{ at = "0 s", x = "0.6 m", y = "0 m" }, { at = "5 s", x = "2.6 m", y = "0.3 m" }, '
    '{ at = "10 s", x = "0.6 m", y = "0 m" }]'
)

SECTIONS: Mapping[str, str] = {
    "camera": 'driver = "simulated"',
    "second_camera": 'driver = "simulated"\nbaseline = "12 cm"\nstereo = "stereo.toml"',
    "targets.ball": 'detector = "ball"\ndiameter = "12 cm"\nhsv = "29,86,6:64,255,255"',
    "actuators.motor": 'driver = "simulated"',
    "rules.near": 'actuator = "motor"\nwhen = { below = "1 m" }',
    "world": f'ball_diameter = "12 cm"\nball_height = "25 cm"\npath = {THERE_AND_BACK}',
}


def write_configuration(folder: Path, rig: StereoRig = BESIDE, **lines: str) -> Path:
    """Write a configuration and its stereo file.

    Args:
        lines: More lines of a section, or in place of all if they begin with "=", by its name with _ for a dot.
    """
    (folder / "stereo.toml").write_text(stereo_file_text(rig))
    text = ""
    for name, usual in SECTIONS.items():
        more = lines.get(name.replace(".", "_"), "")
        text += f"[{name}]\n" + (more[1:] if more.startswith("=") else f"{usual}\n{more}") + "\n"
    path = folder / "two.toml"
    path.write_text(text)
    return path


def load(folder: Path, rig: StereoRig = BESIDE, **lines: str) -> Configuration:
    """Load such a configuration."""
    return load_configuration(write_configuration(folder, rig, **lines))


class Watched:
    """A run of such a configuration: each cycle, with the true distance in its frame."""

    def __init__(self, configuration: Configuration, seconds: float) -> None:
        self.parts: Parts = build(configuration, speed=None)
        self.cycles: list[tuple[CycleRecord, float]] = []
        self.loop = Loop(self.parts, [self._note])
        self.seconds = seconds

    def run(self) -> Watched:
        """Run it."""
        self.loop.run(Limits(seconds=self.seconds))
        return self

    def _note(self, record: CycleRecord, frame: object) -> None:
        stamp = record.observation.frame
        if frame is not None and stamp is not None:
            world = self.parts.world
            assert world is not None
            self.cycles.append((record, world.distance_m(stamp.captured_at_s)))  # type: ignore[attr-defined]

    def errors(self) -> tuple[list[float], list[float]]:
        """Return how far measured distances are off, as shares, and in standard deviations."""
        seen = [
            (measured.distance_m, measured.sigma_m, true_m)
            for record, true_m in self.cycles
            for measured in record.observation.measurements
            if measured.distance_m is not None and measured.sigma_m
        ]
        return [abs(d / true_m - 1) for d, _, true_m in seen], [abs(d - true_m) / s for d, s, true_m in seen]

    def remarks(self) -> list[str]:
        """Return what is said of each measured distance."""
        return [m.reason for record, _ in self.cycles for m in record.observation.measurements if m.distance_m]
