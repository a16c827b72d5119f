"""Who is let in, and to what: each path of the table, asked by each of those who may ask."""

import http.client
import re
import time

import pytest

from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.web.access import HEADERS, SESSION_S
from stadimeter.web.links import PageAnswer
from stadimeter.web.passwords import FREE, PasswordFile
from stadimeter.web.routes import BODY_MAX_BYTES, PAGE_OPERATIONS, Right
from support.page import FORM, OPERATE, READ, quicken, served_page

CLOSED = [place for place in PAGE_OPERATIONS if place.right is not Right.OPEN]
NAMED = {
    "rule": "far", "output": "motor", "name": "a.mcap", "id": "1", "file": "app.js", "target": "ball", "step": "near",
}  # fmt: skip


def path_of(place):
    return re.sub(r"{(\w+)(:path)?}", lambda found: NAMED[found[1]], place.path)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        quicken(patch)
        with served_page(tmp_path_factory.mktemp("page"), OPERATE, READ, hosts=("Rover.example.",)) as site:
            site.log_in(OPERATE)  # which starts the threads that hash passwords and read files, for all tests
            site.get("/login.css")
            yield site


@pytest.fixture
def stranger(site):
    site.cookies.clear()
    site.page.access.attempts.__init__()
    return site


@pytest.fixture
def reader(stranger):
    assert stranger.log_in(READ).status == 303
    return stranger


@pytest.fixture
def operator(stranger):
    assert stranger.log_in(OPERATE).status == 303
    return stranger


def test_who_is_not_logged_in_gets_nothing(stranger):
    for place in CLOSED:
        answer = stranger.ask(place.method, path_of(place))
        assert answer.status == 401, f"{place.method} {place.path}"
        assert (b"<form" in answer.body) == (place.path == "/"), f"{place.method} {place.path}"


def test_nor_from_a_path_that_is_none(stranger):
    for path in ("/nothing", "/login/", "//", "/static/../page.py", "/static/", "/api/v1", "/%00"):
        for method in ("GET", "POST", "OPTIONS", "TRACE"):
            assert stranger.ask(method, path).status in {401, 404}, f"{method} {path}"


def test_who_may_watch_may_not_operate(reader):
    for place in (place for place in CLOSED if place.right is Right.OPERATE):
        answer = reader.ask(place.method, path_of(place))
        assert (answer.status, answer.error) == (403, "not-allowed"), f"{place.method} {place.path}"


CHANGING = [place for place in CLOSED if place.changes]


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://["},
        {"Origin": ""},
        {"Origin": "", "Sec-Fetch-Site": "same-site"},
        {"Origin": "http://evil.example", "Sec-Fetch-Site": "same-origin"},
    ],
    ids=str,
)
def test_another_site_changes_nothing(operator, headers):
    for place in CHANGING:
        answer = operator.ask(place.method, path_of(place), headers=headers)
        assert (answer.status, answer.error) == (403, "wrong-origin"), f"{place.method} {place.path}"


def test_nor_does_a_form(operator):
    for place in CHANGING:
        answer = operator.ask(place.method, path_of(place), headers={"Content-Type": "text/plain"})
        assert (answer.status, answer.error) == (400, "wrong-content"), f"{place.method} {place.path}"


def test_a_browser_that_says_same_origin_need_not_name_it(operator):
    assert operator.ask("POST", "/logout", headers={"Origin": "", "Sec-Fetch-Site": "same-origin"}).status == 200


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "10.1.2.3", "", "[", "a@127.0.0.1x", "::1"])
def test_a_name_that_is_not_ours_leads_nowhere(stranger, host):
    answer = stranger.get("/login", Host=host or " ")
    assert answer.status == 400
    assert b"<form" not in answer.body


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:99", "127.0.0.1", "[::1]:8080", "rover.example"])
def test_a_name_that_is_ours_does(stranger, host):
    assert stranger.get("/login", Host=host).status == 200


def test_the_login_page_needs_no_script(stranger):
    page = stranger.get("/login")
    assert b"<script" not in page.body
    assert stranger.get("/login.css").headers["content-type"].startswith("text/css")
    assert stranger.ask("POST", "/login", "password=correct+horse", FORM).headers["location"] == "/"


def test_a_wrong_password_is_said_on_the_page(stranger):
    answer = stranger.log_in("wrong <b>")
    assert answer.status == 401
    assert b"The password is wrong" in answer.body
    assert not stranger.cookies


def test_too_many_wrong_passwords_must_wait_and_so_must_the_right_one(stranger):
    for _ in range(FREE):
        assert stranger.log_in("wrong").status == 401
    answer = stranger.log_in(OPERATE)
    assert (answer.status, answer.headers["retry-after"]) == (429, "10")


