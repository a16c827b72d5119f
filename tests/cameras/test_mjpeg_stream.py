"""JPEG pictures over HTTP: their parts, and a real sender, honest and damaged."""

from __future__ import annotations

import base64
import hashlib
import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stadimeter.app.capture import LiveCapture
from stadimeter.app.clock import MonotonicClock
from stadimeter.cameras.mjpeg_stream import HEAD_MAX_BYTES, PART_MAX_BYTES, Multipart, StreamPart
from stadimeter.cameras.opencv_device import OpenCvCamera, OpenCvOptions
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import CaptureTimeoutError, DeviceOpenError, DriverError, LinkLostError
from stadimeter.testing.rig import eventually
from support.each_case import each_case

# A real sender of JPEG pictures over HTTP, honest and damaged.

PERIOD_S = 0.02
PATIENCE_S = 120.0
SIZE = (160, 120)


def picture(number: int) -> bytes:
    """Return a noisy picture that shows its number, as a row of blocks at its lower edge."""
    image = np.random.default_rng(number).integers(90, 160, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    for bit in range(16):
        image[-16:, 10 * bit : 10 * bit + 10] = 255 if number >> bit & 1 else 0
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


def number_of(image: Image) -> int:
    return sum((image[-10:-4, 10 * bit + 3 : 10 * bit + 7].mean() > 128) << bit for bit in range(16))


class Server(ThreadingHTTPServer):
    """Sends numbered pictures.

    Attributes:
        damage: What to make of a picture on its way.
        part: Makes a part of the stream of a picture and its number.
        pause: What to wait for before a picture is sent.
        content_type: What it says that it sends.
        allows: Whether a request is answered.
        challenge: What it answers to one that is not.
        sent: The number of the last picture that was sent.
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.damage: Callable[[bytes, int], bytes] = lambda jpeg, _number: jpeg
        self.part: Callable[[bytes, int], bytes] = part_with_length
        self.pause: Callable[[int], object] = lambda _number: time.sleep(PERIOD_S)
        self.content_type = "multipart/x-mixed-replace; boundary=frame"
        self.allows: Callable[[str], bool] = lambda _authorization: True
        self.challenge = ""
        self.video = Path()
        self.is_chunked = False
        self.sent = -1
        self.ended = threading.Event()

    @property
    def place(self) -> str:
        return f"127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: Server
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        if not self.server.allows(self.headers.get("Authorization", "")):
            self._answer(401, {"WWW-Authenticate": self.server.challenge})
        elif self.path == "/moved":
            self._answer(302, {"Location": "/cam"})
        elif self.path == "/round":
            self._answer(302, {"Location": "/round"})
        elif self.path == "/file":
            self._answer(302, {"Location": "file:///etc/hostname"})
        elif self.path.startswith("/cam"):
            self._send_pictures()
        elif self.path == "/one":
            self._answer(200, {"Content-Type": self.server.content_type}, picture(0))
        elif self.path.startswith("/video"):
            self._answer(200, {"Content-Type": "video/x-msvideo"}, Path(self.server.video).read_bytes())
        else:
            self._answer(404, {})

    def _answer(self, status: int, headers: dict[str, str], body: bytes = b"") -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def _send_pictures(self) -> None:
        server = self.server
        self.send_response(200)
        self.send_header("Content-Type", server.content_type)
        if server.is_chunked:
            self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        self.close_connection = True
        try:
            while not server.ended.is_set():
                number = server.sent + 1
                server.pause(number)
                data = server.part(server.damage(picture(number), number), number)
                pieces = [data[at : at + 700] for at in range(0, len(data), 700)] if server.is_chunked else [data]
                for piece in pieces:
                    self.wfile.write(b"%x\r\n%s\r\n" % (len(piece), piece) if server.is_chunked else piece)
                server.sent = number
        except OSError:
            return

    def log_message(self, *args: object) -> None:
        """Say nothing."""


def part_with_length(jpeg: bytes, number: int) -> bytes:
    return b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(jpeg), jpeg)


def part_with_the_length_of_the_whole(jpeg: bytes, number: int) -> bytes:
    whole = len(picture(number))
    return b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (whole, jpeg)


def part_without_length(jpeg: bytes, number: int) -> bytes:
    return b"--frame\nContent-Type: image/jpeg\n\n" + jpeg + b"\n"


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    yield server
    server.ended.set()
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def open_camera(server: Server) -> Iterator[Callable[..., OpenCvCamera]]:
    cameras: list[OpenCvCamera] = []

    def opened(address: str = "", **table: str) -> OpenCvCamera:
        options = {"device": address or f"http://{server.place}/cam", "read_timeout": "60 s", **table}
        cameras.append(OpenCvCamera(OpenCvOptions.model_validate(options), MonotonicClock()))
        cameras[-1].open()
        return cameras[-1]

    yield opened
    for camera in cameras:
        camera.close()


def frames_of(camera: OpenCvCamera, count: int) -> list[Frame]:
    return [camera.read() for _ in range(count)]


@pytest.mark.long
@pytest.mark.parametrize("is_chunked", [False, True])
@pytest.mark.parametrize("part", [part_with_length, part_without_length])
def test_pictures_arrive_as_they_were_sent(
    server: Server, open_camera: Callable[..., OpenCvCamera], part: Callable, is_chunked: bool
) -> None:
    server.part, server.is_chunked = part, is_chunked
    frames = frames_of(open_camera(), 4)
    numbers = [number_of(frame.image) for frame in frames]
    assert numbers == sorted(set(numbers))
    sent = cv2.imdecode(np.frombuffer(picture(numbers[-1]), np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(frames[-1].image, sent)


@pytest.mark.long
def test_a_stream_that_is_sent_without_a_type_is_known_by_its_beginning(
    server: Server, open_camera: Callable[..., OpenCvCamera]
) -> None:
    server.content_type = "application/octet-stream"
    server.damage = lambda jpeg, number: jpeg if number % 2 else jpeg[: len(jpeg) // 2] + b"\xff\xd9"
    assert all(number_of(frame.image) % 2 for frame in frames_of(open_camera(), 4))


DAMAGES = [
    (kept, end, part)
    for kept in (0.1, 0.4, 0.7, 0.95)
    for end in (b"", b"\xff\xd9")
    for part in (part_with_length, part_with_the_length_of_the_whole, part_without_length)
]


@pytest.mark.long
def test_pictures_that_were_cut_are_never_frames(server: Server, open_camera: Callable[..., OpenCvCamera]) -> None:
    def damaged_part(jpeg: bytes, number: int) -> bytes:
        if number < 30 or number % 5 == 0:
            return part_with_length(jpeg, number)
        kept, end, part = DAMAGES[number % len(DAMAGES)]
        return part(jpeg[: round(kept * len(jpeg))] + end, number)

    server.part = damaged_part
    camera = open_camera()
    numbers = [number_of(camera.read().image)]
    while numbers[-1] < 30 + 6 * len(DAMAGES):
        numbers.append(number_of(camera.read().image))
    assert numbers == sorted(set(numbers))
    assert [number for number in numbers if number > 30 and number % 5] == []


@pytest.mark.long
def test_a_stream_that_stays_damaged_is_said_to_be(server: Server, open_camera: Callable[..., OpenCvCamera]) -> None:
    server.damage = lambda jpeg, number: jpeg[: len(jpeg) // 2] if number > 40 else jpeg
    camera = open_camera(read_timeout="1 s")
    with pytest.raises(CaptureTimeoutError, match=r"gave no whole picture for \d+\.\d s \(\d+ damaged\b"):
        frames_of(camera, 100)


@pytest.mark.long
def test_two_old_pictures_in_turn_are_never_delivered_as_new(server: Server) -> None:
    camera = OpenCvCamera(OpenCvOptions(device=f"http://{server.place}/cam"), MonotonicClock())
    capture = LiveCapture(camera, MonotonicClock())
    server.damage = lambda jpeg, number: picture(number % 2) if number > 40 else jpeg
    capture.open()
    numbers = [number_of(capture.latest(PATIENCE_S).image)]
    deadline_s = time.monotonic() + PATIENCE_S
    while "opening the camera again" not in capture.trouble():
        assert time.monotonic() < deadline_s, capture.trouble()
        try:
            numbers.append(number_of(capture.latest(0.1).image))
        except DriverError:
            continue
    capture.close()
    assert len(numbers) == len(set(numbers)), "0 and 1 are delivered once at most"


@pytest.mark.long
@pytest.mark.parametrize("hangs", [True, False])
def test_a_sender_that_hangs_or_ends_is_told_and_frames_come_again_when_it_is_back(server: Server, hangs: bool) -> None:
    options = OpenCvOptions.model_validate({"device": f"http://{server.place}/cam", "read_timeout": "500 ms"})
    capture = LiveCapture(OpenCvCamera(options, MonotonicClock()), MonotonicClock())
    is_back = threading.Event()

    def stop(_number: int) -> None:
        if not (is_back.wait(PATIENCE_S) if hangs else is_back.is_set()):
            raise ConnectionAbortedError
        time.sleep(PERIOD_S)

    capture.open()
    before = capture.latest(PATIENCE_S)
    server.pause = stop
    eventually(lambda: "opening the camera again" in capture.trouble())
    assert server.place in capture.trouble()
    is_back.set()
    eventually(lambda: capture.trouble() == "")
    after = capture.latest(PATIENCE_S)
    assert after.sequence > before.sequence
    assert after.captured_at_s > before.captured_at_s
    capture.close()


@pytest.mark.long
def test_old_pictures_that_were_passed_over_are_known_again(
    server: Server, open_camera: Callable[..., OpenCvCamera]
) -> None:
    camera = open_camera()
    frames_of(camera, 5)
    first = server.sent + 10
    while server.sent < first + 50:
        time.sleep(PERIOD_S)
    frames = frames_of(camera, 1)
    server.damage = lambda _jpeg, number: picture(first + number % 40)
    frames += frames_of(camera, 20)
    newest = max(frame.captured_at_s for frame in frames if not first <= number_of(frame.image) < first + 40)
    old = [frame for frame in frames if first <= number_of(frame.image) < first + 40]
    assert len(old) >= 10
    assert all(frame.captured_at_s <= newest for frame in old), "none of them is taken for a later one"


@pytest.mark.long
def test_what_came_while_nobody_read_is_passed_over(server: Server, open_camera: Callable[..., OpenCvCamera]) -> None:
    camera = open_camera()
    frames_of(camera, 20)
    before = server.sent
    while server.sent < before + 60:
        time.sleep(PERIOD_S)
    reached = server.sent
    assert number_of(camera.read().image) >= reached - 1


@pytest.mark.long
def test_the_lag_of_the_sender_s_time_stamps_counts_into_the_age(
    server: Server, open_camera: Callable[..., OpenCvCamera]
) -> None:
    def part(jpeg: bytes, number: int) -> bytes:
        # After the first 40 pictures each is captured 0.2 s earlier, beside its sending, than the one before it was.
        stamp_s = 5000 + number * PERIOD_S if number < 40 else 5000 + 40 * PERIOD_S + (number - 40) * 1e-3
        return part_with_length(jpeg, number).replace(b"\r\n\r\n", b"\r\nX-Timestamp: %.6f\r\n\r\n" % stamp_s, 1)

    server.part = part
    camera = open_camera()
    while (number := number_of((frame := camera.read()).image)) < 80:
        pass
    assert time.monotonic() - frame.captured_at_s > 0.9 * (number - 40) * (PERIOD_S - 1e-3) - 0.1


def test_a_redirection_is_followed(server: Server, open_camera: Callable[..., OpenCvCamera]) -> None:
    assert open_camera(f"http://{server.place}/moved").read().width_px == SIZE[0]


@pytest.mark.parametrize("path", ["/round", "/file", "/absent"])
def test_what_leads_nowhere_is_refused(server: Server, open_camera: Callable[..., OpenCvCamera], path: str) -> None:
    with pytest.raises(DeviceOpenError, match=rf"^the stream http://{server.place}{path} cannot be opened: .* \d+ .*$"):
        open_camera(f"http://{server.place}{path}")


@pytest.mark.parametrize("address", ["http://me:se/cret@{}/cam", "http://me:se%20cret@{}x/cam", "http://:secret@/cam"])
def test_an_address_that_is_not_right_is_refused_without_showing_a_part_of_the_password(
    server: Server, open_camera: Callable[..., OpenCvCamera], address: str
) -> None:
    with pytest.raises(DeviceOpenError, match="cannot be opened") as raised:
        open_camera(address.format(server.place))
    assert not {"se", "secret", "cret"} & set(re.split(r"\W+", str(raised.value)))


def basic(authorization: str) -> bool:
    return authorization == "Basic " + base64.b64encode(b"me:se@cret").decode()


def digest(name: str, hashed: Callable[[bytes], Any], realm: str = "cam") -> Callable[[str], bool]:
    """Return the check of a server that asks for a digest, written down from RFC 7616, section 3.4."""

    def of(text: str) -> str:
        return str(hashed(text.encode()).hexdigest())

    def is_right(authorization: str) -> bool:
        given = dict(re.findall(r'(\w+)="?([^",]+)"?', authorization))
        if not authorization.startswith("Digest ") or given.get("algorithm", name) != name:
            return False
        secret = of(f"me:{realm}:se@cret")
        secret = of(f"{secret}:n0nce:{given['cnonce']}") if name.endswith("-sess") else secret
        asked = of("GET:/cam")
        asked = of(f"GET:/cam:{of('')}") if given.get("qop") == "auth-int" else asked
        between = f"{given['nc']}:{given['cnonce']}:{given['qop']}:" if "qop" in given else ""
        return given["response"] == of(f"{secret}:n0nce:{between}{asked}")

    return is_right


DIGEST = 'Digest realm="cam", nonce="n0nce", qop="auth,auth-int", algorithm='
LOGINS: dict[str, tuple[str, Callable[[str], bool]]] = {
    "basic": ('Basic realm="cam"', basic),
    "without qop": ('Digest realm="cam", nonce="n0nce"', digest("MD5", hashlib.md5)),
    "md5": (f"{DIGEST}MD5", digest("MD5", hashlib.md5)),
    "md5-sess": (f"{DIGEST}MD5-sess", digest("MD5-sess", hashlib.md5)),
    "sha-256": (f"{DIGEST}SHA-256", digest("SHA-256", hashlib.sha256)),
    "sha-512-256": (f"{DIGEST}SHA-512-256", digest("SHA-512-256", partial(hashlib.new, "sha512_256"))),
    "auth-int alone": ('Digest realm="cam", nonce="n0nce", qop="auth-int"', digest("MD5", hashlib.md5)),
    "a session without qop": ('Digest realm="cam", nonce="n0nce", algorithm=MD5-sess', digest("MD5-sess", hashlib.md5)),
    "a list of qop without quotes": (
        'Digest realm="cam", qop=auth, auth-int, nonce="n0nce"',
        digest("MD5", hashlib.md5),
    ),
    "an empty qop": ('Digest realm="cam", nonce="n0nce", qop=""', digest("MD5", hashlib.md5)),
    "quotes and commas in the realm": (
        r'Digest realm="My \"best\" one, Basic", nonce="n0nce"',
        digest("MD5", hashlib.md5, 'My "best" one, Basic'),
    ),
    "the better of two": (f"{DIGEST}MD5, {DIGEST}SHA-256", digest("SHA-256", hashlib.sha256)),
    "behind one that is not known": ('Negotiate, Basic realm="cam"', basic),
}


@pytest.mark.parametrize("way", LOGINS)
def test_user_and_password_of_the_address_are_sent(
    server: Server, open_camera: Callable[..., OpenCvCamera], way
) -> None:
    server.challenge, server.allows = LOGINS[way]
    assert open_camera(f"http://me:se%40cret@{server.place}/cam").read().width_px == SIZE[0]
    with pytest.raises(DeviceOpenError, match="answers 401") as raised:
        open_camera(f"http://me:wrong@{server.place}/cam?token=hidden")
    assert not {"wrong", "hidden"} & set(str(raised.value).replace("=", " ").replace(":", " ").split())


def test_a_login_that_cannot_be_answered_is_named(server: Server, open_camera: Callable[..., OpenCvCamera]) -> None:
    server.challenge, server.allows = f"Negotiate, {DIGEST}SHA-1", lambda _authorization: False
    for user in ("me:secret@", ""):
        with pytest.raises(DeviceOpenError, match="asks for a login by Negotiate, Digest SHA-1; Basic and Digest"):
            open_camera(f"http://{user}{server.place}/cam")
    server.challenge = f"{DIGEST}SHA-256"
    with pytest.raises(DeviceOpenError, match=r"asks for user and password \(Digest SHA-256\); write them"):
        open_camera(f"http://{server.place}/cam")


def test_a_challenge_that_is_out_of_date_is_followed_by_another(server: Server, open_camera) -> None:
    def allows(authorization: str) -> bool:
        server.challenge = f"{DIGEST}MD5, stale=TRUE".replace("n0nce", "new" if authorization else "old")
        return 'nonce="new"' in authorization

    server.allows = allows
    assert open_camera(f"http://me:secret@{server.place}/cam").read().width_px == SIZE[0]


@pytest.mark.parametrize("kind", ["image/jpeg", "application/octet-stream", "text/html"])
def test_an_address_of_one_picture_is_said_to_be_no_stream(server: Server, open_camera, kind: str) -> None:
    server.content_type = kind
    with pytest.raises(DeviceOpenError, match="one picture, not a stream"):
        open_camera(f"http://{server.place}/one")


def test_what_is_no_stream_of_pictures_is_left_to_ffmpeg(
    server: Server, open_camera: Callable[..., OpenCvCamera], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.video = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(server.video), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, SIZE)
    for number in range(60):
        writer.write(cv2.imdecode(np.frombuffer(picture(number), np.uint8), cv2.IMREAD_COLOR))
    writer.release()
    monkeypatch.setattr("stadimeter.cameras.capture_time.SETTLE_S", 0.0)  # a file is read in no time
    assert open_camera(f"http://{server.place}/video.avi").read().width_px == SIZE[0]


JPEGS = tuple(
    cv2.imencode(".jpg", np.random.default_rng(seed).integers(0, 256, (40, 56, 3), dtype=np.uint8))[1].tobytes()
    for seed in range(3)
)


def stream(*, line_end: bytes = b"\r\n", has_length: bool = True, delimiter: bytes = b"--frame") -> bytes:
    parts = []
    for number, jpeg in enumerate(JPEGS):
        head = [delimiter, b"Content-Type: image/jpeg", b"X-Timestamp: %d.250000" % (1700 + number)]
        head += [b"Content-Length: %d" % len(jpeg)] if has_length else []
        parts.append(line_end.join([*head, b"", jpeg]))
    return line_end.join([b"", *parts, delimiter + b"--", b""])


def parts_of(boundary: str, data: bytes, size: int = 1 << 16) -> list[StreamPart]:
    parser = Multipart(boundary)
    found = []
    for at in range(0, len(data), size):
        parser.feed(data[at : at + size])
        while (part := parser.next_part()) is not None:
            found.append(part)
    return found


@each_case("has_length", [True, False])
@each_case("line_end", [b"\r\n", b"\n"])
@each_case(
    ("boundary", "delimiter"),
    [("frame", b"--frame"), ("--frame", b"--frame"), ("frame", b"frame"), ("", b"--anything"), ("f(x)+", b"--f(x)+")],
)
def test_senders_may_write_a_stream_in_their_own_ways(
    boundary: str, delimiter: bytes, line_end: bytes, has_length: bool
) -> None:
    data = stream(line_end=line_end, has_length=has_length, delimiter=delimiter)
    found = parts_of(boundary, data)
    assert [part.body.rstrip(b"\r\n") for part in found] == list(JPEGS)
    assert [part.stamp_s for part in found] == [1700.25, 1701.25, 1702.25]
    unended = data.replace(b"\xff\xd9" + line_end, b"\xff\xd9")
    assert [part.body for part in parts_of(boundary, unended)] == list(JPEGS), "without a line end before a boundary"


@given(size=st.integers(1, 400), has_length=st.booleans())
@settings(max_examples=25, deadline=None)
def test_it_does_not_matter_in_which_pieces_the_bytes_come(size: int, has_length: bool) -> None:
    found = parts_of("frame", stream(has_length=has_length), size)
    assert [part.body.rstrip(b"\r\n") for part in found] == list(JPEGS)


@pytest.mark.parametrize("has_length", [True, False])
def test_a_picture_is_there_before_the_next_one_begins(has_length: bool) -> None:
    data = stream(has_length=has_length)
    parser = Multipart("frame")
    parser.feed(data[: data.index(JPEGS[0]) + len(JPEGS[0])])
    part = parser.next_part()
    assert part is not None
    assert part.body == JPEGS[0]


def test_a_part_that_was_cut_short_swallows_no_part_after_it() -> None:
    data = stream().replace(JPEGS[1], JPEGS[1][:300])
    first, cut, last = parts_of("frame", data)
    assert (first.body, last.body) == (JPEGS[0], JPEGS[2])
    assert len(cut.body) <= 302


def test_a_picture_that_was_cut_before_it_was_counted_is_there_when_its_bytes_are() -> None:
    parser = Multipart("frame")
    for jpeg in (JPEGS[0], JPEGS[1][:300], JPEGS[2][:200], JPEGS[0]):
        parser.feed(part_with_length(jpeg, 0))
        part = parser.next_part()
        assert part is not None
        assert part.body == jpeg


def test_a_part_without_a_time_stamp_has_none() -> None:
    (part,) = parts_of("frame", b"\r\n--frame\r\nContent-Length: 3\r\nX-Timestamp: soon\r\n\r\na\xff\xd9")
    assert part.body == b"a\xff\xd9"
    assert math.isnan(part.stamp_s)


@each_case("length", [lambda size: size + 40, lambda size: size + 2, lambda size: 0 * size, lambda size: size - 7])
def test_a_length_that_does_not_fit_costs_no_picture(length: Callable[[int], int]) -> None:
    parser, found = Multipart("frame"), []
    for jpeg in JPEGS * 3:
        parser.feed(b"--frame\r\nContent-Length: %d\r\n\r\n%s\r\n" % (length(len(jpeg)), jpeg))
        while (part := parser.next_part()) is not None:
            found.append(part.body.rstrip(b"\r\n"))
    assert found[2:] == [*JPEGS * 3][2 : len(found)]
    assert len(found) == 9, "each is there when its own bytes are, but perhaps the first"


def test_a_boundary_that_is_another_than_the_header_states_is_found() -> None:
    for data in (stream(), stream().replace(b"Content-Type: image/jpeg", b"X-Of: it")):
        assert [part.body.rstrip(b"\r\n") for part in parts_of("other", data)] == list(JPEGS)


@pytest.mark.parametrize(
    "endless",
    [b"--frame\r\n" + b"X-Filler: yes\r\n" * HEAD_MAX_BYTES, b"--frame\r\n\r\n" + b"\0" * (PART_MAX_BYTES + 1)],
    ids=["head", "body"],
)
def test_what_does_not_end_is_given_up(endless: bytes) -> None:
    with pytest.raises(LinkLostError):
        parts_of("frame", endless)


def test_what_is_no_stream_takes_no_memory() -> None:
    parser = Multipart("frame")
    for _ in range(300):
        parser.feed(b"\0" * 65536)
        assert parser.next_part() is None
    assert len(parser._data) < 200


@pytest.mark.parametrize("count", [300, pytest.param(20_000, marks=pytest.mark.long)])
def test_damaged_streams_do_no_harm(count: int) -> None:
    rng = np.random.default_rng(11)
    data = stream() + stream(has_length=False) + stream(line_end=b"\n")
    for _ in range(count):
        damaged = bytearray(data)
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(len(damaged)))
            match rng.integers(3):
                case 0:
                    damaged[at] = int(rng.integers(256))
                case 1:
                    del damaged[at : at + int(rng.integers(1, 2000))]
                case _:
                    damaged[at:at] = damaged[: int(rng.integers(1, 300))]
        try:
            found = parts_of("frame", bytes(damaged), int(rng.integers(50, 5000)))
        except LinkLostError:
            continue
        assert sum(len(part.body) for part in found) <= len(damaged)
