"""TLS against a real mosquitto with a certificate of our own making."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from stadimeter.cameras.mjpeg_stream import open_mjpeg
from stadimeter.core.frame import SeenPictures
from stadimeter.errors import DeviceOpenError
from stadimeter.messaging.mqtt import PahoMessenger
from stadimeter.testing.rig import eventually
from stadimeter.workbench.doctor.checks import Computer, Diagnosis, Examined
from stadimeter.workbench.doctor.checks import broker as find_broker
from support.broker import HOST, MosquittoBroker, free_port
from support.programs import require

CONFIG = Path(__file__).parents[2] / "config" / "appliance.toml"

MakeMessenger = Callable[..., PahoMessenger]
StartBroker = Callable[..., MosquittoBroker]


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a certificate for 127.0.0.1 that signs itself, and its key."""
    require("openssl", "mosquitto")
    folder = tmp_path_factory.mktemp("tls")
    file, key = folder / "certificate.pem", folder / "key.pem"
    made = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    made += ["-days", "2", "-subj", "/CN=loopback", "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run([*made, "-keyout", str(key), "-out", str(file)], check=True, capture_output=True)
    return file, key


@pytest.fixture
def secure_broker(start_broker: StartBroker, certificate: tuple[Path, Path]) -> MosquittoBroker:
    return start_broker(certificate=certificate[0], key=certificate[1])


def test_a_broker_with_a_trusted_certificate_is_accepted(secure_broker, make_messenger, certificate):
    messenger = make_messenger(secure_broker.port, tls=True, ca_file=str(certificate[0]))
    messenger.open()
    eventually(lambda: not messenger.trouble())


def doctor_says(folder: Path, port: int, **keys: object) -> Diagnosis:
    """Return what `doctor` finds of a broker: the reason of a run's messenger, and its remedy below it."""
    table = "".join(f"{key} = {json.dumps(value)}\n" for key, value in {"host": HOST, "port": port, **keys}.items())
    lines = re.sub(r'^host = "127.0.0.1".*\n', table, CONFIG.read_text(), flags=re.MULTILINE)
    (folder / "box.toml").write_text(lines)
    (found,) = find_broker(Examined(Computer(), folder / "box.toml"))
    return found


def test_a_broker_with_an_unknown_certificate_is_refused_in_words(secure_broker, make_messenger, tmp_path):
    messenger = make_messenger(secure_broker.port, tls=True)
    messenger.open()
    eventually(lambda: "is not trusted" in messenger.trouble() and "ca_file" in messenger.trouble())
    found = doctor_says(tmp_path, secure_broker.port, tls=True)
    assert found.remedy == "name its authority in ca_file"
    assert messenger.trouble().startswith(f"{found.seen}; {found.remedy}")


def test_a_broker_under_another_name_than_its_certificates_is_refused_in_words(
    secure_broker, make_messenger, certificate, tmp_path
):
    options = {"host": "localhost", "tls": True, "ca_file": str(certificate[0])}
    messenger = make_messenger(secure_broker.port, **options)
    messenger.open()
    eventually(lambda: "is not trusted" in messenger.trouble())
    found = doctor_says(tmp_path, secure_broker.port, **options)
    assert found.remedy == "write as host a name that is in it, in place of 'localhost'"
    assert messenger.trouble().startswith(f"{found.seen}; {found.remedy}")


@pytest.mark.parametrize(
    ("years", "words"),
    [((2040, 2041), r"not yet valid; this computer's clock says \d{4}-\d\d-\d\d \d\d:\d\d UTC: set it"),
     ((2000, 2001), "expired; if it is .* today, renew it there, else set this computer's clock")],
)  # fmt: skip
def test_a_certificate_of_another_time_names_the_clock_and_not_its_authority(
    years, words, start_broker, make_messenger, certificate, monkeypatch
):
    tmp_path = certificate[0].parent / str(years[0])
    tmp_path.mkdir()
    file = dated(tmp_path, certificate[1], *years)
    port = start_broker(certificate=file, key=certificate[1]).port
    messenger = make_messenger(port, tls=True, ca_file=str(file))
    messenger.open()
    eventually(lambda: re.search(words, messenger.trouble()))
    assert "ca_file" not in messenger.trouble()
    found = doctor_says(tmp_path, port, tls=True, ca_file=str(file))
    assert re.search(words, f"{found.seen}; {found.remedy}")
    assert re.match("this computer's clock|if it is ", found.remedy)
    monkeypatch.setenv("SSL_CERT_FILE", str(file))
    with pytest.raises(DeviceOpenError, match=f"its certificate is not trusted: .*{words}"):
        open_mjpeg(f"https://127.0.0.1:{port}/", 5.0, 5.0, SeenPictures())


def test_a_stream_by_https_says_why_tls_does_not_trust_it(secure_broker, broker):
    for port, words in (
        (secure_broker.port, "self-signed certificate; add its authority to those of this computer"),
        (broker.port, "is it http in place of https"),
    ):
        with pytest.raises(DeviceOpenError, match=words):
            open_mjpeg(f"https://127.0.0.1:{port}/", 2.0, 2.0, SeenPictures())


def dated(folder: Path, key: Path, begins: int, ends: int) -> Path:
    """Return a certificate that signs itself, valid between two years."""
    (folder / "index.txt").touch()
    (folder / "serial").write_text("01")
    (folder / "ca.cnf").write_text(
        f"[ca]\ndefault_ca=own\n[own]\ndatabase={folder}/index.txt\nserial={folder}/serial\nnew_certs_dir={folder}\n"
        "default_md=sha256\npolicy=policy\nx509_extensions=names\n[policy]\ncommonName=supplied\n"
        "[names]\nsubjectAltName=IP:127.0.0.1\n"
    )
    asked, file = folder / "asked.csr", folder / "dated.pem"
    dates = ["-startdate", f"{begins}0101000000Z", "-enddate", f"{ends}0101000000Z"]
    config = str(folder / "ca.cnf")
    signed = ["ca", "-batch", "-config", config, "-selfsign", "-keyfile", str(key), "-in", str(asked), *dates]
    for line in (
        ["req", "-new", "-key", str(key), "-subj", "/CN=loopback", "-out", str(asked)],
        [*signed, "-out", str(file)],
    ):
        subprocess.run(["openssl", *line], check=True, capture_output=True)
    return file


def test_a_port_for_tls_without_tls_is_said_in_words(secure_broker, make_messenger):
    messenger = make_messenger(secure_broker.port)
    messenger.open()
    eventually(lambda: "with TLS as configured?" in messenger.trouble())


def test_tls_to_a_port_without_it_is_said_in_words(broker, make_messenger):
    messenger = make_messenger(broker.port, tls=True)
    messenger.open()
    eventually(lambda: "TLS" in messenger.trouble())


@pytest.mark.parametrize(("text", "expected"), [(None, "no such file"), ("not a certificate", "no certificate")])
def test_a_certificate_file_of_no_use_is_an_error_at_once(text, expected, make_messenger, tmp_path):
    file = tmp_path / "ca.pem"
    if text is not None:
        file.write_text(text)
    messenger = make_messenger(free_port(), tls=True, ca_file=str(file))
    with pytest.raises(DeviceOpenError, match=expected):
        messenger.open()


def test_a_certificate_of_our_own_that_is_of_no_use_is_said_in_words(tmp_path, make_messenger, certificate):
    file, key = certificate
    (tmp_path / "locked.key").write_bytes(_locked(key))
    (tmp_path / "no.crt").write_text("no certificate")
    for pair, words in [
        ((file, tmp_path / "none.key"), "cannot be read: No such file"),
        ((tmp_path / "no.crt", key), "is of no use with key_file"),
        ((file, tmp_path / "locked.key"), "needs a passphrase"),
    ]:
        options = {"certificate_file": str(pair[0]), "key_file": str(pair[1])}
        with pytest.raises(DeviceOpenError, match=words):
            make_messenger(free_port(), tls=True, ca_file=str(file), **options).open()


def _locked(key: Path) -> bytes:
    locking = ["openssl", "pkcs8", "-topk8", "-passout", "pass:secret", "-in", str(key)]
    return subprocess.run(locking, check=True, capture_output=True).stdout
