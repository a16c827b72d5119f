"""Families of networks: what each wants to see, what its outputs mean, and how to tell one by its file."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np
from msgspec import Struct

from stadimeter.detectors.object.boxes import (
    DISTANCE_BINS,
    MAX_LOG_SIZE,
    NANODET_STRIDES,
    STRIDES,
    Boxes,
    Outputs,
    WantedClass,
    centred,
    count_cells,
    decode_nanodet,
    decode_yolov8,
    decode_yolox,
    grid_cells,
)
from stadimeter.detectors.object.model_file import ModelFile, Shape

# Meaning of the outputs of YuNet and CenterFace: faces with five landmarks, of which the first two are the eyes ---

# A cell of CenterFace's maps is this many pixels of the input.
CENTERFACE_STRIDE = 4

# The kinds of YuNet's outputs, each with how many figures a cell has; one output for each kind and stride.
YUNET_OUTPUTS = {"cls": 1, "obj": 1, "bbox": 4, "kps": 10}

EYES = 2


def decode_yunet(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read twelve outputs ``(1, n, figures)``: those of each kind for the strides 8, 16 and 32.

    W. Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", 2023: score = √(face · thing), centre = (cell +
    offset) · stride, size = exp(figure) · stride, landmark = (cell + offset) · stride.
    """
    faces, things, boxes, marks = (
        np.concatenate([each[0] for each in outputs[first : first + len(STRIDES)]]).astype(np.float64)
        for first in range(0, len(YUNET_OUTPUTS) * len(STRIDES), len(STRIDES))
    )
    scores = np.sqrt(faces[:, 0].clip(0, 1) * things[:, 0].clip(0, 1))
    which = np.flatnonzero(scores >= wanted.min_score)
    cells, strides = grid_cells(wanted.width, wanted.height, STRIDES)
    cell, stride = cells[which], strides[which, None]
    sizes = np.exp(boxes[which, 2:].clip(max=MAX_LOG_SIZE)) * stride
    corners = centred((cell + boxes[which, :2]) * stride, sizes)
    eyes = (cell[:, None] + marks[which, : 2 * EYES].reshape(-1, EYES, 2)) * stride[:, None]
    return Boxes(corners, scores[which], eyes)


