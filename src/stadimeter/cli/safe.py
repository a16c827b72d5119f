"""The command ``safe``: makes the outputs of a configuration safe by hand, without a run."""

from __future__ import annotations

import typer

from stadimeter.app.control.client import find
from stadimeter.app.service import held_lines
from stadimeter.cli.exits import WRONG, ConfigArgument, configuration_path, plain_errors
from stadimeter.config.loader import load_configuration
from stadimeter.errors import ControlError, DriverError
from stadimeter.watchdog.plan import SafePlan
from stadimeter.watchdog.stops import make_safe


def safe(config: ConfigArgument = None) -> None:
    """Make every output of a configuration safe by hand, when no run drives it.

    Drives pins to the level at which they are off, and sends bases and boards what stops them: the same that the
    watchdog process of a run does when the run dies. Nothing else of the configuration is opened. Opening a serial port
    resets most Arduinos, which stops their motors too.

    While a run of CONFIG goes on, this is refused, since both would drive the outputs: `stadimeter stop-outputs`.

    **Examples**

    - `stadimeter safe config/follow-ball.toml`

    **Exit code**: 0 every output is safe; 2 one is not, a run drives them, or the configuration is wrong.
    """
    with plain_errors():
        path = configuration_path(config)
        configuration = load_configuration(path, with_tests=False)
        try:
            socket = find(path)
        except ControlError:  # none runs, or none that could be asked
            pass
        else:
            raise DriverError(f"a run drives these outputs (it listens at {socket}): use `stadimeter stop-outputs`")
        lines = held_lines(configuration)
        plan = SafePlan(lines)
        troubles = [*plan.complaints, *make_safe(plan)]
        for trouble in troubles:
            typer.echo(f"error: {trouble}", err=True)
        if troubles:
            raise typer.Exit(WRONG)
        typer.echo("\n".join(f"safe: {line}" for line in lines) or "nothing to do: every output is simulated")
