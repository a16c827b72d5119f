"""The list of what must be switched off when the program is gone, for ``safe-outputs``, which systemd runs then.

A killed program leaves its pins as they were. So each run writes, before it opens an output, which pins and which ports
its configuration has, so there is no second list. The file is in the runtime folder, which is in memory.
``safe-outputs`` runs as root, and this file is ours: it takes nothing from it but the lines below, checked again.

    pin NUMBER low|high          the GPIO's level at which what hangs on it is off
    serial PORT BAUD HEX         the bytes that stop what listens there
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from stadimeter.app.service_folders import runtime_directory
from stadimeter.config.atomic_file import holds, write_atomically
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice, StopsByBytes, marked_options
from stadimeter.config.units import PinMark, PortMark

NAME = "safe-outputs.conf"

FRAME_BYTES_MAX = 64
_PORT = re.compile(r"/dev/[\w./:+-]+")


def safe_outputs_path(environ: Mapping[str, str] = os.environ) -> Path | None:
    """Return where the list belongs, in the ``$RUNTIME_DIRECTORY`` of a service; None outside a service."""
    folder = runtime_directory(environ)
    return folder / NAME if folder is not None else None


def write_safe_outputs(configuration: Configuration, path: Path) -> list[str]:
    """Write the list, if it is not there already; return what nothing can switch off, a line each."""
    real = [output for output in configuration.driven if not output.is_simulated]
    lines = {output.name: tuple(safe_lines(output)) for output in real}
    text = "".join(f"{line}\n" for each in lines.values() for line in each).encode()
    try:
        if not holds(path, text):
            write_atomically(path, text)
    except OSError as error:
        return [f"{path} cannot be written, so nothing is switched off if this process is killed: {error.strerror}"]
    on_ports = [output.name for output in real if any(marked_options(output.options, PortMark))]
    return [
        f"{name}: nothing but itself stops it if this process is killed: its driver gives no bytes that do"
        for name in on_ports
        if not any(line.startswith("serial") for line in lines[name])
    ]


def safe_lines(output: DriverChoice) -> Iterator[str]:
    """Yield the lines for one output: each of its pins, and its port if its driver knows what stops it."""
    off = "low" if getattr(output.options, "active_high", True) else "high"
    yield from (f"pin {pin} {off}" for _, pin in marked_options(output.options, PinMark) if isinstance(pin, int))
    stop = output.options.serial_stop() if isinstance(output.options, StopsByBytes) else None
    if stop is not None and 0 < len(stop.frame) <= FRAME_BYTES_MAX and _PORT.fullmatch(stop.port):
        yield f"serial {stop.port} {stop.baud} {stop.frame.hex()}"
