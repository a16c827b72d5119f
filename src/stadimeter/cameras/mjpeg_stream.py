"""A stream of JPEG pictures over HTTP, as mjpg-streamer, ustreamer, motion and ESP32 cameras send it.

It is read here and not by FFmpeg. FFmpeg decodes a truncated picture into a buffer that still holds an older one, says
nothing, and neither ``err_detect=explode`` nor ``discardcorrupt`` changes that: the old part of the picture then counts
as seen just now. Here each part is decoded as a whole JPEG, or not at all.
"""

from __future__ import annotations

import http.client
import math
import re
import select
import socket
import ssl
import time
import traceback
import urllib.request
import zlib
from collections.abc import Callable, Iterator
from urllib.error import HTTPError
from urllib.parse import SplitResult, unquote, urlsplit

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.cameras.http_login import HttpLogin
from stadimeter.config.addresses import not_trusted
from stadimeter.config.files import JPEG_FILLED, PICTURE_MAX_PIXELS
from stadimeter.core.frame import Image, SeenPictures
from stadimeter.errors import DeviceOpenError, LinkLostError, PictureError

# The JPEGs of a stream: decoded, if all of each is there --------------------------------------------------------------
#
# Decoders fill in what is missing: with grey, with the last block, or with what was in their buffer, and libjpeg
# then only warns. Looking for the end marker is not enough, since a relay that was interrupted may put one at the
# end of half a picture. So every warning of libjpeg is an error here. Of pictures that were cut anywhere, with or
# without an end marker, all are refused; of those that lack up to 1.5 kB somewhere inside, 97 %.
#
# One byte that is missing inside is another case: the Huffman code soon finds its way again, and in seven of ten
# pictures it gives as many blocks as are needed. What stays wrong is the brightness or colour from there to the
# end, since each block is coded by its difference from the one before. That is an edge along blocks, as wide as the
# picture: to the right of the byte's place above its row of blocks, to the left of it below. An edge that was not
# there before is damage.

# A picture with filling is believed where this share of the stream has it, as a running mean of about 20 pictures: a
# missing byte may leave as much behind.
_FILLED_SHARE = 0.2
_WEIGHT_OF_NEW = 0.05

# Height and width of the blocks that are coded together, by how coarsely colour is stored.
_BLOCK_PX = {"420": (16, 16), "422": (8, 16), "440": (16, 8), "411": (8, 32)}
_SMALL_BLOCK_PX = (8, 8)

# Damage: along one way through the picture from side to side, the mean step is larger than this, in grey levels, and
# than this part of its standard deviation. All of 25 pictures that were measured wrong, and 1 of 600 that a
# camera saw which turned.
_MIN_STEP = 20.0
_MIN_STEP_SIGMAS = 0.8


class JpegStream:
    """Decodes the pictures of one stream, in their order."""

    def __init__(self) -> None:
        self._filled_share = 0.0
        self._steps = np.zeros((0, 3))

    def decode(self, data: bytes) -> Image:
        """Decode a picture, blue first, shape ``(height, width, 3)``, if all of it is there.

        Raises:
            PictureError: It is damaged, or not a JPEG.
        """
        import simplejpeg  # noqa: PLC0415 - only streams need it

        is_filled = False
        try:
            height_px, width_px, _, subsampling = simplejpeg.decode_jpeg_header(data)
            if height_px * width_px > PICTURE_MAX_PIXELS:
                raise PictureError(f"a picture of {width_px} × {height_px} pixels is too large")
            image = np.empty((height_px, width_px, 3), np.uint8)
            simplejpeg.decode_jpeg(data, "BGR", buffer=image)
        except ValueError as error:
            is_filled = bool(JPEG_FILLED.search(str(error)))
            if not is_filled:
                raise PictureError(f"the picture is damaged: {error}") from error
        self._filled_share += _WEIGHT_OF_NEW * (is_filled - self._filled_share)
        if is_filled and self._filled_share < _FILLED_SHARE:
            raise PictureError("the picture is damaged: bytes are left over at its end")
        if self._has_new_edge(image, *_BLOCK_PX.get(subsampling, _SMALL_BLOCK_PX)):
            raise PictureError("the picture is damaged: its brightness or colour changes from one block to the next")
        return image

    def _has_new_edge(self, image: Image, height_px: int, width_px: int) -> bool:
        before, self._steps = self._steps, _steps(image, height_px, width_px)
        across = image.shape[1] // width_px
        if len(self._steps) < across:
            return False
        if len(before) != len(self._steps):
            before = np.zeros_like(self._steps)
        edges = _are_edges(self._steps, across)
        return bool(edges.any() and (edges & _are_edges(self._steps - before, across)).any())


