"""The chart of `tune`: false alarms a day against latency, a dot for each setting that was tried."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from stadimeter.config.atomic_file import write_atomically
from stadimeter.config.extras import require
from stadimeter.core.rule import OnDelay
from stadimeter.errors import PictureError
from stadimeter.workbench.tuning.candidates import PROBABILITIES
from stadimeter.workbench.tuning.proposing import Beginning, Proposal

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0b6e4f", "#3d5a80", "#c8553d", "#8a6fa8", "#b08900")
MIN_A_DAY, MAX_A_DAY = 1e-4, 1e5
_FADED = 0.35


def require_matplotlib() -> None:
    """Raise DriverUnavailableError if charts cannot be drawn here."""
    require("plots", "the plot", "leave out --plot")


def draw_plot(proposal: Proposal, path: Path) -> None:
    """Draw a chart of the settings for when the alarm begins.

    Raises:
        DriverUnavailableError: The library matplotlib is not installed.
        PictureError: The file cannot be written.
    """
    require_matplotlib()
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra, and slow to load

    figure = Figure(figsize=(10, 5.5), dpi=120, layout="constrained")
    axes = figure.add_subplot()
    _draw_limits(axes, proposal)
    _draw_tried(axes, proposal.beginnings)
    _draw_marks(axes, proposal)
    _label(axes, proposal)
    drawn = BytesIO()
    figure.savefig(drawn, format="png", metadata={"Software": "stadimeter"})
    try:
        write_atomically(path, drawn.getvalue())
    except OSError as error:
        raise PictureError(f"{path}: the plot cannot be written: {error.strerror or error}") from error


def on_delay_in_words(delay: OnDelay) -> str:
    """Return an on-delay in words, such as ``3 of 5 frames``."""
    if delay.frames:
        return f"{delay.frames} of {delay.of_frames} frames"
    return f"{delay.hold_s:g} s" if delay.hold_s else "none"


def _draw_limits(axes: Axes, proposal: Proposal) -> None:
    axes.axhspan(MIN_A_DAY, proposal.wanted_a_day, color="#0b6e4f", alpha=0.10, linewidth=0)
    wanted = f"asked for: at most {proposal.wanted_a_day:g} a day"
    axes.axhline(proposal.wanted_a_day, color="#0b6e4f", linewidth=1.2, label=wanted)
    supported = f"the recordings alone support: {proposal.supported_a_day:.3g} a day"
    axes.axhline(proposal.supported_a_day, color="#888888", linewidth=1.2, linestyle=":", label=supported)


def _draw_tried(axes: Axes, tried: Iterable[Beginning]) -> None:
    delays: dict[OnDelay, list[Beginning]] = {}
    for each in tried:
        delays.setdefault(each.settings.on_delay, []).append(each)
    for (delay, some), colour in zip(delays.items(), COLOURS * len(delays), strict=False):
        in_order = sorted(some, key=lambda each: each.settings.probability or 0.0)
        late_s = [each.late_s for each in in_order]
        likely = [_within_axis(each.rate.a_day) for each in in_order]
        most = [_within_axis(each.rate.at_most_a_day) for each in in_order]
        axes.vlines(late_s, likely, most, color=colour, alpha=_FADED, linewidth=2)
        axes.plot(
            late_s,
            likely,
            "o-",
            color=colour,
            markersize=5,
            linewidth=0.8,
            label=f"on-delay: {on_delay_in_words(delay)}",
        )


def _draw_marks(axes: Axes, proposal: Proposal) -> None:
    now, begin = proposal.beginnings[0], proposal.begin
    axes.plot(
        now.late_s, _within_axis(now.rate.a_day), "s", markersize=13, markerfacecolor="none", markeredgecolor="black",
        markeredgewidth=1.4, linestyle="none", label=f"as it is: P {_probability(now)}",
    )  # fmt: skip
    axes.plot(
        begin.late_s, _within_axis(begin.rate.a_day), "*", markersize=20, markerfacecolor="#ffc145",
        markeredgecolor="black", markeredgewidth=1.2, linestyle="none", zorder=5,
        label=f"proposed: P {_probability(begin)}",
    )  # fmt: skip


def _probability(each: Beginning) -> str:
    probability = each.settings.probability
    return (
        f"{'none' if probability is None else f'{probability:g}'}, on-delay {on_delay_in_words(each.settings.on_delay)}"
    )


def _label(axes: Axes, proposal: Proposal) -> None:
    tuned = proposal.tuned
    axes.set_yscale("log")
    axes.set_ylim(MIN_A_DAY, MAX_A_DAY)
    axes.set_xlim(left=0)
    axes.set_xlabel(f"mean latency for a target at {proposal.speed_mps:g} m/s, in seconds")
    axes.set_ylabel("false alarms a day\n(dot: estimate; line: up to the 95 % limit)")
    side = "nearer than" if tuned.side > 0 else "further than"
    tried = f"Each dot is a probability threshold, {PROBABILITIES[0]:g} to {PROBABILITIES[-1]:g}"
    axes.set_title(f"'{tuned.rule.name}': {side} {tuned.threshold_m:g} m. {tried}", loc="left")
    axes.grid(color="#dddddd")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, labelspacing=0.9)


def _within_axis(a_day: float) -> float:
    return min(max(a_day, MIN_A_DAY * 1.3), MAX_A_DAY / 1.3)
