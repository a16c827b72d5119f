"""What people do to a simulated world while a run goes on: put its target somewhere, make something go wrong."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from stadimeter.app.control.messages import Reply, WorldArgs
from stadimeter.app.control.socket_server import Answer
from stadimeter.config.findings import did_you_mean_or_list

if TYPE_CHECKING:
    from stadimeter.simulation.protocol import StagedWorld


class Stage:
    """The simulated world of a run, for requests at its control socket."""

    def __init__(self, world: StagedWorld, targets: Collection[str]) -> None:
        self._world = world
        self._targets = targets

    def act(self, args: WorldArgs, answer: Answer) -> None:
        """Do what is asked for, and answer with what is where then."""
        problem = self._done(args)
        answer(Reply(error=problem) if problem else Reply(dict(self._world.state())))

    def _done(self, args: WorldArgs) -> str:
        """Do what is asked for; return why it cannot be done."""
        if args.target and args.target not in self._targets:
            return f"there is no target '{args.target}'; {did_you_mean_or_list(args.target, self._targets)}"
        if args.fault:
            known = self._world.state()["faults"]
            if args.fault not in known:
                return f"there is no fault '{args.fault}'; {did_you_mean_or_list(args.fault, known)}"
            self._world.toggle(args.fault)
        elif args.release:
            self._world.let_go()
        elif args.x_m is not None and args.y_m is not None:
            self._world.place_target(args.x_m, args.y_m)
        elif args.bearing_rad is not None and args.distance_m is not None:
            self._world.place_target(*self._world.in_world_m(args.bearing_rad, args.distance_m))
        else:
            return "a target is put at x_m and y_m, or at bearing_rad and distance_m; or name a fault, or say release"
        return ""
