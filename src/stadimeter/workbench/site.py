"""The site of a camera: certified with taped distances, and its view saved and compared with what was saved.

The target is put at distances of a tape, the camera watches it, and all of them give the certificate. What was measured
is kept after each distance, in a file beside the configuration, so that one may go on later. With the certificate the
view of a fixed camera is saved, by which a run notices that it was moved.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from statistics import median

from msgspec.structs import replace

from stadimeter.app import mounting
from stadimeter.app.bootstrap import build
from stadimeter.app.capture import Capture
from stadimeter.app.certificate import Certificate, Reliance, Site, load_certificate, save_certificate
from stadimeter.app.detectors import build_detectors
from stadimeter.app.places import CERTIFICATE, PLACEMENTS
from stadimeter.config.loader import Configuration, is_demonstration
from stadimeter.config.plugins import CAMERAS, DriverChoice, load_driver
from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import Measurement
from stadimeter.core.words import length
from stadimeter.errors import CalibrationError, ConfigError, EndOfFramesError, StadimeterError, StateError
from stadimeter.perception.mounting import Judgement, look_at
from stadimeter.perception.perceiver import Perceiver
from stadimeter.ranging import site_fit
from stadimeter.ranging.similar_triangles import farthest_m
from stadimeter.ranging.site_fit import SIGMAS_95, Placement
from stadimeter.workbench import frame_source
from stadimeter.workbench.measuring import Measuring

# How many distances are proposed, from which on, and up to where if no rule says.
PROPOSED, NEAREST_M, USUAL_FARTHEST_M = 5, 0.5, 3.0

# Distances are proposed in whole steps of 5 cm.
STEPS_PER_M = 20

# Tapes do not reach farther, and nothing is measured nearer.
MIN_TAPE_M, MAX_TAPE_M = 0.05, 50.0

# One standard deviation of a tape as people hold it, and the largest that still certifies anything, as a share.
TAPE_M, MAX_TAPE_SHARE = 0.002, 0.1

# Distances nearer to each other than this share are one: the later one counts.
SAME_SHARE = 0.02

# A camera is watched for this long; a slow one until there are this many frames, a fast one for no more than that many.
WATCH_S, MIN_FRAMES, MAX_FRAMES = 5.0, 20, 1000

# The ending of the page.
HTML = ".certificate.html"


# The view of the camera --------------------------------------------------------------------------------------------


def save_view(configuration: Configuration) -> tuple[Path, mounting.MountingReference]:
    """Save the view that a camera has now, as that of its mounting; return the file and what is in it.

    Raises:
        StadimeterError: The view has too little to go by, the camera gives no picture, or the file cannot be written.
    """
    frames, lens, targets = _look(configuration, mounting.PICTURES * mounting.MOMENTS)
    reference = mounting.make_reference(frames, lens, targets)
    return mounting.save_reference(configuration.path, reference), reference


def check_view(configuration: Configuration) -> Judgement:
    """Compare the view that a camera has now with the saved one, once.

    Raises:
        StadimeterError: No view was saved, it is of another camera, or the camera gives no picture.
    """
    reference = mounting.load_reference(configuration.path)
    if reference is None:
        raise StateError(f"{configuration.path}: no view of its camera was saved; `stadimeter site save` does")
    frames, lens, targets = _look(configuration, mounting.PICTURES)
    if why := reference.why_not_for(frames[0], lens):
        raise CalibrationError(why)
    view = look_at([each.image for each in frames], lens, targets)
    return mounting.judge_by(reference, configuration, lens).judge(view)


def _look(configuration: Configuration, count: int) -> tuple[list[Frame], CameraModel, list[Points]]:
    """Return some pictures, through the run if one has the camera, its lens for them, and the outlines of targets."""
    if configuration.camera_model is None:
        raise ConfigError("no camera file: say in [camera] model = which lens the camera has")
    if configuration.base is not None:
        raise ConfigError(f"there is no view to save: {mounting.ON_ROBOT}")
    source, frames = frame_source.source_beside_run(configuration.camera, configuration.path, None), list[Frame]()
    try:
        source.settle()
        while len(frames) < count:
            frames = mounting.keep_apart(frames, source.capture.latest(frame_source.SETTLING_WAIT_S))
    except EndOfFramesError:
        raise CalibrationError(f"the recording ends before {count} pictures") from None
    finally:
        source.capture.close()
    lens = configuration.camera_model.for_frame(frames[0])
    named = build_detectors(configuration.targets, lens, configuration.footings)
    detectors = {member: each.detector for each in named for member in each.members or (each.name,)}
    detections, _ = Perceiver(detectors, lens).look(frames[0])
    return frames, lens, [each.outline_px for each in detections if len(each.outline_px)]


# The certificate ---------------------------------------------------------------------------------------------------


class SiteSession:
    """Measures at one distance after the other.

    Args:
        anew: Whether what was measured before is forgotten.

    Attributes:
        site: What is certified.
        certificate: What was measured so far.
    """

    def __init__(self, configuration: Configuration, target: str = "", *, anew: bool = False) -> None:
        if is_demonstration(configuration.path):
            raise ConfigError("nothing is written beside the demonstration: certify a copy of config/demo.toml")
        self.site = Site(configuration, target)
        self.certificate = Certificate(target=self.site.target.name, about=self.site.about)
        begun = None if anew else load_certificate(configuration.path, PLACEMENTS)
        if begun is not None and begun.target == self.certificate.target and not self.site.outdated(begun):
            self.certificate = replace(begun, about=self.site.about)

    @property
    def is_simulated(self) -> bool:
        """True if the target is in a simulated world, so that the program puts it where it belongs."""
        return self.site.configuration.camera.options.needs_world

    def propose_m(self) -> list[float]:
        """Return distances for the tape, from near to the farthest that a rule uses; those that are done left out."""
        ends_m = [limit_m + (leaf.deadband if leaf else 0.0) for _, _, limit_m, leaf in self.site.distances()]
        model, placements = self.site.model, self.certificate.placements
        # There the target is whole in the picture, with a tenth of room.
        near_m = max(NEAREST_M, 1.1 * farthest_m(self.site.shape, model, min(model.width_px, model.height_px)))
        far_m = min(MAX_TAPE_M, max(2 * near_m, *ends_m, 0.0 if ends_m else USUAL_FARTHEST_M))
        steps = (near_m * (far_m / near_m) ** (number / (PROPOSED - 1)) for number in range(PROPOSED))
        places_m = (math.ceil(STEPS_PER_M * each - 1e-9) / STEPS_PER_M for each in steps)
        return [each for each in places_m if len(self._others(each)) == len(placements)]

    def take(
        self, tape_m: float, sigma_m: float = TAPE_M, for_s: float = WATCH_S, pictures: Path | None = None
    ) -> Placement:
        """Watch the target where it is now; before a simulated camera it is put there.

        Another placement at the same distance is replaced.

        Args:
            pictures: A file, a folder or a pattern whose pictures are taken in place of a camera's.

        Raises:
            ConfigError: No tape measures that.
            CalibrationError: The target moved, or there was no picture.
            DriverError: The camera gives no frames.
            PictureError: There is no such picture.
        """
        if not MIN_TAPE_M <= tape_m <= MAX_TAPE_M:
            raise ConfigError(f"{tape_m:g} m is no distance for a tape: {MIN_TAPE_M:g} to {MAX_TAPE_M:g} m")
        if not 0 < sigma_m <= MAX_TAPE_SHARE * tape_m:
            raise ConfigError(f"a distance of {tape_m:g} m that is known to ± {sigma_m:g} m certifies nothing")
        placed = Placement(tape_m=tape_m, true_m=tape_m + self.site.shape.limb_radius_m, tape_sigma_m=sigma_m)
        source = self._source(placed.true_m, pictures)
        try:
            source.settle()
            placed = self._watch(_frames(source.capture, for_s), placed)
        finally:
            source.capture.close()
        placements = sorted((*self._others(tape_m), placed), key=lambda each: each.tape_m)
        self.certificate = replace(self.certificate, date=_now(), placements=tuple(placements))
        save_certificate(self.site.configuration.path, self.certificate, PLACEMENTS)
        return placed

    def _source(self, true_m: float, pictures: Path | None) -> frame_source.Source:
        configuration = self.site.configuration
        if pictures is not None:
            options = load_driver(CAMERAS, "images").model_validate({"paths": [str(pictures)]})
            return frame_source.open_source(DriverChoice(name="camera", driver="images", options=options))
        if not self.is_simulated:
            return frame_source.source_beside_run(configuration.camera, configuration.path, None)
        parts = build(configuration, speed=None)
        if parts.world is not None:
            parts.world.place_target(*parts.world.in_world_m(0.0, true_m))
        return frame_source.Source(capture=parts.capture, is_live=True)  # the first frames show it on its way

    def _others(self, tape_m: float) -> list[Placement]:
        return [each for each in self.certificate.placements if abs(each.tape_m / tape_m - 1) > SAME_SHARE]

    def _watch(self, frames: Iterator[Frame], placed: Placement) -> Placement:
        """Return the placement that was measured."""
        measuring, seen = Measuring((self.site.named,), self.site.model), list[Measurement]()
        count, last, reason = 0, None, ""
        for last in frames:
            count += 1
            results = [each.measurement for each in measuring.measure(last, "").targets]
            found = [each for each in results if each.distance_m is not None]
            # Of several tags the one that is where the tape says.
            seen += sorted(found, key=lambda each: abs((each.distance_m or 0.0) - placed.true_m))[:1]
            reason = reason or ("" if found else results[0].reason)
        if last is None:
            raise CalibrationError(f"at {placed.tape_m:g} m there was no picture")
        # A table of a configuration states no edge bias, which is not to say that there is none.
        edge_px = self.site.model.for_frame(last).edge_bias_sigma_px or UNKNOWN_EDGE_BIAS_SIGMA_PX
        size_px = median(each.size_share or 0.0 for each in seen) * last.width_px if seen else 0.0
        placed = replace(placed, frames=count, found=len(seen), size_px=size_px, reason=reason)
        return site_fit.read_placement(placed, seen, edge_px)

    def finish(self) -> Certificate:
        """Write the certificate and its page from all placements, save the view, and return the certificate.

        Raises:
            CalibrationError: There are too few placements.
            ConfigError: A file cannot be written.
        """
        path, placements = self.site.configuration.path, self.certificate.placements
        fit = site_fit.fit_site([each for each in placements if each.is_read])
        reach = site_fit.find_reach(placements, fit)
        made = replace(self.certificate, date=_now(), fit=fit, reach=reach, background=self._save_view())
        page = page_of(path.name, made, list(self.site.reliances(made)))
        save_certificate(path, made, CERTIFICATE, {HTML: page.encode(errors="replace")})
        path.with_suffix(PLACEMENTS).unlink(missing_ok=True)
        return made

    def _save_view(self) -> str | None:
        """Save the view of a fixed, real camera; return how that went, and None for another one."""
        if self.is_simulated or self.site.configuration.base is not None:
            return None
        try:
            return f"saved as {save_view(self.site.configuration)[0].name}"
        except StadimeterError as error:
            return f"not saved, {error}"


def _frames(capture: Capture, for_s: float) -> Iterator[Frame]:
    """Yield the frames of some seconds; of a recording as far as it goes."""
    try:
        frame = first = capture.latest(frame_source.SETTLING_WAIT_S)
        for count in range(MAX_FRAMES):
            if frame.captured_at_s - first.captured_at_s > for_s and count >= MIN_FRAMES:
                return
            yield frame
            frame = capture.latest(frame_source.SETTLING_WAIT_S)
    except EndOfFramesError:
        return


def _now() -> str:
    return dt.datetime.now().astimezone().isoformat(" ", "minutes")


# Sentences of certificates.
ALIKE = (
    "Focal length and size of the target cannot be separated by distances: each scales all of them alike. Measure the"
    " target again:"
)
CORRECT = "If that is right, calibrate the camera anew, or write into its file the focal length times"
RELIABLE = (
    f"an error within {site_fit.RELIABLE_SHARE:.0%} in 95 of 100 readings, the target seen in"
    f" {site_fit.RELIABLE_RATE:.0%} of frames"
)


def summary_of(made: Certificate) -> Iterator[str]:
    """Yield what a certificate says of scale, offset and reach, a paragraph each."""
    fit, reach, placements = made.fit, made.reach, [each for each in made.placements if each.is_read]
    if fit is None or reach is None:
        return
    sure = f"± {100 * SIGMAS_95 * fit.scale_sigma:.2f} % (95 % interval)"
    yield f"Scale: distances are {_too_long(100 * fit.scale, '.2f', '%')}, {sure}: {_verdict(fit.has_wrong_scale)}."
    if fit.has_wrong_scale:
        times = 1 / (1 + fit.scale)
        yield f"{ALIKE} its size may be {100 * (times - 1):+.2f} % off. {CORRECT} {times:.4f}."
    least = f"An error of the scale from {100 * fit.least_scale:.1f} % on"
    more = "; further distances make it surer" * (fit.least_scale > site_fit.WANTED_SCALE)
    yield f"{least} is found in 95 of 100 cases, a smaller one less often{more}."
    sure = f"± {100 * SIGMAS_95 * fit.offset_sigma_m:.1f} cm (95 % interval, the zero of the tape included)"
    yield f"Offset: distances are {_too_long(100 * fit.offset_m, '.1f', 'cm')}, {sure}: {_verdict(fit.has_offset)}."
    if fit.has_offset:
        where = "behind" if fit.offset_m > 0 else "before"
        yield f"The lens is that far {where} the mark from which the tape measured: measure from the lens."
    if abs(fit.edge) > 1:
        far = "calibrate anew, from near and from far"
        yield f"Edges appear {fit.edge:+.1f} standard deviations of the camera's edge bias too far out: {far}."
    if not fit.is_consistent:
        at = f"most of all that at {placements[fit.worst].tape_m:g} m: measure it again"
        yield f"The placements contradict each other more than those of 99 of 100 sites, {at}."
    near = f"from {length(reach.nearest_m)} " if reach.nearest_m else ""
    yield f"Reliable {near}to {length(reach.reliable_m)}: {RELIABLE}. There {reach.limit}."
    if made.background is not None:
        yield f"View of the camera, by which a run tells whether it was moved: {made.background}."


def describe_placement(each: Placement) -> str:
    """Say what was seen at a distance, in a line."""
    seen = f"{each.tape_m:g} m: seen in {each.found} of {each.frames} frames"
    if not each.is_read:
        return f"{seen}: {each.reason or 'too few to go by'}"
    off = f"{100 * (each.read_m - each.true_m):+.1f} cm off, scatter ± {100 * each.spread_m:.2f} cm"
    return f"{seen}, {off}, stated ± {100 * each.stated_m:.1f} cm"


def describe_reliance(each: Reliance) -> str:
    """Say what a rule may rely on at one of its distances, in a line."""
    one = f"one reading ± {100 * each.sigma_m:.1f} cm, {_too_long(100 * each.bias_m, '.1f', 'cm')}"
    return f"{each.words}: {f'not carried, {each.trouble}' if each.trouble else 'carried'}; {one}"


def _too_long(much: float, digits: str, unit: str) -> str:
    return f"{abs(much):{digits}} {unit} too {'long' if much >= 0 else 'short'}"


def _verdict(is_significant: bool) -> str:
    return "significant" if is_significant else "not significant"


# The page of a certificate: one HTML file that needs no other, and prints on A4 ---------------------------------------


def page_of(name: str, made: Certificate, reliances: Sequence[Reliance]) -> str:
    """Return the page of a certificate that has a fit."""
    about = ", ".join(f"{what} {text}" for what, text in made.about.items())
    measured = f"Measured {made.date} with the target {made.target}. Fingerprints: {about}."
    title = escape(f"Certificate of the site: {name}")
    return "\n".join(
        [
            f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><h1>{title}</h1>',
            *_paragraphs([measured]),
            "<h2>Right here, in this light</h2>",
            *_paragraphs(summary_of(made)),
            "<h2>Placements</h2>",
            *_paragraphs(map(describe_placement, made.placements)),
            "<h2>What rules may rely on</h2>",
            *_paragraphs(map(describe_reliance, reliances)),
            "</html>\n",
        ]
    )


def _paragraphs(sentences: Iterable[str]) -> Iterator[str]:
    return (f"<p>{escape(each)}</p>" for each in sentences)
