"""The alphabet of faults: what goes wrong in a proof, and for how long each time."""

from __future__ import annotations

from msgspec import Struct

FOR_EVER_S = float("inf")

# By its name, for how many seconds a fault lasts.
LASTS_S = {
    "block-camera": 1.0,  # no frame comes, and reading times out
    "hang-camera": 1.0,  # reading does not return
    "lose-camera": 1.0,  # reading fails, and so does opening the camera again
    "repeat-frame": 1.0,  # the same frame comes again, with its old stamp
    "freeze-picture": 1.0,  # the same picture comes with fresh stamps
    "cycle-pictures": 1.0,  # the last pictures come in turn, with fresh stamps
    "stand-still-stamps": 1.0,  # new pictures come with the stamp of the last one
    "future-stamps": 1.0,  # stamps are 5 s in the future
    "broken-stamps": 1.0,  # stamps are no numbers
    "late-frames": 1.0,  # frames are 0.6 s old when they come, and say so
    "slow-camera": 1.0,  # frames come 3 times a second
    "hide-target": 1.0,  # the target is hidden
    "break-distance": 1.0,  # the measured distance is no number
    "hang-loop": 1.5,  # the control loop hangs while it looks at a picture
    "slow-loop": 1.0,  # each look at a picture takes 0.15 s
    "fail-in-loop": FOR_EVER_S,  # a defect raises an error in the control loop
    "stop-process": 0.6,  # SIGSTOP, or the computer sleeps
    "hang-process": 3.0,  # the same for longer than the watchdog process waits
    "end-process": FOR_EVER_S,  # SIGTERM
    "kill-process": FOR_EVER_S,  # SIGKILL, and nothing restarts it
    "unplug-base": 0.5,  # the cable to the base is out
    "cut-cable": FOR_EVER_S,  # the cable to the base is out for good
    "deafen-base": 0.3,  # what the base is sent is lost, and it answers nothing
    "mute-base": 1.0,  # what the base answers is lost
    "garble-answers": 1.0,  # noise comes among the answers of the base
    "reset-base": 0.5,  # the base starts again, which takes it as long
    "flip-bits": 1.0,  # one bit in every seventh byte to the base arrives wrong
    "hold-bus": 0.3,  # something holds the I2C bus, so that every transfer to the base times out
    "silence-sensors": 1.0,  # the range sensors answer nothing
    "kill-watchdog": FOR_EVER_S,  # SIGKILL of the watchdog process; nothing may move before a person starts a new one
    "lose-broker": 2.0,  # the message broker is gone
}

UNPLUGS = frozenset({"unplug-base", "cut-cable"})

# These go wrong on a line to a board with a program of its own.
NEEDS_FIRMWARE = frozenset({"deafen-base", "mute-base", "garble-answers", "reset-base", "flip-bits"})

# After these nothing moves the base any more.
FINAL = frozenset({"cut-cable", "kill-process", "end-process", "fail-in-loop"})

# Only tried by name: on a line without a checksum a command with a wrong bit may be a valid one for any speed.
BY_NAME = frozenset({"flip-bits"})

# From these the watchdog process protects.
STOPS_PROCESS = frozenset({"stop-process", "hang-process", "kill-process"})

# While one of these lasts, no frame is a new picture with a sound stamp.
SPOILS_STAMPS = frozenset({"repeat-frame", "stand-still-stamps", "future-stamps", "broken-stamps", "late-frames"})
SPOILS_FRAMES = SPOILS_STAMPS | {"freeze-picture", "cycle-pictures"}


class PlannedFault(Struct, frozen=True, order=True):
    """A fault that begins ``at_s`` seconds after the start of the run."""

    at_s: float
    fault: str

    def __str__(self) -> str:
        """Return its name and its moment."""
        return f"{self.fault} at {self.at_s:.2f} s"


FaultSequence = tuple[PlannedFault, ...]
