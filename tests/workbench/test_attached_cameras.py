from __future__ import annotations

from typing import Any, ClassVar

import pytest

from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.config.plugins import CAMERAS, DriverOptions, load_driver
from stadimeter.errors import DriverUnavailableError
from stadimeter.workbench import frame_source as module
from stadimeter.workbench.frame_source import list_cameras


def _camera(driver: str) -> AttachedCamera:
    return AttachedCamera(driver=driver, options={"serial": "42"}, path="42", name="Cam", node="42")


class Listing(DriverOptions):
    name: ClassVar[str]

    @classmethod
    def attached(cls) -> tuple[AttachedCamera, ...]:
        return (_camera(cls.name),)


def test_every_driver_that_can_list_cameras_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"opencv": "opencv", "video": "another"}

    def load(group: str, name: str) -> Any:
        return type("Listing", (Listing,), {"name": found[name]}) if name in found else load_driver(group, name)

    monkeypatch.setattr(module, "load_driver", load)
    assert [camera.choice for camera in list_cameras()] == ["opencv,serial=42", "another,serial=42"]


def test_a_driver_that_lacks_a_library_has_no_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(group: str, name: str) -> Any:
        if name == "opencv":
            raise DriverUnavailableError("no library")
        return load_driver(group, name)

    monkeypatch.setattr(module, "load_driver", load)
    assert list_cameras() == ()


def test_the_driver_of_video4linux_lists_its_cameras() -> None:
    listed = load_driver(CAMERAS, "opencv").attached()
    assert all(camera.choice.startswith("opencv,device=") for camera in listed)
