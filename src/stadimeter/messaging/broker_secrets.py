"""Credentials to show a broker, and whom we trust: the password, certificates and keys, read when a messenger opens."""

from __future__ import annotations

import hashlib
import ssl
from pathlib import Path

from stadimeter.config.untrusted_file import (
    CERTIFICATES_MAX_BYTES,
    SECRET_MAX_BYTES,
    read_untrusted,
    read_untrusted_text,
)
from stadimeter.errors import DeviceOpenError, UnreadableError
from stadimeter.messaging.mqtt_client import MqttSettings, Secrets


def read_secrets(options: MqttSettings) -> Secrets:
    """Read the files that the configuration names; raises `DeviceOpenError` for one that is of no use."""
    password = _read_password(options.password_file) if options.password_file else None
    tls = _tls_context(options) if options.tls else None
    known = password.encode() if password is not None else b""
    if tls is not None and (key_file := options.key_file or options.certificate_file) is not None:
        known = read_untrusted(key_file, CERTIFICATES_MAX_BYTES)
    return Secrets(password=password, tls=tls, client_suffix=_client_suffix(known, options.client_id))


def _client_suffix(known: bytes, client_id: str) -> str:
    """Make a suffix of a secret that tells nothing of it: a broker logs client ids. Takes 10 ms on a PC."""
    if not known:
        return ""
    return "-" + hashlib.scrypt(known, salt=client_id.encode(), n=4096, r=8, p=1, dklen=6).hex()


def _read_password(file: Path) -> str:
    try:
        lines = read_untrusted_text(file, SECRET_MAX_BYTES).splitlines()
    except UnreadableError as error:
        raise DeviceOpenError(f"password_file {file} cannot be read: {error.reason}") from error
    if not lines or not lines[0]:
        raise DeviceOpenError(f"password_file {file} has no password on its first line")
    return lines[0]


def _tls_context(options: MqttSettings) -> ssl.SSLContext:
    context = _trusting(options.ca_file)
    if options.certificate_file is not None:
        _identify(context, options.certificate_file, options.key_file)
    context.sslsocket_class = _TidySocket
    return context


def _identify(context: ssl.SSLContext, certificate_file: Path, key_file: Path | None) -> None:
    def refuse_passphrase() -> str:
        raise DeviceOpenError(f"key_file {key_file} needs a passphrase, and no person is there to type it; remove it")

    try:
        context.load_cert_chain(certificate_file, key_file, refuse_passphrase)
    except ssl.SSLError as error:
        reason = f"is of no use with key_file {key_file} ({error.reason or error})"
        raise DeviceOpenError(f"certificate_file {certificate_file} {reason}") from error
    except OSError as error:
        raise DeviceOpenError(
            f"certificate_file {certificate_file} or key_file {key_file} cannot be read: {error.strerror or error}"
        ) from error


def _trusting(ca_file: Path | None) -> ssl.SSLContext:
    try:
        # Remarks between the certificates may be in any alphabet.
        text = read_untrusted(ca_file, CERTIFICATES_MAX_BYTES).decode("ascii", "ignore") if ca_file else None
        return ssl.create_default_context(cadata=text)
    except UnreadableError as error:
        raise DeviceOpenError(f"ca_file {ca_file} cannot be read: {error.reason}") from error
    except (ssl.SSLError, ValueError) as error:
        reason = getattr(error, "reason", None) or str(error)
        raise DeviceOpenError(f"ca_file {ca_file} holds no certificate that can be used ({reason})") from error


class _TidySocket(ssl.SSLSocket):
    """Closes itself when the handshake fails, which paho leaves to the garbage collector."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except OSError:
            self.close()
            raise
