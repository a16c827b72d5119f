import pytest

from my_package.line_bot import LineBotOptions
from stadimeter.config.plugins import DriverContext
from stadimeter.simulation.emulated_base import EmulatedFirmware
from stadimeter.simulation.emulated_base import EmulatedPort
from stadimeter.testing.base_contract import SILENT, TAKES_NO_BYTES, UNPLUGGED, BaseContract, BaseRig, clog, is_locked
from stadimeter.testing.rig import ManualClock

TICK_S = 0.02
TRACK_WIDTH_M = 0.2


class Firmware(EmulatedFirmware):
    """The robot's program: it answers, and stops by itself after 0.4 s."""

    def __init__(self):
        super().__init__()
        self.timeout_s, self.line = 0.4, b""

    def _take(self, data):
        *lines, self.line = (self.line + data).split(b"\n")
        return b"".join(self.obey(*line.split()) for line in lines if line)

    def obey(self, letter, *speeds):
        if letter != b"w" or len(speeds) != 2:
            return b"no\n"
        self._drive(*(int(speed) / 1000 for speed in speeds))
        return b"ok\n"

    def motion(self):
        left_mps, right_mps = self.left.speed_mps, self.right.speed_mps
        return (left_mps + right_mps) / 2, (right_mps - left_mps) / TRACK_WIDTH_M


class TestLineBot(BaseContract):
    @pytest.fixture
    def make_rig(self):
        clock, firmware, cable = ManualClock(), Firmware(), {"is_in": True}
        port = EmulatedPort(firmware, clock, is_plugged=lambda: cable["is_in"])

        def pull(begins):
            cable["is_in"] = not begins
            clock.advance_s(TICK_S)

        def rig():
            context = DriverContext(name="base", clock=clock)
            return BaseRig(
                device=LineBotOptions(port=port.path, track_width="20 cm").build(context),
                clock=clock,
                is_held=lambda: is_locked(port.path),
                motion=firmware.motion,
                faults={
                    UNPLUGGED: pull,
                    SILENT: lambda begins: setattr(firmware, "silent", begins),
                    TAKES_NO_BYTES: lambda begins: clog(port, begins=begins),
                },
            )

        yield rig
        port.close()
