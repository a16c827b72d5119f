"""The answer to a web server that asks for user and password: Digest (RFC 7616), else Basic (RFC 7617)."""

from __future__ import annotations

import base64
import hashlib
import re
import secrets
import urllib.request
from collections.abc import Iterator, Mapping
from http.client import HTTPMessage
from typing import IO, Any
from urllib.error import HTTPError

from stadimeter.errors import DeviceOpenError

# The digests that cameras ask for, best first. MD5 is weak, but many cameras know nothing else.
HASHES = {"SHA-256": hashlib.sha256, "MD5": hashlib.md5}

# One header may hold several challenges; each begins with the name of its scheme.
_CHALLENGE = re.compile(r"(?:^|,)\s*([A-Za-z][\w-]*)(?=\s+\w[\w-]*\s*=|\s*(?:,\s*[A-Za-z][\w-]*\s|$))")
_PARAMETER = re.compile(r'(\w[\w-]*)\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^\s,]+))')


class HttpLogin(urllib.request.BaseHandler):
    """Answers the best challenge of a server, once; user and password go to one host alone.

    Python's own handlers know no SHA-256, and end with an error at a server that offers several ways.
    """

    def __init__(self, user: str, password: str, host: str) -> None:
        self._user, self._password, self._host = user, password, host
        self._has_answered = False

    def http_error_401(
        self, request: urllib.request.Request, _answer: IO[bytes], code: int, _phrase: str, headers: HTTPMessage
    ) -> Any:
        """Ask once more with an answer to the challenge.

        Raises:
            DeviceOpenError: There is no user to answer with, or no scheme that is known here.
            HTTPError: The answer is refused.
        """
        challenges = [each for line in headers.get_all("WWW-Authenticate", []) for each in challenges_in(line)]
        if self._has_answered or request.host != self._host:
            raise HTTPError(request.full_url, code, "", headers, None)
        asked = ", ".join(named(scheme, given) for scheme, given in challenges) or "a way that it does not name"
        if not self._user:
            raise DeviceOpenError(
                f"its sender asks for user and password ({asked}); write them in front of the host, "
                "as in http://USER:PASSWORD@HOST/stream"
            )
        known = [each for each in map(self._best, challenges) if each is not None]
        if not known:
            raise DeviceOpenError(
                f"its sender asks for a login by {asked}; Basic and Digest (MD5, SHA-256) are known here"
            )
        _, scheme, given = min(known, key=lambda each: each[0])
        self._has_answered = True
        answer = self._basic() if scheme == "basic" else self._digest(request.get_method(), request.selector, given)
        request.add_unredirected_header("Authorization", answer)
        return self.parent.open(request, timeout=request.timeout)

    def _best(self, challenge: tuple[str, dict[str, str]]) -> tuple[int, str, dict[str, str]] | None:
        """Return the place of a challenge among those that are known, the best first; None if it is not."""
        scheme, given = challenge
        if scheme == "basic":
            return len(HASHES), scheme, given
        algorithm = given.get("algorithm", "MD5").upper().removesuffix("-SESS")
        is_known = scheme == "digest" and algorithm in HASHES and "auth" in given.get("qop", "auth").split(",")
        return ([*HASHES].index(algorithm), scheme, given) if is_known else None

    def _basic(self) -> str:
        return "Basic " + base64.b64encode(f"{self._user}:{self._password}".encode()).decode()

    def _digest(self, method: str, uri: str, given: Mapping[str, str]) -> str:
        """Return the answer of RFC 7616, section 3.4."""
        algorithm = given.get("algorithm", "MD5")
        digest = HASHES[algorithm.upper().removesuffix("-SESS")]

        def hashed(*parts: str) -> str:
            return digest(":".join(parts).encode()).hexdigest()

        nonce, realm, client_nonce, count = (
            given.get("nonce", ""),
            given.get("realm", ""),
            secrets.token_hex(8),
            "00000001",
        )
        secret = hashed(self._user, realm, self._password)
        if algorithm.upper().endswith("-SESS"):
            secret = hashed(secret, nonce, client_nonce)
        asked = hashed(method, uri)
        fields = {"username": self._user, "realm": realm, "nonce": nonce, "uri": uri}
        bare = {}
        if "qop" in given:
            fields["cnonce"] = client_nonce
            fields["response"] = hashed(secret, nonce, count, client_nonce, "auth", asked)
            bare = {"qop": "auth", "nc": count}
        else:
            fields["response"] = hashed(secret, nonce, asked)
        if "algorithm" in given:
            bare["algorithm"] = algorithm
        if "opaque" in given:
            fields["opaque"] = given["opaque"]
        quoted = [f'{name}="{value}"' for name, value in fields.items()]
        return "Digest " + ", ".join([*quoted, *(f"{name}={value}" for name, value in bare.items())])


def challenges_in(header: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the challenges of a ``WWW-Authenticate``: scheme and parameters, their names in lower case."""
    begins = list(_CHALLENGE.finditer(header))
    for begin, after in zip(begins, [*begins[1:], None], strict=True):
        text = header[begin.end() : after.start() if after else None]
        given = {name.lower(): quoted or bare for name, quoted, bare in _PARAMETER.findall(text)}
        yield (
            begin[1].lower(),
            {name: value.replace(" ", "") if name == "qop" else value for name, value in given.items()},
        )


def named(scheme: str, given: Mapping[str, str]) -> str:
    """Return a scheme with its algorithm, such as ``Digest SHA-256``."""
    return f"{scheme.capitalize()} {given['algorithm']}" if "algorithm" in given else scheme.capitalize()
