"""The options of a run: what it records, and what it has beside its cycles. Loads little: `demo` greets soon."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from stadimeter.app.service import Service
    from stadimeter.config.models import WebTable

Seconds = Annotated[float | None, typer.Option("--seconds", min=0.0, metavar="S", help="End after this long.")]
Frames = Annotated[int | None, typer.Option("--frames", min=1, metavar="N", help="End after this many frames.")]
MIN_SPEED, MAX_SPEED = 1e-3, 1e6


def _check_speed(speed: float) -> float:
    if speed and not MIN_SPEED <= speed <= MAX_SPEED:
        raise typer.BadParameter(f"{speed:g} is neither 0 nor between {MIN_SPEED:g} and {MAX_SPEED:g}")
    return speed


Speed = Annotated[
    float,
    typer.Option(
        "--speed",
        callback=_check_speed,
        help="How fast recordings and simulations run: 1 is real time, 0 has no brake.",
    ),
]
Unit = Annotated[Literal["m", "cm", "ft", "in"], typer.Option("--unit", help="The unit to show distances in.")]
JournalFile = Annotated[
    Path | None, typer.Option("--journal", metavar="FILE", help="Record every cycle, for `stadimeter replay`.")
]
RecordFile = Annotated[
    Path | None,
    typer.Option(
        "--record", metavar="FILE.mcap", help="Record every cycle with its picture, for `replay` and for Foxglove."
    ),
]
RecordImages = Annotated[
    Literal["all", "events", "none"],
    typer.Option("--record-images", help="Which pictures --record takes: those of `events` show what changed."),
]
ImageRate = Annotated[
    float | None,
    typer.Option("--image-rate", min=0.01, metavar="HZ", help="Upper limit of recorded pictures a second."),
]
ImageQuality = Annotated[
    int,
    typer.Option("--image-quality", min=1, max=100, metavar="PERCENT", help="Quality of JPEGs; 95 measures best."),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """The files that a run writes. With `is_quiet`, trouble is printed at the end only: the view has shown it."""

    journal: Path | None = None
    record: Path | None = None
    images: Literal["all", "events", "none"] = "all"
    image_rate_hz: float | None = None
    image_quality_percent: int = 90
    is_quiet: bool = False


StateFile = Annotated[
    Path | None,
    typer.Option(
        "--state",
        metavar="FILE",
        help="Where alarms are remembered beyond the end of the run. A live camera has one by itself.",
    ),
]
NoState = Annotated[bool, typer.Option("--no-state", help="Remember nothing beyond the end of the run.")]
SocketFile = Annotated[
    Path | None,
    typer.Option("--socket", metavar="PATH", help="Where to listen for `stadimeter alarm ack`, `reload` and the like."),
]
TrustClock = Annotated[
    bool,
    typer.Option("--trust-clock", help="Take the computer's clock for right, though no time server vouches for it."),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceOptions:
    """Optional services of a run: alarm store, control socket, page.

    Attributes:
        state: The state file; None for the usual one.
        no_state: Whether there shall be none.
        socket: Where to listen; None for the usual place.
        trust_clock: Whether the computer's clock counts as right.
        is_unhurried: Whether the run takes time, so that operator commands can arrive meanwhile.
        is_quiet: Whether nothing is printed about it while it runs: the screen is in use.
        service: What tells systemd of the run; None if systemd does not wait for that.
        web: The page to have beside it; None for that of its configuration.
    """

    state: Path | None = None
    no_state: bool = False
    socket: Path | None = None
    trust_clock: bool = False
    is_unhurried: bool = True
    is_quiet: bool = False
    service: Service | None = None
    web: WebTable | None = None
