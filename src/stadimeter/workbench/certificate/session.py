"""Certifying a site: the target is put at taped distances, the camera watches it, and all of them give the certificate.

What was measured is kept after each distance, in a file beside the configuration, so that one may go on later.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import fmean, median
from typing import Any

from msgspec.structs import replace

from stadimeter.app.bootstrap import StagedWorld, build
from stadimeter.app.certificate import (
    Certificate,
    certificate_file,
    distances_used,
    fingerprints,
    load_certificate,
    outdated,
    reliances,
    save_certificate,
    site_target,
)
from stadimeter.app.clock import MonotonicClock
from stadimeter.app.detectors import build_detectors
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.loader import Configuration, is_demonstration, load_configuration
from stadimeter.config.plugins import CAMERAS, DriverChoice, load_driver
from stadimeter.config.toml_source import read_toml
from stadimeter.config.units import path_from
from stadimeter.config.untrusted_file import CONFIGURATION_MAX_BYTES
from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement
from stadimeter.errors import CalibrationError, ConfigError, EndOfFramesError
from stadimeter.ranging.similar_triangles import farthest_m
from stadimeter.ranging.site_fit import Placement, find_reach, fit_site, read_placement
from stadimeter.workbench.certificate.page import blocks_of, html_of, pages_of
from stadimeter.workbench.drawing import pdf_of
from stadimeter.workbench.frame_source import SETTLING_WAIT_S, Source, open_source
from stadimeter.workbench.measuring import Measuring
from stadimeter.workbench.run_camera import choice_of, is_same_camera, list_cameras, source_beside_run

# How many distances are proposed, from which on, and up to where if no rule says.
PROPOSED, NEAREST_M, USUAL_FARTHEST_M = 5, 0.5, 3.0

# Tapes do not reach farther, and nothing is measured nearer.
MIN_TAPE_M, MAX_TAPE_M = 0.05, 50.0

# One standard deviation of a tape as people hold it, and the largest that still certifies anything, as a share.
TAPE_M, MAX_TAPE_SHARE = 0.002, 0.1

# Distances nearer to each other than this share are one: the later one counts.
SAME_SHARE = 0.02

# A camera is watched for this long; a slow one until there are so many frames.
WATCH_S, MIN_FRAMES, MAX_FRAMES = 5.0, 20, 1000

# Frames that waited may show the target on its way.
STALE_FRAMES = 2

# Puts the target at a distance to its centre, in a simulated world; before a real camera a person has done it.
Place = Callable[[float], None]


@contextmanager
def open_site(configuration: Configuration, pictures: Path | None = None) -> Iterator[tuple[Source, Place | None]]:
    """Give an open camera, and what puts the target in its world: the configuration's camera, or its run's.

    Args:
        pictures: A file, a folder or a pattern whose pictures are taken in place of a camera's.

    Raises:
        DriverError: It cannot be opened, or no frame comes.
        PictureError: There is no such picture.
    """
    place: Place | None = None
    if pictures is None:
        source = source_beside_run(configuration.camera, configuration.path, None)
    else:
        options = load_driver(CAMERAS, "images").model_validate({"paths": [str(pictures)]})
        source = open_source(DriverChoice(name="camera", driver="images", options=options))
    if source.room is not None:  # simulated, and no run has it: the configuration's own world
        parts = build(configuration, speed=None)
        source, place = Source(capture=parts.capture, is_live=False), _place_in(parts.world)
    try:
        source.settle()
        yield source, place
    finally:
        source.capture.close()


def _place_in(world: StagedWorld | None) -> Place | None:
    return None if world is None else lambda distance_m: world.place_target(*world.in_world_m(0.0, distance_m))


class SiteSession:
    """Measures at one distance after the other.

    Attributes:
        certificate: What was measured so far.
        is_resumed: Whether some of it is from an earlier time.
    """

    def __init__(self, configuration: Configuration, target: str = "", *, anew: bool = False) -> None:
        if is_demonstration(configuration.path):
            raise ConfigError(
                "nothing is written beside the demonstration: copy config/demo.toml, and certify the copy"
            )
        self.configuration = configuration
        self._choice = site_target(configuration, target)
        self._model: CameraModel = configuration.camera_model or load_camera_model(configuration.path)
        (self._named,) = build_detectors((self._choice,), self._model, configuration.footings)
        self._frame: Frame | None = None
        self._begun = configuration.path.with_suffix(".placements.json")
        begun = None if anew else load_certificate(self._begun)
        self.is_resumed = begun is not None and not outdated(configuration, begun)
        about = fingerprints(configuration, self._choice)
        fresh = Certificate(date="", target=self._choice.name, camera="", about=about)
        self.certificate = begun if begun is not None and self.is_resumed else fresh

    @property
    def to_centre_m(self) -> float:
        """How far the target's centre is behind the point to which a tape measures."""
        return self._named.detector.target_shape.limb_radius_m

    @property
    def proposed_m(self) -> tuple[float, ...]:
        """Distances for the tape, from near to the farthest that a rule uses, with its deadband."""
        model, shape = self._model, self._named.detector.target_shape
        used = distances_used(self.configuration, self._choice)
        ends_m = [limit_m + (condition.deadband_m if condition else 0.0) for _, _, limit_m, condition in used]
        # The nearest at which it is whole in the picture, with a tenth of room.
        near_m = max(NEAREST_M, 1.1 * farthest_m(shape, model, min(model.width_px, model.height_px)))
        far_m = min(MAX_TAPE_M, max(2 * near_m, *ends_m, 0.0 if ends_m else USUAL_FARTHEST_M))
        steps = ((far_m / near_m) ** (number / (PROPOSED - 1)) for number in range(PROPOSED))
        return tuple(math.ceil(20 * near_m * each - 1e-9) / 20 for each in steps)  # whole steps of 5 cm

    @property
    def left_m(self) -> list[float]:
        """The proposed distances at which it was not measured yet."""
        done_m = [each.tape_m for each in self.certificate.placements]
        return [each for each in self.proposed_m if not any(_is_same(each, other) for other in done_m)]

    def take(
        self, source: Source, place: Place | None, tape_m: float, sigma_m: float = TAPE_M, for_s: float = WATCH_S
    ) -> Placement:
        """Watch the target where it is now. Another placement at the same distance is replaced.

        Raises:
            ConfigError: No tape measures that.
            CalibrationError: The target moved, or there was no picture.
            DriverError: The camera gives no frames.
        """
        if not MIN_TAPE_M <= tape_m <= MAX_TAPE_M:
            raise ConfigError(f"{tape_m:g} m is no distance for a tape: {MIN_TAPE_M:g} to {MAX_TAPE_M:g} m")
        if not 0 < sigma_m <= MAX_TAPE_SHARE * tape_m:
            raise ConfigError(f"a distance of {tape_m:g} m that is known to ± {sigma_m:g} m certifies nothing")
        true_m = tape_m + self.to_centre_m
        if place is not None:
            place(true_m)
        skipped = STALE_FRAMES if source.is_live or place else 0
        placed = self._watch(source, Placement(tape_m=tape_m, true_m=true_m, tape_sigma_m=sigma_m), for_s, skipped)
        others = (each for each in self.certificate.placements if not _is_same(each.tape_m, tape_m))
        placements = tuple(sorted((*others, placed), key=lambda each: each.tape_m))
        self.certificate = replace(self.certificate, date=_now(), placements=placements)
        save_certificate(self._begun, self.certificate)
        return placed

    def _watch(self, source: Source, placed: Placement, for_s: float, skipped: int) -> Placement:
        measuring = Measuring((self._named,), self._model)
        seen: list[Measurement] = []
        ages_s, levels, sequences, times_s, reason = [], [], [], [], ""
        for frame in _frames(source, for_s, skipped):
            results = [each.measurement for each in measuring.measure(frame, "").targets]
            found = [each for each in results if each.distance_m is not None]
            # Of several tags the one that is where the tape says.
            seen += sorted(found, key=lambda each: abs((each.distance_m or 0.0) - placed.true_m))[:1]
            reason = reason or ("" if found else results[0].reason)
            ages_s.append(MonotonicClock().now_s() - frame.captured_at_s)
            levels.append(float(frame.image[::8, ::8].mean()))
            sequences.append(frame.sequence)
            times_s.append(frame.captured_at_s)
            self._frame = frame
        if self._frame is None or not times_s:
            raise CalibrationError(f"at {placed.tape_m:g} m there was no picture")
        lasted_s = times_s[-1] - times_s[0] if source.is_live else 0.0
        watched = replace(
            placed,
            frames=len(times_s),
            found=len(seen),
            size_px=median(each.size_share or 0.0 for each in seen) * self._frame.width_px if seen else 0.0,
            rate_hz=(sequences[-1] - sequences[0]) / lasted_s if lasted_s else None,
            latency_s=median(ages_s) if lasted_s else None,
            brightness=fmean(levels),
            exposure_s=self._frame.exposure_s,
            reason=reason,
        )
        # A table of a configuration states no edge bias, which is not to say that there is none.
        edge_px = self._model.for_frame(self._frame).edge_bias_sigma_px or UNKNOWN_EDGE_BIAS_SIGMA_PX
        return read_placement(watched, seen, edge_px)

    def finish(self, *, correct: bool = False) -> Certificate:
        """Write the certificate and its pages from all placements, and return it.

        Args:
            correct: Whether to write another focal length into the camera file, where the scale is wrong.

        Raises:
            CalibrationError: There are too few placements.
            ConfigError: A file cannot be written, or there is nothing to correct.
        """
        made = self._fitted(self.certificate)
        if correct:
            made = self._corrected(made)
        background = remember_background(self._frame)
        made = replace(made, date=_now(), camera=_camera_name(self.configuration), background=background)
        path, file = self.configuration.path, certificate_file(self.configuration.path)
        pages = pages_of(blocks_of(path.name, made, list(reliances(self.configuration, made))))
        html = html_of(pages, path.name).encode()
        save_certificate(file, made, {file.with_suffix(".html"): html, file.with_suffix(".pdf"): pdf_of(pages)})
        self._begun.unlink(missing_ok=True)
        return made

    def _fitted(self, certificate: Certificate) -> Certificate:
        fit = fit_site([each for each in certificate.placements if each.is_read])
        return replace(certificate, fit=fit, reach=find_reach(certificate.placements, fit))

    def _corrected(self, made: Certificate) -> Certificate:
        """Write a focal length with which the scale is right, and return what the placements come to with it."""
        path, fit = self.configuration.path, made.fit
        written = read_toml(path, CONFIGURATION_MAX_BYTES).table["camera"].get("model")
        if fit is None or not fit.has_wrong_scale:
            raise ConfigError("the scale is not significantly wrong, so there is nothing to correct")
        if not isinstance(written, str) or self._model.pupil_ahead_m:
            raise ConfigError("only a camera file for air can be corrected: name one as model in [camera]")
        file = path_from(path.parent, written)
        model, times = load_camera_model(file), 1 / (1 + fit.scale)
        note = f"focal length times {times:.5f} ± {fit.scale_sigma:.5f} by the certificate of {path.name}, {_now()}"
        kept = replace(model.provenance, notes=(*model.provenance.notes, note))
        lens = {"fx_px": model.fx_px * times, "fy_px": model.fy_px * times, "uncertainty": None}
        save_camera_model(file, replace(model, **lens, focal_relative_sigma=fit.scale_sigma, provenance=kept))
        self.configuration = load_configuration(path)
        placements = tuple(replace(each, read_m=each.read_m * times) for each in made.placements)
        about = fingerprints(self.configuration, self._choice)
        return self._fitted(replace(made, about=about, placements=placements, corrected=times - 1))


