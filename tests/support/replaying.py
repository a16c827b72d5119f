"""A recording decided again and compared, as the command ``replay`` does it."""

from typing import NamedTuple

from stadimeter.cli.replay import Replay
from stadimeter.core.decision import Event
from stadimeter.workbench.replay import decisions
from stadimeter.workbench.trial import Trial


class Compared(NamedTuple):
    """The cycles of a replay, how many of them are as recorded, and the events now and then."""

    cycles: int
    identical: int
    events: list[Event]
    recorded_events: list[Event]


def replay(recording, plan):
    """Return how decisions by a plan compare with the recorded ones."""
    found, recorded = Replay(trial=Trial(plan=plan)), []
    for cycle, observation, decision in decisions(recording, plan):
        found.add(cycle, observation, decision)
        recorded += cycle.decision().events
    return Compared(found.trial.cycles, found.identical, found.trial.events, recorded)
