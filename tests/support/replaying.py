"""A recording decided again and compared, as the command ``replay`` does it."""

from stadimeter.workbench.replay.comparison import Comparison
from stadimeter.workbench.replay.replay import decisions


def replay(recording, plan):
    """Return how decisions by a plan compare with the recorded ones."""
    comparison = Comparison()
    for replayed in decisions(recording, plan):
        comparison.add(*replayed)
    return comparison.result
