"""Gains of rules that follow, against the delay from the picture to the wheels."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.config.draft import Draft
from stadimeter.config.findings import Finding
from stadimeter.config.plugins import StatesLatency
from stadimeter.core.rules.follow import GAIN_SHARE
from stadimeter.core.rules.own_motion import RESPONSE_S

# The age of a frame of a camera without a stated latency when it is acted on: exposure, transfer and one period.
USUAL_AGE_S = 0.05


def loop_findings(draft: Draft, share: float, up_to: float, code: str, says: str) -> Iterator[Finding]:
    """Find gains of follow rules that are too much for the delay from the picture to the wheels.

    Args:
        share: Gain times delay above which it is one.
        up_to: And not above this.
        says: What comes of it.
    """
    options = draft.camera.options if draft.camera is not None else None
    latency_s = options.frame_latency_s() if isinstance(options, StatesLatency) else 0.0
    usual_s = max(latency_s, USUAL_AGE_S) + RESPONSE_S
    for name, rule in draft.rules.items():
        for key, attribute in (("gain", "gain_per_s"), ("turn_gain", "turn_gain_per_s")):
            gain_per_s = getattr(rule.follow, attribute, None)
            if rule.follow is None or gain_per_s is None:
                continue
            delay_s = rule.follow.delay_s or usual_s
            if share < gain_per_s * delay_s <= up_to:
                message = f"{key} {gain_per_s:g} with {1e3 * delay_s:.0f} ms from the picture to the wheels: {says}"
                hint = f"leave it out, or write {GAIN_SHARE / delay_s:.2g}"
                yield Finding(("rules", name, "follow", key), message, hint, code)
