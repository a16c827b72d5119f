"""The page of a certificate, drawn on A4: as a PDF, and as HTML with the same drawings in it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from html import escape
from itertools import pairwise

from stadimeter.app.certificate import Certificate, Reliance
from stadimeter.core.drawing import Drawing, Line, Shape, Text
from stadimeter.core.words import length
from stadimeter.ranging.site_fit import RELIABLE_RATE, RELIABLE_SHARE, SIGMAS_95, WANTED_SCALE, Placement, SiteFit
from stadimeter.workbench.drawing import svg_of, text_width_m

# A paragraph, or a heading behind `HEADING`; a table, its head first; a drawing.
Block = str | list[tuple[str, ...]] | Drawing

HEADING = "# "

# A4 upright, and what is left white.
WIDTH_M, HEIGHT_M, MARGIN_M = 0.21, 0.297, 0.016
INNER_M = WIDTH_M - 2 * MARGIN_M
TEXT_M, HEADING_M, CELL_M, LINE = 0.0032, 0.0046, 0.0026, 1.5

# The width of a digit in Helvetica, as a share of its size: sentences are narrower on average.
DIGIT_WIDTH = 0.556

# The height of a chart, the room for its figures, and by how many lines it is divided.
CHART_M, AXES_M, TICKS = 0.05, 0.012, 6
GREY, BLUE, RED = "#bbbbbb", "#1f5fae", "#b3261e"

# Sentences of certificates.
ALIKE = (
    "Focal length and size of the target cannot be separated by distances: each scales all of them alike. Measure the"
    " target again:"
)
CORRECT = "If that is right, certify again with --correct, which writes the focal length times"
RELIABLE = (
    f"an error within {RELIABLE_SHARE:.0%} in 95 of 100 readings, the target seen in {RELIABLE_RATE:.0%} of frames"
)
MORE = f"An error of the scale of {WANTED_SCALE:.1%} might go unnoticed so far: further distances make it surer."
ODDS = (
    "False alarm: one reading begins the condition while the target is a deadband outside of the threshold. Miss: one"
    " reading does not begin it a deadband inside. A run filters readings, and its delays forgive single ones."
)

_PLACEMENTS = ("tape", "read", "bias", "scatter", "stated", "within 1, 1.96 stated", "seen", "frames/s", "latency")
_RULES = ("rule", "one reading", "bias", "deadband", "false alarm", "miss", "carried")


def summary_of(made: Certificate) -> Iterator[str]:
    """Yield what a certificate says of scale, offset and reach, a paragraph each."""
    fit, reach, placements = made.fit, made.reach, [each for each in made.placements if each.is_read]
    if fit is None or reach is None:
        return
    sure = f"± {100 * SIGMAS_95 * fit.scale_sigma:.2f} % (95 % interval)"
    yield f"Scale: distances are {100 * fit.scale:+.2f} % too long, {sure}: {_verdict(fit.has_wrong_scale)}."
    if fit.has_wrong_scale:
        times = 1 / (1 + fit.scale)
        yield f"{ALIKE} its size may be {100 * (times - 1):+.2f} % off. {CORRECT} {times:.4f} into the camera file."
    least = f"An error of the scale from {100 * fit.least_scale:.1f} % on"
    yield f"{least} is found in 95 of 100 cases, a smaller one less often."
    sure = f"± {100 * SIGMAS_95 * fit.offset_sigma_m:.1f} cm (95 % interval, the zero of the tape included)"
    yield f"Offset: distances are {100 * fit.offset_m:+.1f} cm too long, {sure}: {_verdict(fit.has_offset)}."
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
    yield f"Reliable {near}to {length(reach.reliable_m)}: {RELIABLE}."
    on = f"by the error model it goes on to {length(reach.expected_m)}; there {reach.limit}"
    yield f"Nothing was measured beyond the farthest placement; {on}."
    if made.background is not None:
        yield f"View of the camera, by which a run tells whether it was moved: {made.background}."


def describe_placement(each: Placement) -> str:
    """Say what was seen at a distance, in a line."""
    seen = f"{each.tape_m:g} m: seen in {each.found} of {each.frames} frames"
    if not each.is_read:
        return f"{seen}: {each.reason or 'too few to go by'}"
    off = f"{100 * (each.read_m - each.true_m):+.1f} cm off, scatter ± {100 * each.spread_m:.2f} cm"
    return f"{seen}, {off}, stated ± {100 * each.stated_m:.1f} cm"


def _verdict(is_significant: bool) -> str:
    return "significant" if is_significant else "not significant"


def blocks_of(name: str, made: Certificate, reliances: Sequence[Reliance]) -> list[Block]:
    """Return the content of the page of a certificate, which has a fit."""
    levels = [each.brightness for each in made.placements]
    exposed = ", ".join(sorted({f"{1e3 * each.exposure_s:.1f} ms" for each in made.placements if each.exposure_s}))
    about = [(f"fingerprint of the {what}", text) for what, text in made.about.items()]
    light = f"mean brightness {min(levels):.0f} to {max(levels):.0f} of 255, exposure {exposed or 'not known'}"
    corrected = f"{made.corrected:+.2%}; the figures are as with it" if made.corrected else "none"
    return [
        f"{HEADING}Certificate of the site: {name}",
        [("measured", made.date), ("camera", made.camera), ("target", made.target), *about, ("light", light)],
        f"Correction of the focal length: {corrected}.",
        f"{HEADING}Right here, in this light",
        *summary_of(made),
        *([_bias_chart(made.fit, [each for each in made.placements if each.is_read])] if made.fit else []),
        f"{HEADING}Placements",
        [_PLACEMENTS, *map(_placement_row, made.placements)],
        f"{HEADING}What rules may rely on",
        [_RULES, *map(_rule_row, reliances)],
        ODDS,
        *(f"{each.words}: {each.trouble}." for each in reliances if each.trouble),
    ]


def _placement_row(each: Placement) -> tuple[str, ...]:
    tape, seen = f"{each.tape_m:.3f} m ± {1e3 * each.tape_sigma_m:.0f} mm", f"{each.found} of {each.frames}"
    off_m, (one, two) = each.read_m - each.true_m, each.covered
    read = (f"{each.tape_m + off_m:.3f} m", f"{100 * off_m:+.1f} cm", f"± {100 * each.spread_m:.2f} cm")
    figures = (*read, f"± {100 * each.stated_m:.1f} cm", f"{one:.0%}, {two:.0%}") if each.is_read else ("",) * 5
    timed = (f"{each.rate_hz:.1f}", f"{1e3 * each.latency_s:.0f} ms") if each.rate_hz and each.latency_s else ()
    return tape, *figures, seen, *timed


def _rule_row(each: Reliance) -> tuple[str, ...]:
    odds = ("", "", "")
    if each.odds is not None:
        odds = (f"{100 * each.odds[0]:.2f} cm", f"{each.odds[1]:.2%}", f"{each.odds[2]:.2%}")
    figures = f"± {100 * each.sigma_m:.1f} cm", f"{100 * each.bias_m:+.1f} cm"
    return each.words, *figures, *odds, "no" if each.trouble else "yes"


def _bias_chart(fit: SiteFit, seen: Sequence[Placement]) -> Drawing:
    """Draw the bias with its 95 % interval over the distance, and the placements with theirs."""
    near_m, far_m = seen[0].true_m, seen[-1].true_m
    biases = [(at_m, *fit.bias_m(at_m)) for at_m in (near_m + (far_m - near_m) * step / 40 for step in range(41))]
    curves = [[(at_m, 100 * (off + side * sure)) for at_m, off, sure in biases] for side in (-SIGMAS_95, 0, SIGMAS_95)]
    halves_m = [SIGMAS_95 * math.hypot(each.read_sigma_m, each.tape_sigma_m) for each in seen]
    offs = [(each.true_m, each.read_m - each.true_m, half_m) for each, half_m in zip(seen, halves_m, strict=True)]
    bars = [[(at_m, 100 * (off_m - half_m)), (at_m, 100 * (off_m + half_m))] for at_m, off_m, half_m in offs]
    ys = [0.0, *(y for curve in (*curves, *bars) for _, y in curve)]
    low, high = min(ys), max(*ys, min(ys) + 0.1)

    def at(x: float, y: float) -> tuple[float, float]:
        across = AXES_M + (x - near_m) / (far_m - near_m) * (INNER_M - AXES_M - 0.01)
        return across, CHART_M - 0.006 - (y - low) / (high - low) * (CHART_M - 0.014)

    shapes: list[Shape] = [Text(0.0, CELL_M, "bias in cm over the distance in m, with 95 % intervals", CELL_M)]
    for share in (number / (TICKS - 1) for number in range(TICKS)):
        x, y = near_m + share * (far_m - near_m), low + share * (high - low)
        shapes.append(Line(*at(near_m, y), *at(far_m, y), 0.0001, GREY))
        shapes.append(Text(AXES_M - 0.002, at(x, y)[1] + 0.001, f"{y:.2f}", CELL_M, "end"))
        shapes.append(Text(at(x, y)[0], CHART_M - 0.001, f"{x:.2f}", CELL_M, "middle"))
    for lines, colour, width_m in ((curves, BLUE, 0.0003), (bars, RED, 0.0007)):
        pairs = (pair for line in lines for pair in pairwise(line))
        shapes += [Line(*at(*one), *at(*two), width_m, colour) for one, two in pairs]
    return Drawing(INNER_M, CHART_M, tuple(shapes))


def html_of(pages: Sequence[Drawing], title: str) -> str:
    """Return pages as one HTML file that needs no other."""
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
    return "\n".join([head, *map(svg_of, pages), "</html>", ""])


def pages_of(blocks: Sequence[Block]) -> list[Drawing]:
    """Return blocks below each other on as many pages as they need."""
    pages: list[list[Shape]] = [[]]
    y_m = MARGIN_M
    for part in (part for block in blocks for part in _parts(block)):
        if y_m + part.height_m > HEIGHT_M - MARGIN_M:
            pages.append([])
            y_m = MARGIN_M
        pages[-1] += part.moved(MARGIN_M, y_m)
        y_m += part.height_m
    return [Drawing(WIDTH_M, HEIGHT_M, tuple(shapes)) for shapes in pages]


def _parts(block: Block) -> Iterator[Drawing]:
    """Yield what may stand on different pages: lines of text, rows of a table, drawings."""
    if isinstance(block, Drawing):
        yield block
        return
    size_m = CELL_M
    if isinstance(block, str):
        size_m = HEADING_M if block.startswith(HEADING) else TEXT_M
        characters = int(INNER_M / (DIGIT_WIDTH * size_m))
        block = [(line,) for line in textwrap.wrap(block.removeprefix(HEADING), characters)]
    columns = range(max(map(len, block)))
    widths_m = [size_m + max(text_width_m(row[at], size_m) for row in block if at < len(row)) for at in columns]
    for row in block:
        texts = (Text(sum(widths_m[:at]), size_m, text, size_m) for at, text in enumerate(row))
        yield Drawing(INNER_M, LINE * size_m, tuple(texts))
    yield Drawing(INNER_M, TEXT_M / 2, ())
