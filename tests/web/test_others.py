"""The pages of other cameras: real pages that ask each other, with and without passwords, and some that are dead."""

from __future__ import annotations

import http.client
import json
import re
import signal
import socket
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from stadimeter.errors import PageError
from stadimeter.testing.rig import eventually
from stadimeter.web.others import OtherPage, Others, read_tokens
from stadimeter.web.passwords import PasswordFile
from support.broker import free_port
from support.browser import STILL, Served, served, tab
from support.page import faults_of

# A ball at 3.2 m: this alarm is raised at once.
ALARM = STILL.replace('when = { below = "1 m" }', 'when = { below = "5 m" }')


def ask(here: Served, path: str, token: str = "") -> tuple[int, Any]:
    connection = http.client.HTTPConnection(here.url.removeprefix("http://"), timeout=120)
    try:
        connection.request("GET", path, headers={"Authorization": f"Bearer {token}"} if token else {})
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


def known(here: Served, url: str) -> Mapping[str, Any]:
    return next(each for each in ask(here, "/api/v1/others")[1]["others"] if each["url"] == url)


def wait_for(here: Served, url: str, state: str) -> Mapping[str, Any]:
    eventually(lambda: known(here, url)["state"] == state, 60.0)
    return known(here, url)


def naming(*urls: str, more: str = "") -> str:
    return f"{STILL}\n[web]\nothers = {json.dumps(urls)}\n{more}"


