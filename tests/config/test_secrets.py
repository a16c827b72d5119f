"""Secrets in a configuration are never recorded."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.config.addresses import address_for_people, address_in, words_for_people
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError, DeviceOpenError
from support.each_case import each_case
from support.simulated_run import SIMULATED_BALL

SECRET = "tgram://123456789:AbCdEf/42"


def load(tmp_path: Path, notifiers: str) -> Configuration:
    path = tmp_path / "run.toml"
    path.write_text(
        f'{SIMULATED_BALL}\n[world]\n{notifiers}\n[rules.far]\nactuator = "motor"\nwhen = {{ lost = true }}\n'
    )
    return load_configuration(path)


@pytest.mark.parametrize(
    "notifiers",
    [
        f'[notifiers.phone]\ndriver = "apprise"\nurl = "{SECRET}"',
        f"[notifiers.phone]\ndriver = 'apprise'\nurl='{SECRET}'  # mine",
        f'[notifiers]\nphone = {{ url = "{SECRET}", driver = "apprise" }}',
        f'[notifiers]\nphone.driver = "apprise"\nphone.url = "{SECRET}"',
        f'[notifiers]\na = {{ driver = "apprise", url = "{SECRET}" }}\nb = {{ driver = "apprise", url = "{SECRET}" }}',
    ],
)
def test_a_url_is_taken_out_of_what_is_recorded_and_warned_of(tmp_path: Path, notifiers: str) -> None:
    configuration = load(tmp_path, notifiers)
    assert SECRET not in configuration.text
    assert SECRET not in repr(configuration)
    assert "hidden://" in configuration.text
    hints = {warning.hint for warning in configuration.warnings if warning.code == "secret"}
    assert hints == {'put it into a file of its own and write url_file = "…"'}
    assert configuration.notifiers[0].options.url.get_secret_value() == SECRET


def test_a_configuration_without_secrets_is_recorded_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "phone.txt").write_text(SECRET)
    configuration = load(tmp_path, '[notifiers.phone]\ndriver = "apprise"\nurl_file = "phone.txt"')
    assert configuration.text == configuration.path.read_text()
    assert "secret" not in {warning.code for warning in configuration.warnings}


@pytest.mark.parametrize("written", [f'"""\n{SECRET}"""', f"'''{SECRET}\\\n'''"])
def test_a_url_that_cannot_be_taken_out_is_refused_without_repeating_it(tmp_path: Path, written: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, f'[notifiers.phone]\ndriver = "apprise"\nurl = {written}')
    assert "write it as text in simple quotes on the line of its key" in str(raised.value)
    assert "AbCdEf" not in str(raised.value)


@pytest.mark.parametrize("written", ['"AbCdEf"', "5", '["tgram://AbCdEf"]', '{ a = "tgram://AbCdEf" }'])
def test_a_wrong_url_is_refused_without_repeating_it(tmp_path: Path, written: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, f'[notifiers.phone]\ndriver = "apprise"\nurl = {written}')
    assert "AbCdEf" not in str(raised.value)


PASSWORD = "hunter2"
TOKEN = "tok3n"
ADDRESS = f"rtsp://admin:{PASSWORD}@camera.local:554/live?token={TOKEN}&x=1"


def camera(tmp_path: Path, device: str, more: str = "") -> Configuration:
    """Load a configuration whose camera has an address, written in some way."""
    text = SIMULATED_BALL[SIMULATED_BALL.index("[camera.model]") :].replace('"ideal"', '"sheet"\nwidth = 1\nheight = 2')
    text = text.replace("width = 1\nheight = 2", 'width = "10 cm"\nheight = "20 cm"')
    path = tmp_path / "run.toml"
    rule = '[rules.far]\nactuator = "motor"\nwhen = { lost = true }'
    path.write_text(f'[camera]\ndriver = "opencv"\n{device}\n{text}\n{rule}\n{more}')
    return load_configuration(path)


@pytest.mark.parametrize(
    "written",
    [
        f'device = "{ADDRESS}"  # {ADDRESS}',
        f"device='{ADDRESS}'",
        f'"device" = """{ADDRESS}"""',
        f'device = "{ADDRESS.replace("@", chr(92) + "u0040")}"',
        f'device = "{ADDRESS.replace(PASSWORD, PASSWORD + " " + PASSWORD)}"',
        f'device = "{ADDRESS.replace(PASSWORD, chr(92) + chr(34) + PASSWORD)}"',
        f'# device = "{ADDRESS}"\ndevice = 0',
    ],
)
def test_the_password_of_a_camera_is_in_nothing_that_is_recorded(tmp_path: Path, written: str) -> None:
    configuration = camera(tmp_path, written)
    assert PASSWORD not in configuration.text
    assert TOKEN not in configuration.text
    path = tmp_path / "recorded.toml"
    path.write_text(configuration.text)
    again = load_configuration(path)
    assert again.text == configuration.text
    assert "secret" not in {warning.code for warning in again.warnings}


def test_a_password_in_an_address_is_warned_of_with_the_key_to_write_instead(tmp_path: Path) -> None:
    (warning,) = [each for each in camera(tmp_path, f'device = "{ADDRESS}"').warnings if each.code == "secret"]
    assert (warning.key, warning.line) == ("camera.device", 3)
    assert 'write device_file = "…"' in warning.hint
    assert PASSWORD not in str(warning)


def test_an_address_without_a_password_is_no_reason_for_a_warning(tmp_path: Path) -> None:
    configuration = camera(tmp_path, 'device = "http://camera:8080/?action=stream"')
    assert "secret" not in {warning.code for warning in configuration.warnings}


def test_the_file_of_an_address_is_recorded_by_its_name_only(tmp_path: Path) -> None:
    (tmp_path / "camera.txt").write_text(ADDRESS + "\n")
    configuration = camera(tmp_path, 'device_file = "camera.txt"\nlatency = "80 ms"')
    assert configuration.text == configuration.path.read_text()
    assert configuration.warnings == ()
    assert configuration.camera.options.source() == ADDRESS


def test_an_address_in_what_a_rule_sends_is_sent_whole_and_recorded_without_its_token(tmp_path: Path) -> None:
    then = f'[[rules.far.escalation]]\ntopic = "away"\ntext = "see http://dash/?token={TOKEN} now"\n'
    configuration = camera(tmp_path, "device = 0", f'{then}[messenger]\ndriver = "simulated"\n')
    assert TOKEN in repr(configuration.plan)
    assert 'text = "see http://dash/?… now"' in configuration.text
    assert "secret" not in {warning.code for warning in configuration.warnings}


def test_an_address_in_the_wrong_place_is_refused_without_repeating_its_password(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        camera(tmp_path, f'device = 0\nrate = "{ADDRESS}"\nfourcc = "{ADDRESS}"\nmodle = "{ADDRESS}"')
    assert "rtsp://camera.local:554/live?…" in str(raised.value)
    assert PASSWORD not in str(raised.value)
    assert TOKEN not in str(raised.value)


@pytest.mark.parametrize("device", [f"rtsp:/admin:{PASSWORD}@camera", f"admin:{PASSWORD}@camera"])
def test_an_address_that_is_wrong_is_refused_without_repeating_it(tmp_path: Path, device: str) -> None:
    with pytest.raises(ConfigError, match="is not a camera") as raised:
        camera(tmp_path, f'device = "{device}"')
    assert PASSWORD not in str(raised.value)


# An address is shown without its password, whatever that looks like.


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
