"""The writer of pins against what the kernel's header says, and against a kernel that is pretended."""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
import struct
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

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


@pytest.fixture
def writer(deploy: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("drive_pins", deploy / "drive_pins.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Kernel:
    """A kernel with chips that are files, by their labels, and pins of which one may be busy."""

    def __init__(self, writer: ModuleType, folder: Path, *labels: str) -> None:
        self._writer = writer
        self._labels = {f"gpiochip{number}": label for number, label in enumerate(labels)}
        for name in self._labels:
            (folder / name).touch()
        self.busy: set[int] = set()
        self.driven: list[tuple[str, int, int]] = []
        self.requests: list[bytes] = []

    def __call__(self, descriptor: int, request: int, answer: bytearray) -> int:
        chip = Path(f"/proc/self/fd/{descriptor}").readlink().name
        if request == self._writer.GET_CHIP_INFO:
            answer[:] = self._writer.CHIP_INFO.pack(chip.encode(), self._labels[chip].encode(), 54)
        elif request == self._writer.GET_LINE:
            self.requests.append(bytes(answer))
            pin, value = struct.unpack_from("I", answer)[0], struct.unpack_from("Q", answer, 328)[0]
            if pin in self.busy:
                raise OSError(errno.EBUSY, "Device or resource busy")
            self.driven.append((chip, pin, value))
            struct.pack_into("i", answer, 588, os.open("/dev/null", os.O_RDONLY))
        return 0


@pytest.fixture
def kernel(writer: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel(writer, tmp_path, "gpio-brcmstb@107d508500", "pinctrl-rp1")
    monkeypatch.setattr(writer.fcntl, "ioctl", kernel)
    return kernel


def test_what_it_asks_of_the_kernel_is_what_the_kernels_header_says(
    writer: ModuleType, kernel: Kernel, tmp_path: Path
) -> None:
    if shutil.which("gcc") is None or not Path("/usr/include/linux/gpio.h").exists():
        pytest.skip("gcc or linux/gpio.h is not installed")
    (tmp_path / "header.c").write_text(HEADER)
    subprocess.run(["gcc", "-o", tmp_path / "header", tmp_path / "header.c"], check=True)
    said = subprocess.check_output([tmp_path / "header"], text=True).split()
    sizes = [writer.CHIP_INFO.size, writer.LINE_INFO.size, writer.LINE_REQUEST.size]
    assert said[:7] == [
        *map(str, sizes),
        *map(str, (writer.GET_CHIP_INFO, writer.GET_LINE_INFO, writer.GET_LINE)),
        "64",
    ]
    assert writer.main(["high=18"], tmp_path) == 0
    (request,) = kernel.requests
    assert request[:256].hex() + bytes(32).hex() + request[288:].hex() == said[7]


def test_each_pin_is_driven_on_the_chip_of_the_header_whatever_its_number(
    writer: ModuleType, kernel: Kernel, tmp_path: Path
) -> None:
    assert writer.main(["low=18,27", "high=5"], tmp_path) == 0
    assert kernel.driven == [("gpiochip1", 18, 0), ("gpiochip1", 27, 0), ("gpiochip1", 5, 1)]


def test_a_pin_that_another_program_holds_does_not_keep_the_others_from_being_driven(
    writer: ModuleType, kernel: Kernel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kernel.busy = {18}
    assert writer.main(["low=18,27", "high="], tmp_path) == 1
    assert kernel.driven == [("gpiochip1", 27, 0)]
    assert "pin 18: not driven low: Device or resource busy" in capsys.readouterr().err


def test_a_check_drives_nothing(writer: ModuleType, kernel: Kernel, tmp_path: Path) -> None:
    assert writer.main(["--check", "low=18", "high="], tmp_path) == 0
    assert kernel.driven == []


def test_without_the_header_of_a_pi_it_says_so(
    writer: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert writer.main(["low=18", "high="], tmp_path) == 1
    assert "no " in capsys.readouterr().err