def remember_background(frame: Frame | None) -> Any:  # noqa: ARG001 - the place for it
    """Return what the certificate keeps of the newest picture, by which a camera that was moved is found: nothing."""
    return None


def _frames(source: Source, for_s: float, skipped: int) -> Iterator[Frame]:
    """Yield the frames of some seconds; of a recording as far as it goes."""
    try:
        for _ in range(skipped):
            source.capture.latest(SETTLING_WAIT_S)
        frame = first = source.capture.latest(SETTLING_WAIT_S)
        for count in range(MAX_FRAMES):
            if frame.captured_at_s - first.captured_at_s > for_s and count >= MIN_FRAMES:
                return
            yield frame
            frame = source.capture.latest(SETTLING_WAIT_S)
    except EndOfFramesError:
        return


def _is_same(one_m: float, other_m: float) -> bool:
    return abs(one_m / other_m - 1) <= SAME_SHARE


def _camera_name(configuration: Configuration) -> str:
    """Return the camera's name and the path that stays right, which has its serial number where it has one."""
    choice = configuration.camera
    same = (each for each in list_cameras() if is_same_camera(choice_of(each), choice))
    return next((f"{each.name}, {each.path}" for each in same), choice.driver)


def _now() -> str:
    return dt.datetime.now().astimezone().isoformat(" ", "minutes")
