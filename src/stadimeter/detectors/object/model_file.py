"""Reading what an ONNX file says of itself: its inputs and outputs, and what was noted in it.

The format is a protocol buffer (github.com/onnx/onnx, onnx.proto). Only a few of its fields matter here, so they are
read by hand: neither engine needs to be loaded to check a configuration, and OpenCV does not tell them.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from msgspec import Struct

from stadimeter.config.files import read_untrusted

# YOLOv8s has 45 MB. A larger network takes a second a picture on a Pi, and its memory would not be there.
MODEL_MAX_BYTES = 60_000_000

# A network of 60 MB has some thousand fields; weights are one field each.
MAX_FIELDS = 1_000_000

# Field numbers of onnx.proto, by message.
_PRODUCER, _GRAPH, _NOTES = 2, 7, 14
_INITIALIZER, _INPUT, _OUTPUT, _BETWEEN = 5, 11, 12, 13
_INITIALIZER_NAME = 8
_NAME, _TYPE = 1, 2
_TENSOR, _SHAPE, _DIMENSION, _SIZE = 1, 2, 1, 1

# How a size begins, a varint in field 1, and how one in a field that no reader knows does.
_SIZE_TAG, _NO_TAG = 0x08, 0x78

# An input smaller than this stands in a file for one of any size: exporters write what they were run with.
MIN_INPUT_PX = 64

Shape = tuple[int | None, ...]


class Tensor(Struct, frozen=True):
    """An input or output; a size that the file leaves open is None."""

    name: str
    shape: Shape

    def __str__(self) -> str:
        """Return it as ``images 1x3x416x416``."""
        return f"{self.name} {'x'.join('?' if size is None else str(size) for size in self.shape)}"


class ModelFile(Struct, frozen=True, kw_only=True):
    """A network as its file describes it; the file itself is in `data`."""

    path: Path
    data: bytes
    producer: str
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    notes: dict[str, str]

    @property
    def input_size(self) -> tuple[int | None, int | None]:
        """Height and width of its input; None for any."""
        height, width = self.inputs[0].shape[2:]
        return (None, None) if min(height or 0, width or 0) < MIN_INPUT_PX else (height, width)

    def of_any_size(self) -> bytes:
        """Return the file with every size of inputs and outputs left open, for an engine that insists on them."""
        changed = bytearray(self.data)
        graphs = [value for number, value in _fields(memoryview(changed)) if number == _GRAPH]
        for number, value in _fields(graphs[0]):
            if number in {_INPUT, _OUTPUT, _BETWEEN}:
                for dimension in _dimensions(value):
                    # In another field the size is skipped, and no length in the file changes.
                    if len(dimension) and dimension[0] == _SIZE_TAG:
                        dimension[0] = _NO_TAG
        return bytes(changed)


def load_model(path: Path) -> ModelFile:
    """Read a network's file; the newest one is kept, since a configuration is checked before it is run.

    Raises:
        UnreadableError: It cannot be read, or is larger than `MODEL_MAX_BYTES`.
        ValueError: It is no ONNX file, or has not one input for a picture.
    """
    status = path.stat() if path.is_file() else None
    return _load(path, status and status.st_mtime_ns, status and status.st_size)


@lru_cache(maxsize=1)
def _load(path: Path, _changed: int | None, _bytes: int | None) -> ModelFile:
    return parse_model(path, read_untrusted(path, MODEL_MAX_BYTES))


def parse_model(path: Path, data: bytes) -> ModelFile:
    """Read what the bytes of a file say; raises ValueError as `load_model` does."""
    parts: dict[int, list[memoryview]] = {_PRODUCER: [], _GRAPH: [], _NOTES: []}
    try:
        for number, value in _fields(memoryview(data)):
            if number in parts and isinstance(value, memoryview):
                parts[number].append(value)
        graph = list(_fields(parts[_GRAPH][0]))
        weights = {_text(_of(value, _INITIALIZER_NAME)) for number, value in graph if number == _INITIALIZER}
        inputs, outputs = (
            tuple(_tensor(value) for number, value in graph if number == wanted) for wanted in (_INPUT, _OUTPUT)
        )
        notes = {_text(_of(each, 1)): _text(_of(each, 2)) for each in parts[_NOTES]}
        producer = "".join(_text(each) for each in parts[_PRODUCER])
    except (IndexError, TypeError, UnicodeDecodeError, ValueError) as error:
        raise ValueError("it is no ONNX file, or is cut short; copy it again, or export the network to ONNX") from error
    inputs = tuple(each for each in inputs if each.name not in weights)  # old exporters list weights as inputs
    if len(inputs) != 1 or len(inputs[0].shape) != 4 or inputs[0].shape[1] not in {3, None} or not outputs:
        told = ", ".join(map(str, inputs)) or "none"
        raise ValueError(f"its input is not one picture of 1x3xHEIGHTxWIDTH: {told}; export it for one colour picture")
    return ModelFile(path=path, data=data, producer=producer, inputs=inputs, outputs=outputs, notes=notes)


def _dimensions(message: memoryview | int) -> list[memoryview]:
    shape = _of(_of(_of(message, _TYPE), _TENSOR), _SHAPE)
    return [each for number, each in _fields(shape) if number == _DIMENSION and isinstance(each, memoryview)]


def _tensor(message: memoryview | int) -> Tensor:
    sizes = (dict(_fields(each)).get(_SIZE) for each in _dimensions(message))
    # A size below 1, or one with a name instead of a number, is left open.
    return Tensor(
        _text(_of(message, _NAME)), tuple(size if isinstance(size, int) and size > 0 else None for size in sizes)
    )


def _of(message: memoryview | int, wanted: int) -> memoryview:
    """Return a field of a message; empty where it is left out."""
    found = [value for number, value in _fields(message) if number == wanted and isinstance(value, memoryview)]
    return found[-1] if found else memoryview(b"")


def _text(value: memoryview) -> str:
    return bytes(value).decode()


def _fields(message: memoryview | int) -> Iterator[tuple[int, memoryview | int]]:
    """Yield number and value of each field (protobuf.dev, "Encoding"); a TypeError for what is no message."""
    if isinstance(message, int):
        raise TypeError("a number stands where a message is expected")
    at = 0
    for _ in range(MAX_FIELDS):
        if at >= len(message):
            return
        tag, at = _varint(message, at)
        number, wire = tag >> 3, tag & 7
        if wire == 0:
            value, at = _varint(message, at)
            yield number, value
        else:
            length, at = _varint(message, at) if wire == 2 else ({1: 8, 5: 4}[wire] if wire in {1, 5} else -1, at)
            if not 0 <= length <= len(message) - at:
                raise ValueError("a field ends beyond its message")
            yield number, message[at : at + length]
            at += length
    raise ValueError("too many fields")


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number of more than ten bytes")
