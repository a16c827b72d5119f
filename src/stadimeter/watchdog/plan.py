"""A plan that makes every output safe: a list of lines, read with suspicion.

Root reads such a list that another user's program has written, so nothing more is taken from it than this:

    pin NUMBER [low|high]             drive this GPIO (BCM number 0 to 27) to the level at which it is off: low
    serial PORT [BAUD [HEX]]          send at most 64 bytes; else what stops ros_arduino_bridge, at 57600
    i2c BUS ADDRESS HEX[,HEX…]        write to a device on /dev/i2c-BUS: at most 16 transfers of at most 32 bytes
    # words                           a comment, also at the end of a line

Of two lines on one pin the last counts. A line that cannot be used keeps no other one from being used.
"""

from __future__ import annotations

import os

PINS_MAX = 28
STOPS_MAX = 16
FRAME_BYTES_MAX = 64
I2C_WRITES_MAX = 16
I2C_WRITE_BYTES_MAX = 32
LIST_BYTES_MAX = 1_000_000
COMPLAINTS_MAX = 20

# The first CR ends a command that the program may have begun before it was killed; the stop would be lost in it.
ROS_ARDUINO_STOP = b"\rm 0 0\r".hex()

NO_LIST = "no list of outputs: nothing was switched off"

# Editors end lines with CR, mark the beginning (BOM) or widen letters (UTF-16).
_OF_EDITORS = b"\0\xfe\xff\xef\xbb\xbf"


class SafePlan:
    """A plan of what to do to which output.

    Attributes:
        pins: By number, whether the level at which it is off is high.
        serial: By port, the words of each of its lines: baud and bytes in hexadecimal digits. Ports are checked when
            they are opened.
        i2c: Bus, address and transfers of each device, in order.
        complaints: What was refused, in words.
    """

    def __init__(self, lines: list[str]) -> None:
        self.pins: dict[int, bool] = {}
        self.serial: dict[str, list[tuple[str, str]]] = {}
        self.i2c: list[tuple[int, int, list[bytes]]] = []
        self.complaints: list[str] = []
        self._stops: set[tuple[str, ...]] = set()
        for line in lines:
            self._read(line)
        if (more := len(self.complaints) - COMPLAINTS_MAX) > 0:
            self.complaints[COMPLAINTS_MAX:] = [f"and so on, for {more} more lines"]

    def __bool__(self) -> bool:
        """Check whether there is anything to do."""
        return bool(self.pins or self.serial or self.i2c)

    def _read(self, line: str) -> None:
        words = line.partition("#")[0].split()
        if not words:
            return
        kinds = {"pin": self._add_pin, "serial": self._add_port, "i2c": self._add_device}
        if words[0] in kinds:
            kinds[words[0]](*words[1:4], *[""] * (4 - len(words)))
        else:
            self._refuse(f"'{line}': a line begins with pin, serial or i2c")

    def _add_pin(self, number: str, level: str, _rest: str) -> None:
        level = level or "low"
        pin = _number(number, PINS_MAX)
        if pin is None:
            self._refuse(f"pin '{number}': not the number of a GPIO, 0 to {PINS_MAX - 1}")
        elif level not in {"low", "high"}:
            self._refuse(f"pin {number}: '{level}' is neither low nor high")
        else:
            if self.pins.get(pin, level == "high") is not (level == "high"):
                self._refuse(f"pin {number}: two levels; the last, {level}, counts")
            self.pins[pin] = level == "high"

    def _add_port(self, port: str, baud: str, frame: str) -> None:
        line = (port, baud or "57600", frame or ROS_ARDUINO_STOP)
        if self._is_new(f"serial {port}", line):
            self.serial.setdefault(port, []).append(line[1:])

    def _add_device(self, bus: str, address: str, frames: str) -> None:
        at_bus, at = _number(bus, 100), _address(address)
        writes = [read_hex(each, I2C_WRITE_BYTES_MAX) for each in frames.split(",")[: I2C_WRITES_MAX + 1]]
        found = [each for each in writes if each is not None]
        if at_bus is None or at is None:
            self._refuse(f"i2c {bus} {address}: not a bus and an address from 0x03 to 0x77")
        elif len(found) < len(writes) or len(writes) > I2C_WRITES_MAX:
            self._refuse(
                f"i2c {bus} {address}: '{frames}' is not 1 to {I2C_WRITES_MAX} transfers of 1 to {I2C_WRITE_BYTES_MAX} "
                "bytes in small hexadecimal digits"
            )
        elif self._is_new(f"i2c {bus} {address}", ("i2c", bus, address, frames)):
            self.i2c.append((at_bus, at, found))

    def _is_new(self, name: str, line: tuple[str, ...]) -> bool:
        """Check whether a line on a port or bus is the first of its kind, and there is room for it."""
        if line in self._stops:
            return False
        self._stops.add(line)
        if len(self._stops) > STOPS_MAX:
            self._refuse(f"{name}: not stopped, there are {STOPS_MAX} other lines on ports before it")
        return len(self._stops) <= STOPS_MAX

    def _refuse(self, words: str) -> None:
        self.complaints.append("".join(each if " " <= each <= "~" else "?" for each in words)[:200])


def _number(text: str, below: int) -> int | None:
    """Return a small number; None if it is none, or as long as nothing here is."""
    return int(text) if text.isascii() and text.isdigit() and len(text) < 3 and int(text) < below else None


def _address(text: str) -> int | None:
    digits = text.removeprefix("0x")
    value = int(digits, 16) if len(digits) == 2 and not digits.strip("0123456789abcdef") else 0
    return value if digits != text and 0x03 <= value <= 0x77 else None


def read_hex(text: str, max_bytes: int) -> bytes | None:
    """Return the bytes that small hexadecimal digits stand for; None if they stand for none, or for too many."""
    is_hex = text and not text.strip("0123456789abcdef") and len(text) % 2 == 0
    return bytes.fromhex(text) if is_hex and len(text) <= 2 * max_bytes else None


def read_lists(paths: list[str]) -> tuple[list[str], list[str]]:
    """Read lists of outputs: those that are files and can be read, one after the other.

    Returns:
        Their lines, and what is wrong with them.
    """
    lines: list[str] = []
    complaints: list[str] = []
    is_any = False
    for path in paths:
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a named pipe is not waited for
            with open(descriptor, "rb") as file:  # noqa: PTH123 - pathlib would be a tenth of the process
                data = file.read(LIST_BYTES_MAX + 1) if os.fstat(descriptor).st_mode & 0o170000 == 0o100000 else None
        except OSError:
            data = None
        if data is None:
            continue
        is_any = True
        if len(data) > LIST_BYTES_MAX:
            complaints.append(f"{path} has more than {LIST_BYTES_MAX} bytes: what is beyond them is NOT switched off")
            data = data[:LIST_BYTES_MAX].rpartition(b"\n")[0]  # not the piece of a line
        text = data.replace(b"\r", b"\n").translate(None, _OF_EDITORS)
        lines += text.decode("latin-1").split("\n")
    if not is_any:
        complaints.append(NO_LIST)
    return lines, complaints
