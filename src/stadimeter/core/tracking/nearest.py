"""The nearest and the farthest of several targets of one kind, each a target of its own for rules.

It is the track of one member, under another name. It stays the same one until another member is surely nearer, so two
that are about as far away do not make it leap from frame to frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.tracking.life_cycle import TrackState

# Another member takes over when it is nearer by this many standard deviations of the difference: with 2, noise alone
# does so in 2 of 100 frames in which both are as far away.
SURELY_SIGMAS = 2.0


class NearestOf(Struct, frozen=True, kw_only=True):
    """A target that stands for the nearest of several, or the farthest.

    Attributes:
        members: The targets that it is one of.
        is_farthest: Whether it is the farthest.
    """

    name: str
    members: tuple[str, ...]
    is_farthest: bool = False


def step_nearest(which: NearestOf, before: TrackState, tracked: Sequence[TrackState], now_s: float) -> TrackState:
    """Return the state of the target after a cycle.

    Args:
        tracked: Every target after the cycle, its members among them.
        now_s: The run's monotonic clock.
    """
    members = [each for each in tracked if each.track.target in which.members]
    seen = [each for each in members if each.track.is_valid and each.track.distance_m is not None]
    same = next((each for each in members if each.track.target == before.member), members[0])
    chosen = same
    if seen:
        best = min(seen, key=lambda each: _order_m(which, each))
        chosen = same if same in seen and not _is_surely_before(which, best, same) else best
    # While none is in sight, it is as it was lost; since when is its own, whichever member it was.
    track = replace(chosen.track, target=which.name)
    if before.track.since_s is not None and before.track.is_valid is track.is_valid:
        track = replace(track, since_s=before.track.since_s)
    else:
        track = replace(track, since_s=now_s)
    return replace(chosen, track=track, member=chosen.track.target)


def _order_m(which: NearestOf, state: TrackState) -> float:
    distance_m = state.track.distance_m or 0.0
    return -distance_m if which.is_farthest else distance_m


def _is_surely_before(which: NearestOf, one: TrackState, other: TrackState) -> bool:
    sigma_m = math.hypot(one.track.noise_m or 0.0, other.track.noise_m or 0.0)
    return _order_m(which, other) - _order_m(which, one) > SURELY_SIGMAS * sigma_m
