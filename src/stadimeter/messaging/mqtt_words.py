"""What is wrong with a connection to a broker, in words."""

from __future__ import annotations

import socket
import ssl

from paho.mqtt.reasoncodes import ReasonCode

from stadimeter.messaging.mqtt_options import MqttOptions

UNSUPPORTED_VERSION = 0x84
BAD_LOGIN = 0x86
NOT_AUTHORISED = 0x87
NO_MQTT = 0x82
KEEPALIVE = 0x8D
TAKEN_OVER = 0x8E


def unreachable(options: MqttOptions, error: OSError) -> str:
    """Say why there is no connection at all.

    Returns:
        One line, without what happens next.
    """
    place = options.place
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the certificate of {place} is not trusted: {error.verify_message}; name its authority in ca_file"
    if isinstance(error, socket.gaierror):
        return f"no address is known for the host '{options.host}' ({error.strerror})"
    if isinstance(error, ConnectionRefusedError):
        return f"{place} refused the connection (is a broker running there?)"
    return f"{place} {_trouble(error)}" + (" (is this its port for TLS?)" if options.tls else "")


def _trouble(error: OSError) -> str:
    if isinstance(error, TimeoutError):
        return "does not answer"
    if isinstance(error, ConnectionResetError):
        return "hung up without an answer"
    if isinstance(error, ssl.SSLError):
        return f"does not speak TLS as expected: {error.strerror or error}"
    return f"cannot be reached: {error.strerror or error}"


def refused(options: MqttOptions, reason: ReasonCode) -> str:
    """Say why the broker would not have us.

    Returns:
        One line, without what happens next.
    """
    if reason.value in {NOT_AUTHORISED, BAD_LOGIN}:
        who = f"the login of '{options.username}'" if options.username else "a connection without a login"
        return f"{options.place} refused {who} ({reason}); check username and password_file"
    if reason.value == UNSUPPORTED_VERSION:
        return f"{options.place} does not speak MQTT {options.protocol}; set protocol to 'auto'"
    return f"{options.place} refused the client '{options.client_id}' ({reason})"


def sent_away(options: MqttOptions, reason: ReasonCode) -> str:
    """Say why the broker ended the connection.

    Returns:
        One line, without what happens next.
    """
    if reason.value == TAKEN_OVER:
        return f"another program uses the client id '{options.client_id}' at {options.place}; give each its own node"
    return f"{options.place} ended the connection ({reason})"


def broke_off(options: MqttOptions, reason: ReasonCode, *, had_answered: bool) -> str:
    """Say how a connection ended without a word from the broker.

    Returns:
        One line, without what happens next.
    """
    if reason.value == KEEPALIVE:
        return silent(options, had_answered=had_answered)
    if reason.value == NO_MQTT:
        return no_broker(options)
    if not had_answered:
        return f"{options.place} hung up without an answer (is it an MQTT broker, with TLS as configured?)"
    return f"the connection to {options.place} was lost"


def no_broker(options: MqttOptions) -> str:
    """Say, in one line, that what was received is not MQTT."""
    return f"{options.place} does not answer as an MQTT broker does"


def too_much(options: MqttOptions) -> str:
    """Say, in one line, that a message came that is far larger than any answer to us."""
    return f"{options.place} sent a message that is too large for any answer, though nothing was asked of it"


def shared_name(options: MqttOptions) -> str:
    """Guess, for the end of a line, at two programs that take the connection from each other.

    Few brokers say so, and with MQTT 3.1.1 none can.
    """
    return f" (does another program use the client id '{options.client_id}'?)"


def silent(options: MqttOptions, *, had_answered: bool) -> str:
    """Say that the broker says nothing.

    Returns:
        One line, without what happens next.
    """
    return f"{options.place} has stopped answering" if had_answered else f"{options.place} does not answer"


def would_not_take(options: MqttOptions, reason: ReasonCode) -> str:
    """Say that the broker took us but not a message."""
    return f"{options.place} refused a message below '{options.base}' ({reason}); check the broker's access list"
