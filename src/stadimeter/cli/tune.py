"""The command ``tune``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from stadimeter.app.recordings.journal import load_recorded
from stadimeter.cli.exits import NOT_FOUND, plain_errors, working
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.units import parse_duration, parse_speed
from stadimeter.core.clock import DAY_S
from stadimeter.core.rule import OnDelay
from stadimeter.core.words import rounded_duration
from stadimeter.workbench.replay.replay import read_recording
from stadimeter.workbench.tuning.noise import Series, series_of
from stadimeter.workbench.tuning.proposing import (
    FLAPS_A_MINUTE,
    Beginning,
    Ending,
    Proposal,
    Settings,
    Tuned,
    rule_to_tune,
    tune,
)

# A target that was at its threshold for this share of the time is reported: raises there look like false alarms.
AT_THRESHOLD_TOLD = 0.05


def tune_command(
    rule: Annotated[str, typer.Argument(metavar="RULE", help="The rule: an alarm on a distance.")],
    recordings: Annotated[
        list[Path], typer.Argument(metavar="RECORDING", help="What `run --journal` or `run --record` recorded.")
    ],
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="CONFIG", help="The configuration with the rule; else that of the recording."),
    ] = None,
    false_alarms_per_day: Annotated[
        float,
        typer.Option("--false-alarms-per-day", min=1e-3, max=1e4, metavar="N", help="Accepted false alarms."),
    ] = 1.0,
    closing_speed: Annotated[
        str, typer.Option("--closing-speed", metavar="SPEED", help="Speed of an approaching target, for latency.")
    ] = "2 m/s",
    events: Annotated[
        list[str] | None,
        typer.Option(
            "--event",
            metavar="TIME",
            help='Time of a true alarm, such as "42 s" after the beginning of the recording, besides the times when '
            "the target had clearly crossed the threshold. May be given more than once.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Other random numbers.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, with all that was tried.")] = False,
) -> None:
    """Propose the probability, delays and hysteresis of an alarm, from recordings.

    Tries some dozens of settings on the noise of the recordings: false alarms a day while the target stands where it
    mostly stood, latency for a target that approaches, chattering at the threshold, and the time until the alarm ends.
    Proposes the settings with the least latency that keep to the wanted false alarms a day. States which rate the
    recordings alone support, and which one rests on the noise going on as it was. Changes nothing by itself.

    **Examples**

    - `stadimeter tune near quiet.jsonl --false-alarms-per-day 1`

    - `stadimeter tune near quiet.jsonl --config config/distance-alert.toml`

    **Exit code**: 0 done; 1 no setting keeps to the wanted rate, the best is printed; 2 an error in what was given.
    """
    with plain_errors():
        speed_mps = _speed(closing_speed)
        configuration = load_configuration(config) if config is not None else _recorded_configuration(recordings[0])
        with working("reading the recording") as say:
            tuned, series = _read(configuration, rule, recordings)
            say(f"trying settings of '{rule}'")
            proposal = tune(
                tuned,
                configuration.plan,
                series,
                wanted_a_day=false_alarms_per_day,
                speed_mps=speed_mps,
                events_s=_events(events or [], series),
                seed=seed,
            )
        if as_json:
            typer.echo(json.dumps(_figures(proposal), ensure_ascii=False))
        else:
            _tell(proposal, configuration)
    if not proposal.is_reached:
        raise typer.Exit(NOT_FOUND)


def _recorded_configuration(path: Path) -> Configuration:
    return load_recorded(read_recording(path).header.recorded_configuration, path)


def _speed(text: str) -> float:
    try:
        speed_mps = parse_speed(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--closing-speed") from error
    if speed_mps <= 0:
        raise typer.BadParameter(f"{text!r} is not above zero", param_hint="--closing-speed")
    return speed_mps


def _events(texts: Sequence[str], series: Sequence[Series]) -> list[float]:
    if texts and len(series) > 1:
        raise typer.BadParameter("with several recordings, it is not clear in which", param_hint="--event")
    try:
        return [_event_s(text, series[0]) for text in texts]
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--event") from error


def _event_s(text: str, series: Series) -> float:
    after_s, lasts_s = parse_duration(text), float(series.times_s[-1] - series.times_s[0])
    if after_s > lasts_s:
        raise ValueError(f"{text!r} is after the end of the recording, which is {lasts_s:.1f} s long")
    return float(series.times_s[0]) + after_s


def _read(configuration: Configuration, name: str, paths: Sequence[Path]) -> tuple[Tuned, list[Series]]:
    tuned = rule_to_tune(configuration, name)
    condition = tuned.condition
    series = [series_of(read_recording(path), condition.target, condition.quantity) for path in paths]
    return rule_to_tune(configuration, name, _typical_m(series)), series


def _typical_m(series: Sequence[Series]) -> float | None:
    seen = sorted(figure_m for each in series for figure_m in each.figures_m.tolist() if math.isfinite(figure_m))
    return seen[len(seen) // 2] if seen else None


def _tell(proposal: Proposal, configuration: Configuration) -> None:
    for line in _noise(proposal, configuration):
        typer.echo(line)
    console = Console()
    console.print(_begin_table(proposal))
    console.print(_end_table(proposal))
    for line in (*_toml(proposal), *_tracking_toml(proposal, configuration), "", *_claims(proposal)):
        typer.echo(line)


def _noise(proposal: Proposal, configuration: Configuration) -> Iterator[str]:
    noise, tuned, standing = proposal.noise, proposal.tuned, proposal.points
    threshold_m, correlation = tuned.threshold_m, configuration.plan.tracking.autocorrelation
    recorded, calm, quiet = map(rounded_duration, (noise.recorded_s, noise.calm_s, standing.quiet_s))
    yield (
        f"Recorded: {recorded}, {1 / noise.frame_s:.0f} frames a second; '{tuned.condition.target}' steady for {calm} "
        f"of it. Without a true alarm: {quiet}, median distance {standing.median_m:.2f} m, "
        f"{standing.clearances.min():.1f} standard deviations or more from the threshold {threshold_m:.2f} m."
    )
    yield (
        f"Noise: ± {noise.true_m(threshold_m):.3f} m at {threshold_m:.2f} m, {noise.ratio:.2f} times what is stated; "
        f"correlation from frame to frame {noise.correlation:.2f} ([tracking] has {correlation:.2f}); "
        f"outliers {100 * noise.gross:.1f} % of measurements; no measurement in {100 * noise.missing:.1f} % of frames."
    )


def _begin_table(proposal: Proposal) -> Table:
    table = Table(title="When it begins", title_justify="left")
    for heading in ("", "probability", "on-delay"):
        table.add_column(heading)
    for heading in ("false alarms a day", "at most (95 %)", "in the recordings", "mean latency", "p95 latency"):
        table.add_column(heading, justify="right")
    for each in worth_showing(proposal):
        table.add_row(
            _mark(proposal.is_reached and each is proposal.begin, each is proposal.beginnings[0]),
            _probability(each.settings),
            _on_delay_in_words(each.settings.on_delay),
            _a_day(each.rate.a_day),
            _a_day(each.rate.at_most_a_day),
            str(each.recorded_raises),
            f"{each.late_s:.3f} s",
            f"{each.late_p95_s:.3f} s",
        )
    return table


def worth_showing(proposal: Proposal) -> list[Beginning]:
    """Return the settings that no others beat in both figures, the rule's own and the proposed; earliest first."""
    kept: list[Beginning] = []
    least = float("inf")
    for each in sorted(proposal.beginnings, key=lambda each: (each.late_s, each.rate.a_day)):
        is_best = each.rate.a_day < least
        if is_best or each is proposal.begin or each is proposal.beginnings[0]:
            kept.append(each)
        least = min(least, each.rate.a_day)
    return kept


