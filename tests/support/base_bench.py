"""A serial base on a bench, with its emulated board and its robot; and the wire vectors of vendors and firmware."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from msgspec import Struct

from stadimeter.bases.serial_base import SerialBase
from stadimeter.config.plugins import BASES, PORTS, DriverContext, load_driver
from stadimeter.core.command import BaseReport, TwistCommand
from stadimeter.errors import DriverError
from stadimeter.simulation.world import World, WorldOptions
from stadimeter.testing.rig import ManualClock

# The wire vectors of `tests/bases/base_vectors.json`: as vendors and firmware have them.

_FILE = Path(__file__).parents[1] / "bases" / "base_vectors.json"
_ALL: list[dict[str, Any]] = json.loads(_FILE.read_text("utf-8"))["vectors"]


def vectors(protocol: str, direction: str | None = None, *, valid: bool | None = None) -> dict[str, dict[str, Any]]:
    """Return the vectors of a protocol by name: all, those to the base (``tx``), or those from it (``rx``)."""
    return {
        vector["name"]: vector
        for vector in _ALL
        if vector["protocol"] == protocol and direction in {None, vector["direction"]}
        if valid in {None, vector["valid"]}
    }


def wire(protocol: str, name: str) -> bytes:
    """Return the bytes of a vector."""
    return bytes.fromhex(vectors(protocol)[name]["bytes_hex"])


# A serial base on a bench: its driver, the emulated board behind a real pseudo-terminal, and the robot it moves.

TICKS_PER_METRE = 1440 / (math.pi * 0.065)
TICK_S = 0.01
LOOP_S = 0.05


class BaseBench(Struct, frozen=True):
    """One base, its emulated board, and a clock that tests move.

    Attributes:
        board: The emulated board; its firmware has the knobs for faults of its protocol.
    """

    clock: ManualClock
    context: DriverContext
    world: World
    driver: str
    board: Any

    @property
    def firmware(self) -> Any:
        """The program of the emulated board."""
        return self.board.firmware

    def base(self, **table: Any) -> SerialBase:
        """Return a driver that is not open, with this table in the configuration."""
        port = {"port": f"emulated-{self.driver}"}
        built: SerialBase = load_driver(BASES, self.driver).model_validate(port | table).build(self.context)
        return built

    def drive(self, base: SerialBase, linear_mps: float, angular_radps: float = 0.0, seconds: float = 1.0) -> None:
        """Command a motion as the loop does: fresh 20 times a second, with ticks in between."""
        for _ in range(round(seconds / LOOP_S)):
            self.command(base, linear_mps, angular_radps)
            self.pass_time(base, LOOP_S)

    def command(self, base: SerialBase, linear_mps: float, angular_radps: float = 0.0) -> TwistCommand:
        """Command a motion once, on a frame of this moment."""
        now_s = self.clock.now_s()
        return base.apply(
            TwistCommand(output="base", linear_mps=linear_mps, angular_radps=angular_radps, captured_at_s=now_s)
        )

    def pass_time(self, base: SerialBase, seconds: float) -> None:
        """Let time pass with ticks."""
        for _ in range(round(seconds / TICK_S)):
            self.clock.advance_s(TICK_S)
            base.tick(self.clock.now_s())

    def report(self, base: SerialBase) -> BaseReport:
        """Return what the base has reported, which must be something."""
        report = base.report()
        assert report
        return report

    @property
    def wheels_mps(self) -> tuple[float, float]:
        """How fast the wheels of the robot turn."""
        return self.world.robot.wheels_mps

    @property
    def stands(self) -> bool:
        """Whether they do not."""
        return max(map(abs, self.wheels_mps)) < 1e-3


@contextmanager
def base_bench(driver: str) -> Iterator[BaseBench]:
    """Set up a bench for the driver of that name, and clear it away."""
    clock = ManualClock()
    context = DriverContext(name="base", clock=clock)
    world = World(WorldOptions(track_width="16 cm", ticks_per_metre=TICKS_PER_METRE), clock)
    context.share("world", lambda: world)
    port: Any = load_driver(PORTS, f"emulated-{driver}")
    yield BaseBench(clock=clock, context=context, world=world, driver=driver, board=port.board(context))
    for close in reversed(context.shared.closers):
        close()


@contextmanager
def opened(bench: BaseBench, **table: Any) -> Iterator[SerialBase]:
    """Open a base, and close it at the end even if its link is gone."""
    base = bench.base(**table)
    base.open()
    try:
        yield base
    finally:
        with suppress(DriverError):
            base.close()