@pytest.fixture(scope="module")
def garage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Return the page of another camera, whose alarm stands."""
    with served(tmp_path_factory.mktemp("garage"), ALARM) as there:
        yield there


@pytest.mark.long
def test_the_alarms_of_another_page_are_known_and_one_that_hangs_holds_no_answer_up(garage, tmp_path):
    with closing(socket.create_server(("127.0.0.1", 0))) as hanging:  # takes connections, and says nothing
        hangs = f"http://127.0.0.1:{hanging.getsockname()[1]}"
        nobody = f"http://127.0.0.1:{free_port()}"
        with served(tmp_path, naming(garage.url, hangs, nobody), runs=False) as here:
            states = {each["url"]: each["state"] for each in ask(here, "/api/v1/others")[1]["others"]}
            assert states[hangs] == "asked", "answered while it was still waited for"
            eventually(lambda: known(here, garage.url)["alarms"], 60.0)  # which it may raise after it has answered
            there = wait_for(here, garage.url, "live")
            (alarm,) = there["alarms"]
            assert (alarm["rule"], alarm["acknowledged"], there["age_s"] < 60) == ("near", False, True)
            assert wait_for(here, hangs, "silent")["age_s"] is None
            assert "refused" in wait_for(here, nobody, "silent")["words"]


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"HTTP/1.0 200 OK\r\n\r\n<html>",
        b"SSH-2.0-OpenSSH_9.2\r\n",
        b'HTTP/1.0 200 OK\r\n\r\n{"alarms": [{"rule": 1}]}',
        b'HTTP/1.0 200 OK\r\n\r\n{"alarms": 3}',
        b"HTTP/1.0 404 Not Found\r\n\r\n[]",
        b"HTTP/1.0 302 Found\r\nLocation: http://127.0.0.1/\r\n\r\n",
    ],
)
def test_an_answer_that_is_none_is_told_from_silence(answer):
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:

        def serve() -> None:
            with listener.accept()[0] as connection:
                connection.recv(65536)
                connection.sendall(answer)

        thread = Thread(target=serve)
        thread.start()
        page = OtherPage(f"http://127.0.0.1:{listener.getsockname()[1]}")
        page.ask()
        thread.join()
    assert page.state == ("refused" if answer else "silent")
    assert page.alarms == []
    assert page.words


@pytest.mark.long
def test_a_page_with_a_password_wants_its_token_which_opens_alarms_and_nothing_else(tmp_path):
    for name in ("there", "here"):
        (tmp_path / name).mkdir()
    passwords = tmp_path / "passwords"
    PasswordFile(passwords).set("operate", "operate-it")
    found = PasswordFile(passwords).passwords()
    assert found is not None
    options = ("--password-file", str(passwords), "--address", "127.0.0.1")
    with served(tmp_path / "there", ALARM, *options) as there:
        tokens = tmp_path / "here" / "tokens"
        tokens.write_text(f"# of the garage\n\n{there.url} {found.token('alarms')}\n")
        more = 'others_tokens = "tokens"\n'
        (tmp_path / "bare").mkdir()
        with served(tmp_path / "bare", naming(there.url), runs=False) as bare:
            assert "token" in wait_for(bare, there.url, "refused")["words"]
        with served(tmp_path / "here", naming(there.url, more=more), runs=False) as here:
            eventually(lambda: known(here, there.url)["alarms"], 60.0)
        eventually(lambda: ask(there, "/api/v1/alarms", found.token("alarms"))[0] == 200, 60.0)
        assert ask(there, "/api/v1/alarms", found.token("metrics"))[0] == 401
        for path in ("/metrics", "/api/v1/status", "/api/v1/others", "/api/v1/configuration", "/"):
            connection = http.client.HTTPConnection(there.url.removeprefix("http://"))
            connection.request("GET", path, headers={"Authorization": f"Bearer {found.token('alarms')}"})
            assert connection.getresponse().status == 401, path
            connection.close()


def test_a_token_is_for_the_page_of_its_line_alone(tmp_path):
    heard = []
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:

        def serve() -> None:
            with listener.accept()[0] as connection:
                heard.append(connection.recv(65536))

        thread = Thread(target=serve)
        thread.start()
        others = Others([f"http://127.0.0.1:{listener.getsockname()[1]}"], {"http://garage.local:8080": "secret"})
        others.tell()
        thread.join()
    assert heard[0].startswith(b"GET /api/v1/alarms HTTP/1.1")
    assert b"secret" not in heard[0]
    assert b"Authorization" not in heard[0]


def test_a_camera_that_hangs_is_no_longer_live_three_seconds_after_its_last_answer():
    page = OtherPage("http://garage.local:8080", state="live", live_s=100.0)
    assert [page.tell(now_s)["state"] for now_s in (100.0, 102.9, 103.1)] == ["live", "live", "asked"]
    assert page.tell(103.1)["age_s"] == 3.1


def test_a_bar_shows_each_camera_and_one_list_has_the_alarms_of_all_each_with_its_camera(browser, tmp_path):
    (tmp_path / "there").mkdir()
    with served(tmp_path / "there", ALARM) as there, served(tmp_path, naming(there.url)) as here:
        name = there.url.removeprefix("http://")
        with tab(browser) as page, tab(browser, size=(360, 640)) as phone:
            page.goto(f"{here.url}/#alarms")
            bar = page.get_by_role("navigation", name="Other cameras")
            bar.get_by_role("link", name=re.compile(f"{name}.*live.*1 alarm")).wait_for()
            line = page.get_by_role("region", name="On all cameras").get_by_role("listitem")
            line.get_by_role("link", name=name).wait_for()
            assert "near" in line.inner_text()
            assert line.get_by_role("link").get_attribute("href") == f"{there.url}/#alarms"
            assert faults_of(page) == []
            phone.goto(f"{here.url}/#live")
            phone.get_by_role("link", name=re.compile(name)).wait_for()
            phone.locator("canvas[data-drawn]").wait_for()
            assert faults_of(phone) == []
            there.page.send_signal(signal.SIGKILL)
            bar.get_by_role("link", name=re.compile("silent.*1 alarm, .* old")).wait_for()
            assert "old" in line.inner_text()
            line.get_by_role("link").wait_for()  # what was known stays, and says its age


@pytest.mark.parametrize("text", ["http://garage.local:8080\n", "\na b c\n"])
def test_a_line_that_is_no_token_is_named_and_its_text_is_not_repeated(tmp_path: Path, text: str) -> None:
    path = tmp_path / "tokens"
    path.write_text(text)
    with pytest.raises(PageError, match=rf"tokens:{text.count(chr(10))}: a line is an address and its token") as told:
        read_tokens(path)
    assert "a b c" not in str(told.value)
    with pytest.raises(PageError, match="cannot be read"):
        read_tokens(tmp_path / "none")
