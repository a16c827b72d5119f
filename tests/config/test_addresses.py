"""An address is shown without its password, whatever that looks like."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.addresses import address_for_people, address_in, words_for_people
from stadimeter.errors import DeviceOpenError
from support.each_case import each_case

PASSWORD = "hunter2"
TOKEN = "tok3n"
ADDRESS = f"rtsp://admin:{PASSWORD}@camera.local:554/live?token={TOKEN}&x=1"


@each_case(
    ("address", "shown"),
    [
        (ADDRESS, "rtsp://camera.local:554/live?…"),
        ("http://camera/?action=stream", "http://camera/?…"),
        ("rtsp://camera/live", "rtsp://camera/live"),
        ("/dev/video0", "/dev/video0"),
        ("rtsp://admin@camera/live#hunter2", "rtsp://camera/live#…"),
        ("rtsp://admin:hunt@hunter2@camera/live", "rtsp://camera/live"),
        ("rtsp://admin:hunter2/hunter2@camera/live", "rtsp://camera/live"),
        ("rtsp://admin:hunter2 hunter2@[fe80::1]/live", "rtsp://[fe80::1]/live"),
        ("rtsp://[admin:hunter2@camera", "rtsp://camera"),
        ("rtsp://camera/user=admin&password=hunter2&channel=1.sdp", "rtsp://camera/…"),
        ("rtsp://camera/live;token=hunter2", "rtsp://camera/live;…"),
        ("rtsp://admin:?hunter2@camera/live", "rtsp://…"),
        ("rtsp://me@admin:a;hunter2@camera/live", "rtsp://…"),
        ("async:http://admin:hunter2@camera/", "async:http://camera/"),
    ],
)
def test_an_address_is_shown_without_what_may_be_secret(address: str, shown: str) -> None:
    assert address_for_people(address) == shown
    assert address_for_people(shown) == shown


@given(
    user=st.text(max_size=5),
    password=st.text(max_size=9),
    path=st.text(alphabet="abc/.:@?=&;#", max_size=9),
    token=st.text(alphabet="xyz@?=/", max_size=5),
)
def test_no_password_and_no_token_is_ever_shown(user: str, password: str, path: str, token: str) -> None:
    shown = address_for_people(f"rtsp://{user}:{PASSWORD}{password}@camera/{path}?token={TOKEN}{token}")
    assert PASSWORD not in shown
    assert TOKEN not in shown
    assert address_for_people(shown) == shown


def test_a_sentence_keeps_its_words_around_an_address() -> None:
    words = words_for_people(
        f"cannot open '{ADDRESS}': refused by camera@home, see https://example.org/help?page=3 now"
    )
    assert words == (
        "cannot open 'rtsp://camera.local:554/live?…': refused by camera@home, see https://example.org/help?… now"
    )


@pytest.mark.parametrize("content", [None, b"", b"camera", b"rtsp://\xff"])
def test_a_file_without_an_address_is_refused_and_named(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "camera.txt"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(DeviceOpenError, match=r"camera\.txt"):
        address_in(file, "rtsp://…")


def test_the_address_is_on_the_first_line(tmp_path: Path) -> None:
    (tmp_path / "camera.txt").write_text(f"\ufeff {ADDRESS} \r\nfor the door\n")
    assert address_in(tmp_path / "camera.txt", "rtsp://…") == ADDRESS
