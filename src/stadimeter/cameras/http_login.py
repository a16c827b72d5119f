"""The answer to a web server that asks for user and password: Digest (RFC 7616), else Basic (RFC 7617)."""

from __future__ import annotations

import base64
import hashlib
import re
import secrets
import urllib.request
from collections.abc import Callable, Mapping
from functools import partial
from http.client import HTTPMessage
from typing import IO, Any
from urllib.error import HTTPError

from stadimeter.errors import DeviceOpenError

# The digests that cameras ask for, best first. MD5 is weak, but many cameras know nothing else.
HASHES: dict[str, Callable[[bytes], Any]] = {
    "SHA-512-256": partial(hashlib.new, "sha512_256"),
    "SHA-256": hashlib.sha256,
    "MD5": hashlib.md5,
}

# One header may hold several challenges: a scheme, then its parameters. What stands in quotes is no scheme.
_WORDS = re.compile(
    r'(\w[\w-]{0,40})\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^\s,]+))|(?:^|,)\s*(?!auth\b)([A-Za-z][\w-]*)(?![\w-]|\s*=)',
    re.ASCII,
)


class HttpLogin(urllib.request.BaseHandler):
    """Answers the best challenge of a server, and once more if it was out of date; only one host gets the password.

    Python's own handlers know no SHA-256, and end with an error at a server that offers several ways.
    """

    def __init__(self, user: str, password: str, host: str) -> None:
        self._user, self._password, self._host = user, password, host
        self._answers = 0

    def http_error_401(
        self, request: urllib.request.Request, _answer: IO[bytes], code: int, _phrase: str, headers: HTTPMessage
    ) -> Any:
        """Ask once more with an answer to the challenge.

        Raises:
            DeviceOpenError: There is no scheme that is known here, or no user to answer with.
            HTTPError: The answer is refused, or it is another host.
        """
        challenges = [each for line in headers.get_all("WWW-Authenticate", []) for each in challenges_in(line)]
        is_out_of_date = any(given.get("stale", "").lower() == "true" for _, given in challenges)
        if request.host != self._host or self._answers > is_out_of_date:
            raise HTTPError(request.full_url, code, "", headers, None)
        asked = ", ".join(named(scheme, given) for scheme, given in challenges) or "a way that it does not name"
        scheme, given = min(challenges, key=_place, default=("", {}))
        if _place((scheme, given)) > len(HASHES):
            known = f"Basic and Digest ({', '.join(HASHES)}) are known here"
            raise DeviceOpenError(f"its sender asks for a login by {asked}; {known}")
        if not self._user:
            remedy = "write them in front of the host, as in http://USER:PASSWORD@HOST/stream"
            raise DeviceOpenError(f"its sender asks for user and password ({asked}); {remedy}")
        self._answers += 1
        plain = base64.b64encode(f"{self._user}:{self._password}".encode()).decode()
        answer = f"Basic {plain}" if scheme.lower() == "basic" else self._digest(request, given)
        request.add_unredirected_header("Authorization", answer)
        return self.parent.open(request, timeout=request.timeout)

    def _digest(self, request: urllib.request.Request, given: Mapping[str, str]) -> str:
        """Return the answer of RFC 7616, section 3.4."""
        digest, is_session = HASHES[_algorithm(given)], given.get("algorithm", "").upper().endswith("-SESS")

        def hashed(*parts: str) -> str:
            return str(digest(":".join(parts).encode()).hexdigest())

        nonce, realm, uri, count = given.get("nonce", ""), given.get("realm", ""), request.selector, "00000001"
        client_nonce = secrets.token_hex(8)
        secret = hashed(self._user, realm, self._password)
        if is_session:
            secret = hashed(secret, nonce, client_nonce)
        offered = re.findall(r"[\w-]+", given.get("qop", "").lower())
        way = next((each for each in ("auth", "auth-int") if each in offered), "")
        asked = hashed(request.get_method(), uri, *([hashed("")] if way == "auth-int" else []))  # the body is empty
        proof = (nonce, count, client_nonce, way) if way else (nonce,)
        fields = {"username": self._user, "realm": realm, "nonce": nonce, "uri": uri}
        fields |= {"response": hashed(secret, *proof, asked)} | ({"cnonce": client_nonce} if way or is_session else {})
        if "opaque" in given:
            fields["opaque"] = given["opaque"]
        bare = {"qop": way, "nc": count} if way else {}
        if "algorithm" in given:
            bare["algorithm"] = given["algorithm"]
        escaped = {name: re.sub(r'["\\]', r"\\\g<0>", value) for name, value in fields.items()}
        quoted = [f'{name}="{value}"' for name, value in escaped.items()]
        return "Digest " + ", ".join([*quoted, *(f"{name}={value}" for name, value in bare.items())])


def challenges_in(header: str) -> list[tuple[str, dict[str, str]]]:
    """Return the challenges of a ``WWW-Authenticate``: scheme and parameters, their names in lower case."""
    found: list[tuple[str, dict[str, str]]] = []
    for name, quoted, bare, scheme in _WORDS.findall(header):
        if scheme:
            found.append((scheme, {}))
        elif found:
            found[-1][1][name.lower()] = re.sub(r"\\(.)", r"\1", quoted) or bare
    return found


def named(scheme: str, given: Mapping[str, str]) -> str:
    """Return a scheme with its algorithm, such as ``Digest SHA-256``."""
    return f"{scheme} {given['algorithm']}" if "algorithm" in given else scheme


def _algorithm(given: Mapping[str, str]) -> str:
    return given.get("algorithm", "MD5").upper().removesuffix("-SESS")


def _place(challenge: tuple[str, Mapping[str, str]]) -> int:
    """Return the place of a challenge among those that are known, the best first; after the last if it is not."""
    scheme, given = challenge
    name = _algorithm(given) if scheme.lower() == "digest" else scheme.lower()
    known = [*HASHES, "basic"]
    return known.index(name) if name in known else len(known)