def test_who_may_watch_guesses_the_other_password_no_faster_with_theirs_in_between(stranger):
    for _ in range(FREE):
        assert stranger.log_in("wrong").status == 401
        answer = stranger.log_in(READ)
    assert (answer.status, answer.headers["retry-after"]) == (429, "10")


def test_the_cookie_is_for_us_alone(stranger):
    cookie = stranger.log_in(OPERATE).headers["set-cookie"].lower()
    assert all(word in cookie for word in ("httponly", "samesite=strict", "path=/", f"max-age={SESSION_S}"))
    assert "secure" not in cookie
    behind_tls = stranger.ask("POST", "/login", "password=correct+horse", {**FORM, "X-Forwarded-Proto": "https"})
    assert "; secure" in behind_tls.headers["set-cookie"].lower()


@pytest.mark.parametrize(("password", "is_shown"), [(READ, False), (OPERATE, True)])
def test_process_numbers_and_folders_are_for_those_alone_who_may_operate(stranger, monkeypatch, password, is_shown):
    async def about():
        return {"digest": "abc", "pid": 7, "recordings": "/home/ada/recordings"}

    async def recordings(_op, _args, _wait_s):
        return PageAnswer({"folder": "/home/ada/recordings", "recordings": []})

    monkeypatch.setattr(stranger.page.run_process, "about", about)
    monkeypatch.setattr(stranger.page.workbench, "ask", recordings)
    stranger.log_in(password)
    session = stranger.get("/api/v1/session").data
    assert session["run"]["digest"] == "abc"
    assert ({"pid", "recordings"} & session["run"].keys() != set()) is is_shown
    assert ("/" in session["configuration"]) is is_shown
    assert ("folder" in stranger.get("/api/v1/recordings").data) is is_shown


def test_watchers_learn_nothing_of_other_runs(reader, monkeypatch, tmp_path):
    reader.page.configuration.write_text("")  # it is there, and no run uses it
    folder = tmp_path / "r" / "stadimeter"
    folder.mkdir(parents=True, mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "r"))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setattr(reader.page.run, "_given", None)  # it looks for its run, as it does unless it is told where
    other = ControlSocket(folder / "garage.sock", lambda: {"configuration": "/home/ada/garage.toml", "pid": 4711})
    other.open()
    try:
        words = reader.get("/api/v1/session").data["run"]["words"]
        refused = reader.get("/api/v1/status")
    finally:
        other.close()
        reader.page.configuration.unlink()
    assert (refused.error, "no instance runs with" in words) == ("no-run", True)
    for said in (words, refused.body.decode()):
        assert not any(secret in said for secret in ("garage", "4711", ".sock"))


def test_a_cookie_that_was_changed_opens_nothing(reader):
    (name,) = reader.cookies
    right, *rest = reader.cookies[name].split(".")
    assert right == str(int(Right.READ))
    for value in (".".join((str(int(Right.OPERATE)), *rest)), "", "...", "2.9999999999.x.", "\xff.\xfe.x.y"):
        reader.cookies[name] = value
        assert reader.get("/api/v1/session").status == 401


@pytest.mark.parametrize("other", ['a={"x": 1}', "theme=a b", 'a="', "consent", "path=/", "k@y=1"])
def test_a_cookie_of_another_program_on_this_computer_is_in_nobodys_way(operator, other):
    ((name, value),) = operator.cookies.items()
    for cookies in (f"{other}; {name}={value}", f"{name}={value}; {other}"):
        assert operator.get("/api/v1/session", Cookie=cookies).status == 200


def test_a_session_ends_by_itself(operator, monkeypatch):
    now_s = operator.page.access._unix_s()
    monkeypatch.setattr(operator.page.access, "_unix_s", lambda: now_s + SESSION_S + 1)
    assert operator.get("/api/v1/session").status == 401


def test_a_session_outlives_the_process_and_a_new_password_ends_it(tmp_path, monkeypatch):
    quicken(monkeypatch)
    with served_page(tmp_path, OPERATE) as first:
        first.log_in(OPERATE)
        (cookie,) = first.cookies.values()
    with served_page(tmp_path) as again:
        again.cookies[f"stadimeter-{again.port}"] = cookie
        assert again.get("/api/v1/session").status == 200
        PasswordFile(again.page.access.file.path).set("read", READ)
        assert again.get("/api/v1/session").status == 401