def decode_centerface(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read four maps ``(1, c, rows, columns)``: score, size, offset, and landmarks, each as y and x.

    Y. Xu et al., "CenterFace: Joint Face Detection and Alignment Using Face as Point", arXiv 1911.03599: size =
    exp(figure) · 4, centre = (cell + offset + 1/2) · 4, landmarks in shares of the box.
    """
    score, log_size, offset, marks = (each[0] for each in outputs)
    rows, columns = np.nonzero(score[0] >= wanted.min_score)
    sizes = np.exp(log_size[::-1, rows, columns].T.astype(np.float64).clip(max=MAX_LOG_SIZE)) * CENTERFACE_STRIDE
    cells = np.column_stack((columns, rows)) + offset[::-1, rows, columns].T + 0.5
    corners = centred(cells * CENTERFACE_STRIDE, sizes)
    shares = marks[: 2 * EYES, rows, columns].T.astype(np.float64).reshape(-1, EYES, 2)[:, :, ::-1]
    eyes = corners[:, None, :2] + shares * sizes[:, None]
    return Boxes(corners, score[0, rows, columns].astype(np.float64), eyes)


# ----------------------------------------------------------------------------------------------------

FamilyName = Literal["yolox", "yolov8", "nanodet", "yunet", "centerface"]

# The 80 classes of Microsoft COCO (cocodataset.org) in the order that networks trained on it have them.
_COCO = (
    "person,bicycle,car,motorcycle,airplane,bus,train,truck,boat,traffic light,fire hydrant,stop sign,parking meter,"
    "bench,bird,cat,dog,horse,sheep,cow,elephant,bear,zebra,giraffe,backpack,umbrella,handbag,tie,suitcase,frisbee,"
    "skis,snowboard,sports ball,kite,baseball bat,baseball glove,skateboard,surfboard,tennis racket,bottle,wine glass,"
    "cup,fork,knife,spoon,bowl,banana,apple,sandwich,orange,broccoli,carrot,hot dog,pizza,donut,cake,chair,couch,"
    "potted plant,bed,dining table,toilet,tv,laptop,mouse,remote,keyboard,cell phone,microwave,oven,toaster,sink,"
    "refrigerator,book,clock,vase,scissors,teddy bear,hair drier,toothbrush"
)
COCO = tuple(_COCO.split(","))

FACE = ("face",)

# What the sides of an input are multiples of, where the file leaves its size open.
MULTIPLE = 32


class NetworkFamily(Struct, frozen=True, kw_only=True):
    """A kind of network.

    Attributes:
        count_classes: Returns how many classes the outputs of these shapes have, in an input of that height and width;
            a ValueError says why they are not those of the family.
        decode: Turns outputs into boxes.
        is_rgb: Whether red comes first.
        mean: What is taken off each channel.
        spread: What each channel is then divided by.
        fill: The level around a picture of another aspect.
        free_px: The longer side of the input where the file leaves it open.
        has_eyes: Whether it finds faces with their eyes.
    """

    count_classes: Callable[[Sequence[Shape], tuple[int | None, int | None]], int]
    decode: Callable[[Outputs, WantedClass], Boxes]
    is_rgb: bool = False
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spread: tuple[float, float, float] = (1.0, 1.0, 1.0)
    fill: int = 114
    free_px: int = 640
    has_eyes: bool = False


def _check_cells(cells: int | None, size: tuple[int | None, int | None], strides: Sequence[int]) -> None:
    height, width = size
    if None in {cells, height, width} or cells is None or height is None or width is None:
        return
    expected = count_cells(width, height, strides)
    if cells != expected:
        raise ValueError(f"it has {cells} rows for an input of {width}x{height}, the family {expected}")


def _rows(shapes: Sequence[Shape]) -> tuple[int | None, int | None]:
    if len(shapes) != 1 or len(shapes[0]) != 3:
        raise ValueError("it has other outputs than one of three sizes")
    return shapes[0][1], shapes[0][2]


def _classes(figures: int | None, others: int, what: str) -> int:
    if figures is None or figures <= others:
        raise ValueError(f"a row has {figures or 'an unknown number of'} figures, the family {what}")
    return figures - others


def _yolox(shapes: Sequence[Shape], size: tuple[int | None, int | None]) -> int:
    cells, figures = _rows(shapes)
    _check_cells(cells, size, STRIDES)
    return _classes(figures, 5, "5 and one for each class")


def _yolov8(shapes: Sequence[Shape], size: tuple[int | None, int | None]) -> int:
    figures, cells = _rows(shapes)
    _check_cells(cells, size, STRIDES)
    return _classes(figures, 4, "4 and one for each class")


def _nanodet(shapes: Sequence[Shape], size: tuple[int | None, int | None]) -> int:
    cells, figures = _rows(shapes)
    _check_cells(cells, size, NANODET_STRIDES)
    return _classes(figures, 4 * DISTANCE_BINS, f"{4 * DISTANCE_BINS} and one for each class")


def _yunet(shapes: Sequence[Shape], size: tuple[int | None, int | None]) -> int:
    expected = [count for count in YUNET_OUTPUTS.values() for _ in STRIDES]
    if len(shapes) != len(expected) or any(
        len(shape) != 3 or shape[2] not in {count, None} for shape, count in zip(shapes, expected, strict=True)
    ):
        raise ValueError("it has other outputs than twelve, cls, obj, bbox and kps of the strides 8, 16 and 32")
    for shape, stride in zip(shapes[: len(STRIDES)], STRIDES, strict=True):
        _check_cells(shape[1], size, (stride,))
    return len(FACE)


def _centerface(shapes: Sequence[Shape], _size: tuple[int | None, int | None]) -> int:
    expected = (1, 2, 2, 10)
    if len(shapes) != len(expected) or any(
        len(shape) != 4 or shape[1] not in {count, None} for shape, count in zip(shapes, expected, strict=True)
    ):
        raise ValueError("it has other outputs than four maps of 1, 2, 2 and 10 figures")
    return len(FACE)


# Levels and order of the channels are those that the networks of each family were trained with.
FAMILIES: Mapping[FamilyName, NetworkFamily] = {
    "yolox": NetworkFamily(count_classes=_yolox, decode=decode_yolox, free_px=416),
    "yolov8": NetworkFamily(count_classes=_yolov8, decode=decode_yolov8, is_rgb=True, spread=(255.0, 255.0, 255.0)),
    "nanodet": NetworkFamily(
        count_classes=_nanodet,
        decode=decode_nanodet,
        mean=(103.53, 116.28, 123.675),
        spread=(57.375, 57.12, 58.395),
        fill=0,
        free_px=416,
    ),
    "yunet": NetworkFamily(count_classes=_yunet, decode=decode_yunet, fill=0, free_px=320, has_eyes=True),
    "centerface": NetworkFamily(
        count_classes=_centerface, decode=decode_centerface, is_rgb=True, fill=0, free_px=256, has_eyes=True
    ),
}


class Recognised(Struct, frozen=True, kw_only=True):
    """A network whose family is known."""

    file: ModelFile
    name: FamilyName
    classes: tuple[str, ...]

    @property
    def family(self) -> NetworkFamily:
        """The meaning of its outputs."""
        return FAMILIES[self.name]

    def number_of(self, wanted: str | None) -> int:
        """Return the number of a class by its name, or by that number; a ValueError says which classes there are.

        Without a name it is that of a face or a person.
        """
        wanted = wanted or (FACE[0] if self.family.has_eyes else "person")
        if wanted in self.classes:
            return self.classes.index(wanted)
        if wanted.isascii() and wanted.isdecimal() and int(wanted) < len(self.classes):
            return int(wanted)
        raise ValueError(f"{wanted!r} is no class of this network; it has: {', '.join(self.classes)}")

    def input_for(self, width_px: int, height_px: int, long_side_px: int | None) -> tuple[int, int]:
        """Return width and height of its input for a picture: those of the file, or of the picture's aspect."""
        height, width = self.file.input_size
        if width is not None and height is not None:
            return width, height
        scale = (long_side_px or self.family.free_px) / max(width_px, height_px)
        columns, rows = (max(1, round(side * scale / MULTIPLE)) * MULTIPLE for side in (width_px, height_px))
        return columns, rows


def recognise(file: ModelFile, name: FamilyName | None) -> Recognised:
    """Return a network as one of the named family, or of the only one that fits; a ValueError says what is wrong."""
    reasons: dict[str, str] = {}
    found: list[Recognised] = []
    for each in FAMILIES if name is None else (name,):
        try:
            found.append(Recognised(file=file, name=each, classes=_class_names(file, each)))
        except ValueError as error:
            reasons[each] = str(error)
    if len(found) == 1:
        return found[0]
    if found:
        fitting = " or ".join(each.name for each in found)
        raise ValueError(f"its outputs may be those of {fitting}; say which with family")
    told = "; ".join(f"not {each}: {why}" for each, why in reasons.items())
    outputs = ", ".join(map(str, file.outputs[:4])) + (", …" if len(file.outputs) > 4 else "")
    raise ValueError(f"its outputs ({outputs}) are of no known family. {told}")


def _class_names(file: ModelFile, name: FamilyName) -> tuple[str, ...]:
    """Return the names of the classes: as noted in the file, those of COCO if there are 80, or else numbers."""
    family = FAMILIES[name]
    count = family.count_classes([each.shape for each in file.outputs], file.input_size)
    if family.has_eyes:
        return FACE
    noted = _noted_names(file.notes.get("names", ""))
    if len(noted) == count:
        return noted
    return COCO if count == len(COCO) else tuple(map(str, range(count)))


def _noted_names(text: str) -> tuple[str, ...]:
    """Return the names that ultralytics notes as ``{0: 'person', 1: 'bicycle'}``; none of what is no such text."""
    try:
        names = ast.literal_eval(text)
        return tuple(str(names[number]) for number in range(len(names)))
    except (ValueError, SyntaxError, LookupError, TypeError, MemoryError, RecursionError):
        return ()