def _steps(image: Image, height_px: int, width_px: int) -> NDArray[np.float64]:
    """Return the steps by which the upper side of each block is brighter than the lower side of the block above it.

    One row for each block, in the order of their coding, by colour. A slope that goes on is no step.
    """
    blocks = image.shape[1] // width_px
    rows = (image.shape[0] - 2) // height_px
    if not blocks or not rows:
        return np.zeros((0, 3))
    used = image[:, : blocks * width_px]
    # cv2 in place of numpy: a third of the time.
    two_above, above, below, two_below = (used[height_px + offset :: height_px][:rows] for offset in (-2, -1, 0, 1))
    near = cv2.subtract(below, above, dtype=cv2.CV_16S)
    far = cv2.subtract(two_below, two_above, dtype=cv2.CV_16S)
    steps = cv2.addWeighted(near, 1.5, far, -0.5, 0.0, dtype=cv2.CV_32F)
    means = cv2.resize(steps, (blocks, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(means, np.float64).reshape(-1, 3)


def _are_edges(steps: NDArray[np.float64], across: int) -> NDArray[np.bool_]:
    """Return by the first block, and by colour, whether the steps of as many blocks as lie side by side are an edge."""
    sums = np.zeros((len(steps) + 1, 6))
    np.cumsum(np.hstack((steps, steps * steps)), axis=0, out=sums[1:])
    means = (sums[across:] - sums[:-across]) / across
    mean, variance = means[:, :3], means[:, 3:] - means[:, :3] ** 2
    return (np.abs(mean) > _MIN_STEP) & (mean * mean > _MIN_STEP_SIGMAS**2 * variance)


# A larger picture is none: a JPEG of 60 megapixels at high quality is smaller.
PART_MAX_BYTES = 20_000_000

HEAD_MAX_BYTES = 16_384

_JPEG_END = re.compile(rb"\xff\xd9[\r\n]*\Z")
_END_OF_HEAD = re.compile(rb"\n\r?\n")
_LENGTH = re.compile(rb"^content-length[ \t]*:[ \t]*(\d{1,9})[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_STAMP = re.compile(rb"^x-timestamp[ \t]*:[ \t]*(\d{1,12}(?:\.\d{1,9})?)[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)


_MULTIPART = re.compile(
    rb"\s*--([^\r\n]{1,70})\r?\n(?:[^\r\n]{1,200}\r?\n){0,8}content-(?:type:[ \t]*image/jpe?g|length:)", re.IGNORECASE
)


def _delimiters_of(boundary: bytes) -> Iterator[re.Pattern[bytes]]:
    """Yield the patterns of a delimiter: behind the end of a line, and, as some senders write it, of a picture.

    Two that begin with plain bytes are found ten times as fast as one for both.
    """
    line = rb"-*" + re.escape(boundary.lstrip(b"-")) if boundary else rb"--[^\r\n]{0,70}"
    return (re.compile(before + line + rb"(?:--)?[ \t]*\r?\n") for before in (rb"\n", rb"\xff\xd9"))


class StreamPart(Struct, frozen=True):
    """One part of the stream."""

    body: bytes  # its bytes, as they came
    stamp_s: float  # its ``X-Timestamp`` in seconds of the sender's clock, NaN if it has none


class Multipart:
    """Takes a stream apart. It reads nothing itself: `feed` gives it bytes, `next_part` takes out what is whole.

    Senders differ, so much is accepted: a boundary that is stated with or without its leading dashes or not at all,
    lines that end in LF or CRLF, a ``Content-Length`` or none. A part ends at its length or at the next boundary,
    whichever comes first, so one that was cut short swallows no part after it. Without a length it also ends where
    what came so far ends like a JPEG, since many senders write the boundary only when the next picture is there.
    Lengths that do not fit are not looked at any more: some senders count other bytes, or write 0.

    Args:
        boundary: What the ``Content-Type`` states; empty for any line that begins with two dashes.
    """

    def __init__(self, boundary: str) -> None:
        name = boundary.strip().lstrip("-").encode("latin-1", "replace")
        self._delimiter, self._bare_delimiter = _delimiters_of(name)
        self._longest_delimiter = len(name) + 80
        self._data = bytearray(b"\n")
        self._body_at: int | None = None
        self._length: int | None = None
        self._lengths_fit = True
        self._stamp_s = math.nan
        self._searched = 0

    @property
    def has_begun(self) -> bool:
        """True if bytes of the picture after the last part are here. Its header lines alone are not: many send them."""
        return self._body_at is not None and len(self._data) > self._body_at

    def feed(self, data: bytes) -> None:
        """Take the next bytes of the stream."""
        self._data += data

    def next_part(self) -> StreamPart | None:
        """Take out the next part; None if it is not whole yet.

        Raises:
            LinkLostError: What comes is no such stream: a part or its header lines do not end.
        """
        if self._body_at is None and not self._read_head():
            return None
        end = self._end_of_body()
        if end is None:
            if len(self._data) > PART_MAX_BYTES:
                raise LinkLostError(f"a part of the stream is larger than {PART_MAX_BYTES / 1e6:.0f} MB")
            return None
        part = StreamPart(bytes(self._data[self._body_at : end]), self._stamp_s)
        self._data[:end] = b"\n"  # the next delimiter may have no line end of its own
        self._body_at, self._searched = None, 0
        return part

    def _read_head(self) -> bool:
        delimiter = self._delimiter.search(self._data)
        if delimiter is None and (other := _MULTIPART.search(self._data)):  # the header stated another boundary
            self._delimiter, self._bare_delimiter = _delimiters_of(other[1])
            delimiter = self._delimiter.search(self._data)
        if delimiter is None:
            del self._data[: -self._longest_delimiter]
            return False
        begin = delimiter.end() - 1  # with the end of the boundary's line, which a blank line may follow at once
        head = _END_OF_HEAD.search(self._data, begin, begin + HEAD_MAX_BYTES)
        if head is None:
            if len(self._data) - begin > HEAD_MAX_BYTES:
                raise LinkLostError("the header lines of a part of the stream do not end")
            return False
        lines = bytes(self._data[begin : head.end()])
        length, stamp = _LENGTH.search(lines), _STAMP.search(lines)
        self._length = int(length[1]) if length else None
        self._stamp_s = float(stamp[1]) if stamp else math.nan
        self._body_at = self._searched = head.end()
        return True

    def _end_of_body(self) -> int | None:
        begin, came = self._body_at or 0, len(self._data)
        whole = begin + self._length if self._length is not None and self._lengths_fit else came
        limit = min(came, whole)
        first = max(begin, self._searched - self._longest_delimiter)
        found = self._delimiter.search(self._data, first, limit)
        at = limit if found is None else found.start()
        if bare := self._bare_delimiter.search(self._data, first, at):
            found, at = bare, bare.start() + 2
        end = _JPEG_END.search(self._data, max(begin, at - 8), at)
        self._searched = limit
        if found is not None:
            # A whole picture that ends before its length: the length is wrong. One that was cut short has no such end.
            self._lengths_fit = self._lengths_fit and (end is None or at + 2 >= whole or self._length is None)
            return at
        if came < whole:
            return None
        if end is None and self._length is not None and self._lengths_fit:
            if self._data.startswith((b"\r", b"\n", b"-"), whole):
                return whole  # a picture that was cut short before it was counted: the boundary begins there
            self._lengths_fit = whole == came  # else a picture goes on there
        return end.start() + 2 if end else None


READ_BYTES = 1 << 16

# Greatest amount of waiting data that is passed over at a time: more than the kernel's buffers hold, and less than for
# ever.
DRAIN_MAX_BYTES = 32 << 20

SNIFFED_BYTES = 1024

_CHUNK = re.compile(rb"(?:\r\n)?([0-9a-fA-F]{1,8})[^\r\n]{0,200}\r\n")


class MjpegStream:
    """An open stream, read as ``cv2.VideoCapture`` is: `grab` waits for a picture, `retrieve` decodes it.

    `grab` takes the newest picture that has arrived. What waited longer, since this program was held up, is passed over
    without being decoded; ``CAP_PROP_POS_FRAMES`` counts it. ``CAP_PROP_POS_MSEC`` is the sender's time stamp of the
    picture, 0 if it has none. `has_begun` tells whether it began to arrive without a pause after the one before (see
    `_Pauses`): always, where the link is slower than the stream. `came_before` tells whether it is an old picture that
    is sent again, byte for byte; it may have been passed over at first.

    Args:
        begin: What was read of the body already.
        seen: What came before, on earlier connections too.
    """

    has_begun: bool | None = None
    came_before = False

    def __init__(
        self,
        body: _Body,
        boundary: str,
        begin: bytes,
        read_timeout_s: float,
        seen: SeenPictures,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._monotonic = monotonic
        self._body = body
        self._seen = seen
        self._read_timeout_s = read_timeout_s
        self._parts = Multipart(boundary)
        self._parts.feed(begin)
        self._part = StreamPart(b"", math.nan)
        self._jpegs = JpegStream()
        self._pauses = _Pauses()
        self._received = 0

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's name and meaning
        """Check whether pictures may come."""
        return not self._body.response.isclosed()

    def grab(self) -> bool:
        """Wait for the newest picture; return whether one came within the read time-out."""
        deadline_s = self._monotonic() + self._read_timeout_s
        try:
            return self._newest_part(deadline_s)
        except (OSError, LinkLostError, ValueError):
            return False

    def retrieve(self) -> tuple[bool, Image | None]:
        """Return the picture that was grabbed, or that it is damaged."""
        try:
            return True, self._jpegs.decode(self._part.body)
        except PictureError:
            return False, None

    def get(self, prop: int, /) -> float:
        """Return a property: the time stamp or the number of pictures that came so far."""
        if prop == cv2.CAP_PROP_POS_MSEC:
            return 0.0 if math.isnan(self._part.stamp_s) else 1e3 * self._part.stamp_s
        return float(self._received) if prop == cv2.CAP_PROP_POS_FRAMES else 0.0

    def set(self, _prop: int, _value: float, /) -> bool:
        """Return that the sender takes no settings."""
        return False

    def release(self) -> None:
        """Hang up."""
        self._body.response.close()

    def _newest_part(self, deadline_s: float) -> bool:
        came, passed_bytes = False, 0
        while True:
            while (part := self._parts.next_part()) is not None:
                self._part, came = part, True
                self._received += 1
                read_at_s = self._monotonic()
                self.came_before = self._seen.note(zlib.crc32(part.body), read_at_s)
                self.has_begun = self._pauses.end_picture(len(part.body), read_at_s)
            read_at_s = self._monotonic()
            wait_s = 0.0 if came else max(0.0, deadline_s - read_at_s)
            if passed_bytes > DRAIN_MAX_BYTES or (data := self._body.read(wait_s)) is None:
                if came:
                    self._pauses.has_begun = self._parts.has_begun
                return came
            self._pauses.note_read(read_at_s, self._monotonic(), len(data), is_inside=self._parts.has_begun)
            self._parts.feed(data)
            passed_bytes += len(data)


# A read that takes less time found its bytes waiting.
WAITED_S = 5e-4

# A picture of fewer bytes has too few packets to say how far apart they come: its last one may be short.
JUDGED_BYTES = 4 * 1448

# A link that is slower than its stream is never idle. It was before a picture if it was for so many times the longest
# wait for a packet, and was not if for less than `NO_PAUSE`. With 20 packets in a picture that tells a link that is
# busy for 85 % of the time from one that is busy all of it.
PAUSE = 1.5
NO_PAUSE = 0.5


class _Pauses:
    """Tells whether a stream pauses between pictures, by when its bytes are read.

    Packets may end with pictures, as a queue on the way leaves them. Then the next picture has never begun to arrive
    when one is whole; but it comes as soon after it as another packet would.

    Attributes:
        has_begun: Whether bytes of the next picture were here as soon as the last one was taken.
    """

    def __init__(self) -> None:
        self._longest_s = 0.0
        self._ended_s = self._first_s = self._last_s = math.nan
        self._start()

    def _start(self) -> None:
        self.has_begun = self._is_awaited = False
        self._longest_before_s, self._longest_s = self._longest_s, 0.0
        self._first_bytes = self._other_bytes = 0

    def note_read(self, looked_s: float, read_s: float, size_bytes: int, *, is_inside: bool) -> None:
        """Note bytes that were read; `is_inside` if others of the same picture were here before."""
        if is_inside:
            self._longest_s = max(self._longest_s, read_s - looked_s)
            self._other_bytes += size_bytes
            self._last_s = read_s
        else:
            self._first_s = self._last_s = read_s
            self._first_bytes, self._is_awaited = size_bytes, read_s - looked_s > WAITED_S

    def end_picture(self, size_bytes: int, now_s: float) -> bool | None:
        """Check whether a picture, which is whole, began without a pause; None if that does not show.

        It does not where most of it was here before the reader looked.
        """
        has_begun = True if self.has_begun else self._judge(size_bytes)
        self._ended_s = now_s
        self._start()
        return has_begun

    def _judge(self, size_bytes: int) -> bool | None:
        packet_s = max(self._longest_s, self._longest_before_s)
        if size_bytes < JUDGED_BYTES or not self._first_bytes:
            return None
        if self._other_bytes >= self._first_bytes:
            came_for_s = (self._last_s - self._first_s) * self._first_bytes / self._other_bytes
        elif self._is_awaited:
            came_for_s = packet_s
        else:
            return None
        idle_s = self._first_s - self._ended_s - came_for_s
        if idle_s > PAUSE * packet_s:
            return False
        return True if idle_s < NO_PAUSE * packet_s else None


def open_mjpeg(address: str, open_timeout_s: float, read_timeout_s: float, seen: SeenPictures) -> MjpegStream | None:
    """Ask an address for a stream of pictures; None if it answers with something else, such as HLS or MP4.

    Redirections are followed, within limits. User and password in the address answer a sender that asks for them, and
    go to no other host. The time limit to open is that of each step of the connection.

    Raises:
        DeviceOpenError: It does not answer, or refuses; the message says why, without the address.
    """
    try:
        response = _opener(address).open(_without_user(address), timeout=open_timeout_s)
        return _stream_of(response, read_timeout_s, seen)
    except DeviceOpenError:
        raise
    except HTTPError as error:
        error.close()
        traceback.clear_frames(error.__traceback__)  # they hold the answers to earlier tries, with their sockets
        phrase = http.client.responses.get(error.code, "")  # the error's own words may hold an address
        hint = ": check user and password" if error.code == http.client.UNAUTHORIZED else ""
        raise DeviceOpenError(f"its sender answers {error.code} {phrase}".rstrip() + hint) from error
    except OSError as error:
        raise DeviceOpenError(_why_unreached(getattr(error, "reason", error), urlsplit(address))) from error
    except (http.client.HTTPException, ValueError, LinkLostError) as error:  # their words may hold a part of a password
        raise DeviceOpenError("its address is not right, or its sender does not answer as a web server") from error


def _why_unreached(reason: object, address: SplitResult) -> str:
    """Say why there is no answer: of TLS, its own reason, and that the port may be the other one."""
    if isinstance(reason, ssl.SSLCertVerificationError):
        authority = "add its authority to those of this computer, with update-ca-certificates, or use http"
        return f"its certificate {not_trusted(reason, address.hostname or '', authority)}"
    words, other = f"its sender does not answer ({reason})", "http" if address.scheme == "https" else "https"
    is_other = isinstance(reason, (ssl.SSLError, ConnectionResetError)) or "handshake" in str(reason)
    return f"{words}; is it {other} in place of {address.scheme}?" if is_other else words


def _stream_of(response: http.client.HTTPResponse, read_timeout_s: float, seen: SeenPictures) -> MjpegStream | None:
    body = _Body(response)
    if response.headers.get_content_maintype() == "multipart":
        boundary = str(response.headers.get_param("boundary") or "")
        return MjpegStream(body, boundary, b"", read_timeout_s, seen)
    # FFmpeg, and what is made with it, sends such streams as bytes of no type; it would also recognise them by this.
    begin = b""
    deadline_s = time.monotonic() + read_timeout_s
    while len(begin) < SNIFFED_BYTES and (data := body.read(max(0.0, deadline_s - time.monotonic()))) is not None:
        begin += data
        if found := _MULTIPART.match(begin):
            return MjpegStream(body, found[1].decode("latin-1"), begin, read_timeout_s, seen)
    response.close()
    is_whole = begin.startswith(b"\xff\xd8") and response.length is not None
    is_whole = is_whole and not response.url.lower().endswith((".mjpeg", ".mjpg"))  # pictures behind one another
    if is_whole or response.headers.get_content_type().startswith(("image/", "text/html")):
        what = "a page" if begin.lstrip().startswith(b"<") else "one picture"
        raise DeviceOpenError(f"it gives {what}, not a stream; look for the camera's address of MJPEG or RTSP")
    return None


def _opener(address: str) -> urllib.request.OpenerDirector:
    """Return the opener that asks for an address: HTTP only, without proxies, so that no redirection reads a file."""
    parts = urlsplit(address)
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.UnknownHandler(),
        urllib.request.HTTPDefaultErrorHandler(),
        urllib.request.HTTPRedirectHandler(),
        urllib.request.HTTPErrorProcessor(),
        HttpLogin(unquote(parts.username or ""), unquote(parts.password or ""), parts.netloc.rpartition("@")[2]),
        urllib.request.HTTPHandler(),
        urllib.request.HTTPSHandler(),
    ):
        opener.add_handler(handler)
    return opener


def _without_user(address: str) -> str:
    parts = urlsplit(address)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()


class _Body:
    """The body of an answer after its headers, read from the socket: the library waits for as much as was asked for."""

    def __init__(self, response: http.client.HTTPResponse) -> None:
        self.response = response
        self._sock: socket.socket = response.fp.raw._sock  # type: ignore[attr-defined] # noqa: SLF001 - no other way
        self._chunks = _Chunks() if response.chunked else None
        self._already_read = self._read_with_the_headers()

    def read(self, wait_s: float) -> bytes | None:
        """Return the next bytes, or None if none come within the time or the sender has ended.

        Raises:
            LinkLostError: They are not encoded as the sender says.
            OSError: The connection is lost.
        """
        data, self._already_read = self._already_read, b""
        if not data:
            data = self._sock.recv(READ_BYTES) if self._has_data(wait_s) else b""
        if not data:
            return None
        return self._chunks.without_sizes(data) if self._chunks else data

    def _read_with_the_headers(self) -> bytes:
        timeout_s = self._sock.gettimeout()
        self._sock.settimeout(0.0)
        try:
            return self.response.fp.read1(READ_BYTES) or b""
        except OSError:
            return b""
        finally:
            self._sock.settimeout(timeout_s)

    def _has_data(self, wait_s: float) -> bool:
        decrypted = getattr(self._sock, "pending", None)  # of TLS
        if decrypted is not None and decrypted():
            return True
        return bool(select.select([self._sock], [], [], wait_s)[0])


class _Chunks:
    """Takes the sizes out of ``Transfer-Encoding: chunked`` (RFC 9112, section 7.1)."""

    def __init__(self) -> None:
        self._rest = b""
        self._left = 0

    def without_sizes(self, data: bytes) -> bytes:
        """Return the data in the next bytes, or raise a `LinkLostError` if they are not chunked as they should be."""
        data, self._rest = self._rest + data, b""
        found: list[bytes] = []
        while data:
            if not self._left:
                size = _CHUNK.match(data)
                if size is None:
                    if len(data) > 256:
                        raise LinkLostError("the stream is not chunked as it says")
                    self._rest = data
                    break
                data, self._left = data[size.end() :], int(size[1], 16)
                continue
            found.append(data[: self._left])
            data, self._left = data[self._left :], self._left - len(found[-1])
        return b"".join(found)