@pytest.mark.long
@pytest.mark.parametrize("how", ["a new password", "logging out"])
def test_a_new_password_and_logging_out_end_what_is_being_watched(tmp_path, monkeypatch, how):
    quicken(monkeypatch)
    with served_page(tmp_path, OPERATE) as site:
        site.log_in(OPERATE)
        connection = http.client.HTTPConnection("127.0.0.1", site.port, timeout=120)
        connection.request("GET", "/api/v1/live?image=none", headers=copied(site))
        stream = connection.getresponse()
        length = int.from_bytes(stream.read(8)[:4])
        message = stream.read(length)
        assert b"gone" in message
        if how == "logging out":
            site.ask("POST", "/logout")
        else:
            PasswordFile(site.page.access.file.path).set("operate", "another horse")
        assert len(stream.read(10 * len(message))) < 10 * len(message)  # it has ended
        connection.close()


def copied(site):
    """Return the cookie of a browser, as somebody has copied it."""
    ((name, value),) = site.cookies.items()
    return {"Cookie": f"{name}={value}"}


def test_logging_out_ends_the_session_for_whoever_has_a_copy_of_its_cookie(stranger):
    stranger.log_in(OPERATE)
    other = copied(stranger)
    stranger.cookies.clear()
    stranger.log_in(OPERATE)
    ended = copied(stranger)
    stranger.ask("POST", "/logout")
    stranger.cookies.clear()
    assert stranger.get("/api/v1/session", **ended).status == 401
    assert stranger.get("/api/v1/session", **other).status == 200  # another session goes on


def from_address(site, address, password):
    """Log in from an address of the loopback; return the status."""
    connection = http.client.HTTPConnection("127.0.0.1", site.port, timeout=120, source_address=(address, 0))
    headers = {**FORM, "Origin": f"http://127.0.0.1:{site.port}"}
    try:
        connection.request("POST", "/login", f"password={password.replace(' ', '+')}", headers)
        with connection.getresponse() as response:
            response.read()
            return response.status
    finally:
        connection.close()


@pytest.mark.long
def test_thirty_wrong_passwords_from_thirty_addresses_do_not_keep_the_right_one_out(stranger):
    for number in range(30):
        assert from_address(stranger, f"127.0.0.{number + 2}", "wrong") == 401
    assert from_address(stranger, "127.0.1.1", OPERATE) == 303


def test_after_a_wrong_password_the_next_waits_whoever_sends_it(stranger, monkeypatch):
    monkeypatch.setattr("stadimeter.web.access.AFTER_WRONG_S", 0.5)
    before_s = time.monotonic()
    assert [from_address(stranger, f"127.0.0.{number + 2}", "wrong") for number in range(2)] == [401, 401]
    assert time.monotonic() - before_s > 1


def test_without_a_password_this_computer_may_do_all(tmp_path):
    with served_page(tmp_path) as site:
        told = site.get("/api/v1/session").data
        assert (told["right"], told["needs_password"]) == ("operate", False)
        assert site.ask("POST", "/login", "password=x", FORM).status == 503
        assert site.get("/api/v1/session", Host="evil.example").status == 400


def test_a_password_file_that_cannot_be_read_lets_nobody_in(tmp_path):
    with served_page(tmp_path) as site:
        site.page.access.file.path.write_text("{}")
        answer = site.get("/api/v1/session")
        assert (answer.error, "delete it" in answer.data["error"]["message"]) == ("no-passwords", True)


@pytest.mark.parametrize("path", ["/login", "/login.css", "/", "/nothing", "/api/v1/session"])
def test_every_answer_has_the_headers_that_protect_it(stranger, path):
    headers = stranger.get(path).headers
    assert {name: headers[name] for name in HEADERS if name != "Cache-Control"} == {
        name: value for name, value in HEADERS.items() if name != "Cache-Control"
    }
    assert headers["cache-control"] in {"no-store", "no-cache"}
    assert "unsafe" not in headers["content-security-policy"]
    assert "server" not in headers


@pytest.mark.parametrize(("path", "most"), [("/login", 4096), ("/api/v1/world", BODY_MAX_BYTES)])
def test_a_body_has_a_bound(operator, path, most):
    headers = FORM if path == "/login" else {}
    assert operator.ask("POST", path, b"x" * (most + 1), headers).status == 413


@pytest.mark.parametrize("body", [b"{", b"[]", b'"text"', b'{"x": NaN}', b"\xff", b'{"x": "\xff"}', b"[" * 50000])
def test_a_body_that_is_no_object_is_refused(operator, body):
    answer = operator.ask("POST", "/api/v1/world", body)
    assert (answer.status, answer.error) == (400, "wrong-body")
