"""The writer of pins against what the kernel's header says, and against a kernel that is pretended."""

from __future__ import annotations

import errno
import os
import struct
import subprocess
from pathlib import Path

import pytest

from stadimeter.watchdog import gpio
from support.programs import require

HEADER = """
#include <stdio.h>
#include <stddef.h>
#include <linux/gpio.h>
int main(void) {
    struct gpio_v2_line_request request = {0};
    request.offsets[0] = 18;
    request.config.flags = GPIO_V2_LINE_FLAG_OUTPUT;
    request.config.num_attrs = 1;
    request.config.attrs[0].attr.id = GPIO_V2_LINE_ATTR_ID_OUTPUT_VALUES;
    request.config.attrs[0].attr.values = 1;
    request.config.attrs[0].mask = 1;
    request.num_lines = 1;
    printf("%zu %zu %zu ", sizeof(struct gpiochip_info), sizeof(struct gpio_v2_line_info), sizeof request);
    printf("%lu %lu %lu ", (unsigned long)GPIO_GET_CHIPINFO_IOCTL, (unsigned long)GPIO_V2_GET_LINEINFO_IOCTL,
           (unsigned long)GPIO_V2_GET_LINE_IOCTL);
    printf("%zu ", offsetof(struct gpio_v2_line_info, offset));
    for (size_t i = 0; i < sizeof request; i++) printf("%02x", ((unsigned char *)&request)[i]);
}
"""


class Kernel:
    """A kernel with chips that are files, by their labels, and pins of which one may be busy."""

    def __init__(self, folder: Path, *labels: str) -> None:
        self._labels = {f"gpiochip{number}": label for number, label in enumerate(labels)}
        for name in self._labels:
            (folder / name).touch()
        self.busy: set[int] = set()
        self.driven: list[tuple[str, int, int]] = []
        self.requests: list[bytes] = []

    def __call__(self, descriptor: int, request: int, answer: bytearray) -> int:
        chip = Path(f"/proc/self/fd/{descriptor}").readlink().name
        if request == gpio.GET_CHIP_INFO:
            answer[:] = gpio.CHIP_INFO.pack(chip.encode(), self._labels[chip].encode(), 54)
        elif request == gpio.GET_LINE:
            self.requests.append(bytes(answer))
            pin, value = struct.unpack_from("I", answer)[0], struct.unpack_from("Q", answer, 328)[0]
            if pin in self.busy:
                raise OSError(errno.EBUSY, "Device or resource busy")
            self.driven.append((chip, pin, value))
            struct.pack_into("i", answer, 588, os.open("/dev/null", os.O_RDONLY))
        return 0


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel(tmp_path, "gpio-brcmstb@107d508500", "pinctrl-rp1")
    monkeypatch.setattr(gpio.fcntl, "ioctl", kernel)
    monkeypatch.setattr(gpio, "TOOLS", ())
    return kernel


def test_what_it_asks_of_the_kernel_is_what_the_kernels_header_says(kernel: Kernel, tmp_path: Path) -> None:
    require("gcc")
    if not Path("/usr/include/linux/gpio.h").exists():
        pytest.skip("not installed: linux/gpio.h; sudo apt install linux-libc-dev")
    (tmp_path / "header.c").write_text(HEADER)
    subprocess.run(["gcc", "-o", tmp_path / "header", tmp_path / "header.c"], check=True)
    said = subprocess.check_output([tmp_path / "header"], text=True).split()
    sizes = [gpio.CHIP_INFO.size, gpio.LINE_INFO.size, gpio.LINE_REQUEST.size]
    assert said[:7] == [
        *map(str, sizes),
        *map(str, (gpio.GET_CHIP_INFO, gpio.GET_LINE_INFO, gpio.GET_LINE)),
        "64",
    ]
    assert gpio.drive_pins({18: True}, [], folder=str(tmp_path)) == gpio.KERNEL
    (request,) = kernel.requests
    assert request[:256].hex() + bytes(32).hex() + request[288:].hex() == said[7]


def test_each_pin_is_driven_on_the_chip_of_the_header_whatever_its_number(kernel: Kernel, tmp_path: Path) -> None:
    assert gpio.drive_pins({18: False, 27: False, 5: True}, [], folder=str(tmp_path)) == gpio.KERNEL
    assert kernel.driven == [("gpiochip1", 5, 1), ("gpiochip1", 18, 0), ("gpiochip1", 27, 0)]


def test_a_pin_that_another_program_holds_does_not_keep_the_others_from_being_driven(
    kernel: Kernel, tmp_path: Path
) -> None:
    kernel.busy = {18}
    said: list[str] = []
    assert gpio.drive_pins({18: False, 27: False}, said, folder=str(tmp_path)) == gpio.NOTHING
    assert kernel.driven == [("gpiochip1", 27, 0)]
    assert said[0] == "pin 18: not driven low: Device or resource busy"
    assert "pins low: 18,27 are NOT driven" in said[1]


def test_a_check_drives_nothing_and_says_the_way(kernel: Kernel, tmp_path: Path) -> None:
    assert gpio.drive_pins({18: False}, [], is_check=True, folder=str(tmp_path)) == gpio.KERNEL
    assert kernel.driven == []


def test_without_the_header_of_a_pi_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpio, "TOOLS", ())
    said: list[str] = []
    assert gpio.drive_pins({18: False, 5: True}, said, folder=str(tmp_path)) == gpio.NOTHING
    assert said[0].startswith("no ")
    assert "pins low: 18 high: 5 are NOT driven" in said[1]
    assert gpio.drive_pins({18: False}, [], is_check=True, folder=str(tmp_path)) == gpio.NOTHING


def test_a_tool_that_hangs_is_killed_and_the_kernels_way_taken(
    kernel: Kernel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool = tmp_path / "pinctrl"
    tool.write_text("#!/bin/sh\nexec sleep 600\n")
    tool.chmod(0o755)
    monkeypatch.setattr(gpio, "TOOLS", (str(tool),))
    assert gpio.drive_pins({18: False}, [], folder=str(tmp_path)) == gpio.KERNEL
    assert kernel.driven == [("gpiochip1", 18, 0)]
