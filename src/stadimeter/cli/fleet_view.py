"""The fleet as a screen of text: every device on a line, the worst first, and below them the standing alarms."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from datetime import datetime

from msgspec import Struct
from rich.console import Console, ConsoleOptions
from rich.text import Text

from stadimeter.cli.formatting import UNKNOWN, format_distance, format_time
from stadimeter.cli.layout import fit, heading
from stadimeter.workbench.fleet import STALE_S, Device, Fleet, StandingAlarm, age_s

_STATUS_STYLES = {"online": "green", "offline": "bold red", "silent": "bold red", "unknown": "yellow"}
_SEVERITY_STYLES = {"info": "cyan", "warning": "yellow"}
_STALE = "bright_black"
_DEVICES_MIN_ROWS = 3


class FleetScreen(Struct, frozen=True):
    """A fleet at one moment, as rich prints it.

    Attributes:
        place: The broker.
        trouble: What is wrong with the connection to it; then every figure is grey.
    """

    fleet: Fleet
    place: str
    trouble: str
    now_s: float

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Yield as many lines as there are rows."""
        yield from self.lines(options.max_width, options.height or console.height)

    def lines(self, width: int, height: int) -> list[Text]:
        """Return the screen: alarms get half of it if there are that many, devices the rest."""
        alarms = self.fleet.standing
        devices = sorted(self.fleet.devices.values(), key=self._rank)
        free = height - 3 - len(notes := self._notes())
        for_alarms = min(len(alarms) or 1, max(free // 2, free - len(devices)))
        shown_devices = [self._device(each, width) for each in devices[: max(0, free - for_alarms)]]
        shown_alarms = [self._alarm(each, width) for each in alarms[:for_alarms]]
        return [
            self._header(width),
            *notes,
            heading("devices", width, *_more(len(devices), len(shown_devices))),
            *shown_devices,
            heading("standing alarms", width, *_more(len(alarms), len(shown_alarms))),
            *(shown_alarms or [Text(" none" if not self.trouble else f" {UNKNOWN}", _STALE)]),
        ]

    def _header(self, width: int) -> Text:
        counts = Counter(device.status(self.now_s) for device in self.fleet.devices.values())
        words = ", ".join(f"{count} {status}" for status, count in counts.items()) or "no device heard yet"
        state = (f"NOT CONNECTED: {self.trouble}", "bold red") if self.trouble else (words, "bold")
        return fit(Text.assemble(f" {self.fleet.root} at {self.place}  ", state), width)

    def _notes(self) -> list[Text]:
        if not self.fleet.passed_over:
            return []
        return [Text(f" not all is shown: {self.fleet.passed_over} messages were passed over", "bold red")]

    def _rank(self, device: Device) -> tuple[bool, bool, str]:
        is_well = device.status(self.now_s) == "online"
        return is_well and not any(alarm.is_serious for alarm in device.standing.values()), is_well, device.name

    def _device(self, device: Device, width: int) -> Text:
        status = device.status(self.now_s)
        age = age_s(device.newest_s, self.now_s)
        standing = Text(f"{len(device.standing)} standing" if device.standing else "", "bold")
        standing.append(f" {len(device.unjudged)} unknown" if device.unjudged else "", "yellow")
        targets = Text("  ").join(self._target(device, name) for name in sorted(device.targets))
        targets.append(f"  {device.unreadable} unreadable" if device.unreadable else "", "red")
        columns = [
            (Text(device.name), max(12, width // 5)),
            (Text(status, _STALE if self.trouble else _STATUS_STYLES[status]), 8),
            (Text(UNKNOWN if age is None else f"{format_time(age)} ago"), 12),
            (Text(device.info.version), 10),
            (standing, 14),
        ]
        line = Text(" ").join([Text(""), *(fit(text, size) for text, size in columns), targets])
        return fit(self._greyed(line) if status != "online" else line, width)

    def _target(self, device: Device, name: str) -> Text:
        target = device.targets[name]
        age = age_s(target.at_s, self.now_s)
        is_stale = bool(self.trouble) or not device.is_online or age is None or age > STALE_S
        figure = target.status if target.distance_m is None else format_distance(target.distance_m, target.sigma_m)
        how_old = f" ({UNKNOWN if age is None else format_time(age)} old)" if is_stale else ""
        return Text(f"{name} {figure}{how_old}", _STALE if is_stale else "")

    def _alarm(self, alarm: StandingAlarm, width: int) -> Text:
        is_fresh = not self.trouble and self.fleet.devices[alarm.device].status(self.now_s) == "online"
        marks = ["" if alarm.is_acknowledged else "UNACKNOWLEDGED", *alarm.inhibits]
        line = Text.assemble(
            " ",
            (f"{alarm.severity or 'unknown':8}", _SEVERITY_STYLES.get(alarm.severity, "bold red")),
            f" {alarm.device}/{alarm.rule}  since {_local_time(alarm.since)}  ",
            (" ".join(filter(None, marks)), "bold"),
            f"  {alarm.reason}",
        )
        return fit(line if is_fresh and not alarm.inhibits else self._greyed(line), width)

    def _greyed(self, line: Text) -> Text:
        return Text(line.plain, _STALE)


def _local_time(text: str) -> str:
    """Return a device's time on this computer's clock; a dash for what is no time."""
    try:
        return datetime.fromisoformat(text).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError, OSError):
        return UNKNOWN


def _more(count: int, shown: int) -> tuple[tuple[str, str], ...]:
    return ((f"{count}, {count - shown} of them not shown", "yellow") if count > shown else (str(count), "dim"),)