def _end_table(proposal: Proposal) -> Table:
    table = Table(title="When it ends", title_justify="left")
    for heading in ("", "hysteresis", "off-delay"):
        table.add_column(heading)
    for heading in ("chatters a minute at the threshold", "ends after"):
        table.add_column(heading, justify="right")
    for each in sorted(proposal.endings, key=lambda each: (each.settings.deadband_sigmas, each.settings.off_delay_s)):
        table.add_row(
            _mark(proposal.is_reached and each is proposal.end, each is proposal.endings[0]),
            f"{each.settings.deadband_sigmas:g} σ",
            f"{each.settings.off_delay_s:g} s",
            f"{each.flaps_a_minute:.2f}",
            f"{each.ends_after_s:.2f} s",
        )
    return table


def _mark(is_proposed: bool, is_own: bool) -> str:
    return "→" if is_proposed else "as it is" if is_own else ""


def _a_day(rate: float) -> str:
    if rate < 0.001:
        return "less than 0.001"
    return f"{rate:.2g}" if rate < 100 else f"{rate:.0f}"


def _probability(settings: Settings) -> str:
    return '"none"' if settings.probability is None else f"{settings.probability:g}"


def _toml(proposal: Proposal) -> Iterator[str]:
    """Yield the lines for the rule; none if no setting keeps to what was asked for."""
    if not proposal.is_reached:
        return
    settings, tuned = proposal.end.settings, proposal.tuned
    yield f"For [rules.{tuned.rule.name}]:"
    yield f"when = {{ {', '.join(_when(tuned, settings))} }}"
    yield f"on_delay = {_on_delay(settings.on_delay)}"
    yield f'off_delay = "{settings.off_delay_s:g} s"'


def _tracking_toml(proposal: Proposal, configuration: Configuration) -> Iterator[str]:
    """Propose what is better known from a recording than learnt anew in each run."""
    factor = proposal.noise.factor
    if factor not in (1.0, configuration.plan.tracking.noise_factor):
        yield "For [tracking], so that the noise need not be learnt anew in each run:"
        yield f"noise_factor = {factor:g}"


