"""Conditions on figures other than the distance, with the defaults of their tables in a configuration."""

from stadimeter.core.conditions.measured import FigureCondition


def closing(**fields):
    """A condition on the closing speed."""
    return FigureCondition(**{"quantity": "closing_speed", "deadband_sigmas": 2.0, "probability_on": 0.95, **fields})


def direction(quantity="bearing", **fields):
    """A condition on a direction, which is compared as it is."""
    alone = {"deadband": 0.02, "deadband_sigmas": 0.0, "probability_on": None}
    return FigureCondition(quantity=quantity, **{**alone, **fields})


def separation(targets, **fields):
    """A condition on how far two targets are from each other."""
    return FigureCondition(quantity="separation", target=targets[0], other=targets[1], **fields)


def still(for_s, **fields):
    """A condition on standing still."""
    alone = {"deadband_sigmas": 0.0, "probability_on": None}
    return FigureCondition(quantity="still", above=for_s, **{**alone, **fields})


def compared(quantity, target, other, **fields):
    """A condition on how a quantity of one target differs from that of another."""
    return FigureCondition(quantity=quantity, target=target, other=other, **fields)