def _when(tuned: Tuned, settings: Settings) -> Iterator[str]:
    condition = tuned.condition
    if condition.above is not None and condition.below is not None:
        yield f'between = ["{condition.above:g} m", "{condition.below:g} m"]'
    elif condition.below is not None:
        yield f'below = "{condition.below:g} m"'
    else:
        yield f'above = "{condition.above:g} m"'
    if condition.quantity == "depth":
        yield 'of = "depth"'
    if condition.target != tuned.rule.target:
        yield f'target = "{condition.target}"'
    yield f"probability = {_probability(settings)}"
    if condition.probability_off != 0.5:
        yield f"probability_off = {condition.probability_off:g}"
    yield f"deadband_sigmas = {settings.deadband_sigmas:g}"
    if condition.deadband:
        yield f'deadband = "{condition.deadband:g} m"'


def _on_delay_in_words(delay: OnDelay) -> str:
    if delay.frames:
        return f"{delay.frames} of {delay.of_frames} frames"
    return f"{delay.hold_s:g} s" if delay.hold_s else "none"


def _on_delay(delay: OnDelay) -> str:
    return f"{{ frames = {delay.frames}, of = {delay.of_frames} }}" if delay.frames else f'"{delay.hold_s:g} s"'


def _claims(proposal: Proposal) -> Iterator[str]:
    begin, wanted = proposal.begin, proposal.wanted_a_day
    most = _a_day(begin.rate.at_most_a_day)
    rate = f"{_a_day(begin.rate.a_day)} false alarms a day, at most {most} with 95 % confidence"
    if proposal.is_reached:
        yield f"Expected: {rate}, if the noise goes on as it was recorded."
    else:
        yield (
            f"No setting that was tried is expected to keep to {wanted:g} false alarms a day, so none is proposed. The "
            f"best: {rate}. A threshold further from where the target stands, or less noise, would help."
        )
        if proposal.points.at_threshold >= AT_THRESHOLD_TOLD:
            yield (
                f"For {proposal.points.at_threshold:.0%} of the time without a true alarm the target was within one "
                "standard deviation of the threshold, where nothing shows whether an alarm is right: record it "
                "where it mostly stands, or mark the true alarms with --event."
            )
    if proposal.is_extrapolated:
        yield "The target stood further away than where false alarms could be counted; the figures are extrapolated."
    if not proposal.is_supported:
        needed, quiet = map(rounded_duration, (3.0 / wanted * DAY_S, proposal.points.quiet_s))
        yield (
            f"The recordings alone support no better than {_a_day(proposal.supported_a_day)} a day with 95 % "
            f"confidence: {begin.recorded_raises} in {quiet}. "
            f"For {wanted:g} a day, record {needed} without a true alarm."
        )
    if proposal.end.flaps_a_minute > FLAPS_A_MINUTE:
        yield "It chatters at the threshold with every setting that was tried; a fixed `deadband` would help."


def _figures(proposal: Proposal) -> dict[str, Any]:
    noise, points = proposal.noise, proposal.points
    return {
        "rule": proposal.tuned.rule.name,
        "limit_m": proposal.tuned.threshold_m,
        "wanted_a_day": proposal.wanted_a_day,
        "closing_speed_mps": proposal.speed_mps,
        "reached": proposal.is_reached,
        "supported_by_recordings": proposal.is_supported,
        "supported_a_day": proposal.supported_a_day,
        "extrapolated": proposal.is_extrapolated,
        "noise": {
            "recorded_s": noise.recorded_s,
            "calm_s": noise.calm_s,
            "frame_s": noise.frame_s,
            "sigma_at_limit_m": noise.true_m(proposal.tuned.threshold_m),
            "ratio_to_stated": noise.ratio,
            "proposed_noise_factor": noise.factor,
            "correlation": noise.correlation,
            "gross": noise.gross,
            "missing": noise.missing,
        },
        "quiet_s": points.quiet_s,
        "standing_m": points.median_m,
        "clearance_sigmas": float(points.clearances.min()),
        "proposed": _begin_figures(proposal.begin) | _end_figures(proposal.end),
        "toml": list(_toml(proposal))[1:],
        "beginnings": [_begin_figures(each) for each in proposal.beginnings],
        "endings": [_end_figures(each) for each in proposal.endings],
    }


def _begin_figures(each: Beginning) -> dict[str, Any]:
    delay = each.settings.on_delay
    return {
        "probability": each.settings.probability,
        "on_delay": {"frames": delay.frames, "of": delay.of_frames} if delay.frames else delay.hold_s,
        "false_alarms_a_day": each.rate.a_day,
        "at_most_a_day": each.rate.at_most_a_day,
        "in_the_recordings": each.recorded_raises,
        "late_s": each.late_s,
        "late_p95_s": each.late_p95_s,
    }


def _end_figures(each: Ending) -> dict[str, Any]:
    return {
        "deadband_sigmas": each.settings.deadband_sigmas,
        "off_delay_s": each.settings.off_delay_s,
        "flaps_a_minute": each.flaps_a_minute,
        "ends_after_s": each.ends_after_s,
    }
