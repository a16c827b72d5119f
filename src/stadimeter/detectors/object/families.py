"""Families of networks: what each wants to see, what its outputs mean, and how to tell one by its file."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.detection import Indices, Points, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.object.model_file import ModelFile, Shape

# Meaning of the outputs of YOLOX, YOLOv8 and NanoDet-Plus: a row of figures for each cell of grids --------------------
#
# A grid of stride s has a cell for each s by s pixels of the input, row by row; the grids of a family follow each
# other, the finest first. Every function takes the outputs of one picture and returns boxes in pixels of the input,
# with the scores of one class where no other class scores higher.

Outputs = Sequence[NDArray[np.float32]]

STRIDES = (8, 16, 32)
NANODET_STRIDES = (8, 16, 32, 64)

# NanoDet-Plus gives the distance to each side as the probabilities of 0 to 7 strides.
DISTANCE_BINS = 8

# exp() of more than this is a box of a thousand cells.
MAX_LOG_SIZE = 7.0


class WantedClass(NamedTuple):
    """The class to look for in the outputs: by its number, from a score on, in an input of this size."""

    number: int
    min_score: float
    width: int
    height: int


def count_cells(width: int, height: int, strides: Sequence[int]) -> int:
    """Count the cells that the grids of an input have."""
    return sum(-(-width // stride) * -(-height // stride) for stride in strides)


@lru_cache(maxsize=8)
def grid_cells(width: int, height: int, strides: tuple[int, ...]) -> tuple[Points, Values]:
    """Return column and row of each cell, shape ``(n, 2)``, and its stride, shape ``(n,)``; not to be changed."""
    cells, sizes = [], []
    for stride in strides:
        rows, columns = np.mgrid[: -(-height // stride), : -(-width // stride)]
        cells.append(np.column_stack((columns.ravel(), rows.ravel())).astype(np.float64))
        sizes.append(np.full(rows.size, float(stride)))
    return np.concatenate(cells), np.concatenate(sizes)


def decode_yolox(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read ``(1, n, 5 + classes)``: offset in the cell, logarithm of the size, probability of a thing, classes.

    Z. Ge et al., "YOLOX: Exceeding YOLO Series in 2021", arXiv 2107.08430: centre = (cell + offset) · stride,
    size = exp(figure) · stride, score = probability of a thing · probability of the class.
    """
    rows = outputs[0][0]
    which, scores = _likely(rows[:, 5:], wanted, rows[:, 4])
    cells, strides = grid_cells(wanted.width, wanted.height, STRIDES)
    figures, stride = rows[which, :4].astype(np.float64), strides[which, None]
    sizes = np.exp(figures[:, 2:].clip(max=MAX_LOG_SIZE)) * stride
    return Boxes(centred((cells[which] + figures[:, :2]) * stride, sizes), scores)


def decode_yolov8(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read ``(1, 4 + classes, n)``: centre and size in pixels of the input, and the score of each class."""
    rows = outputs[0][0].T
    which, scores = _likely(rows[:, 4:], wanted)
    figures = rows[which, :4].astype(np.float64)
    return Boxes(centred(figures[:, :2], figures[:, 2:]), scores)


def decode_nanodet(outputs: Outputs, wanted: WantedClass) -> Boxes:
    """Read ``(1, n, classes + 4 · 8)``: the score of each class, and how far off each side of the box is.

    X. Li et al., "Generalized Focal Loss", arXiv 2006.04388: the distance to a side is the mean of 0 to 7 strides,
    weighted by the softmax of its eight figures.
    """
    rows = outputs[0][0]
    classes = rows.shape[1] - 4 * DISTANCE_BINS
    which, scores = _likely(rows[:, :classes], wanted)
    cells, strides = grid_cells(wanted.width, wanted.height, NANODET_STRIDES)
    figures, stride = rows[which, classes:].astype(np.float64).reshape(-1, 4, DISTANCE_BINS), strides[which, None]
    weights = np.exp(figures - figures.max(axis=2, keepdims=True))
    distances = weights @ np.arange(DISTANCE_BINS) / weights.sum(axis=2) * stride
    centres = cells[which] * stride
    return Boxes(np.hstack((centres - distances[:, :2], centres + distances[:, 2:])), scores)


def _likely(
    classes: NDArray[np.float32], wanted: WantedClass, things: NDArray[np.float32] | None = None
) -> tuple[Indices, Values]:
    """Return the rows in which the class scores enough and best, and its score there."""
    scores = classes[:, wanted.number] if things is None else classes[:, wanted.number] * things
    which = np.flatnonzero(scores >= wanted.min_score)
    which = which[classes[which, wanted.number] >= classes[which].max(axis=1, initial=0.0)]
    return which, scores[which].astype(np.float64)


# Boxes: how a picture is fitted to an input, and which of many boxes are one thing each -------------------------------
#
# A network's coordinates begin at the outer edge of its first pixel, so pixel i reaches from i to i + 1. Those of a
# picture begin at the centre of that pixel, half a pixel further in.

# Boxes that share more of their common area than this are one thing: the usual limit of all five families.
MAX_OVERLAP = 0.45

# Only so many of the likeliest boxes are compared. A crowd of a hundred has some thousand, most of one thing each.
MAX_BOXES = 300

# Below this scale the mean of all pixels is taken; above it four neighbours do, in a third of the time.
MEAN_BELOW = 0.5


class Boxes(NamedTuple):
    """Boxes with the score of each.

    Attributes:
        corners: Left, top, right and bottom, shape ``(n, 4)``.
        scores: How sure the network is of each, 0 to 1, shape ``(n,)``.
        eyes: Of faces, where both eyes are, shape ``(n, 2, 2)``; None of other things.
        scale: How many pixels of the network's input a pixel was when it saw them.
    """

    corners: Values
    scores: Values
    eyes: Points | None = None
    scale: float = 1.0

    def take(self, which: Indices) -> Boxes:
        """Return some of them, in this order."""
        eyes = None if self.eyes is None else self.eyes[which]
        return self._replace(corners=self.corners[which], scores=self.scores[which], eyes=eyes)


class FittedPicture(NamedTuple):
    """A picture in the upper left of a network's input; what is left over is filled with one level."""

    image: Image
    scale_x: float
    scale_y: float

    def in_picture(self, boxes: Boxes) -> Boxes:
        """Return boxes in the pixels of the picture."""
        scale = np.array((self.scale_x, self.scale_y))
        corners = boxes.corners.reshape(-1, 2, 2) / scale - 0.5
        eyes = None if boxes.eyes is None else boxes.eyes / scale - 0.5
        # What is enlarged is no more exact.
        return Boxes(corners.reshape(-1, 4), boxes.scores, eyes, min(self.scale_x, self.scale_y, 1.0))


def fit_picture(image: Image, width: int, height: int, fill: int) -> FittedPicture:
    """Scale a picture to a network's input without changing its aspect."""
    rows, columns = image.shape[:2]
    scale = min(width / columns, height / rows)
    inner = min(width, max(1, round(columns * scale))), min(height, max(1, round(rows * scale)))
    how = cv2.INTER_AREA if scale < MEAN_BELOW else cv2.INTER_LINEAR
    small = np.asarray(cv2.resize(image, inner, interpolation=how), np.uint8)
    if inner != (width, height):
        around = height - inner[1], width - inner[0]
        small = np.asarray(
            cv2.copyMakeBorder(small, 0, around[0], 0, around[1], cv2.BORDER_CONSTANT, value=(fill, fill, fill)),
            np.uint8,
        )
    return FittedPicture(small, inner[0] / columns, inner[1] / rows)


def centred(centres: Points, sizes: Points) -> Values:
    """Return the corners of boxes by centre and size, both of shape ``(n, 2)``."""
    return np.hstack((centres - sizes / 2, centres + sizes / 2))


def one_each(boxes: Boxes) -> Boxes:
    """Return the likeliest box of each thing, the likeliest first: non-maximum suppression.

    A box is left out if its overlap with a likelier one, the area that both cover as a share of the area that either
    covers, is above `MAX_OVERLAP`. Boxes that are no numbers, or have no area, are left out too.
    """
    sides = boxes.corners[:, 2:] - boxes.corners[:, :2]
    usable = np.flatnonzero(np.isfinite(boxes.corners).all(axis=1) & (sides > 0).all(axis=1))
    # Stable, so that of equal scores the first box comes first on every machine.
    rest = usable[np.argsort(-boxes.scores[usable], kind="stable")][:MAX_BOXES]
    kept = []
    while len(rest):
        kept.append(rest[0])
        rest = rest[1:][overlaps(boxes.corners[rest[0]], boxes.corners[rest[1:]]) <= MAX_OVERLAP]
    return boxes.take(np.array(kept, np.intp))


def overlaps(one: Values, others: Values) -> Values:
    """Return the overlap of a box with each of others, 0 to 1: intersection over union."""
    low, high = np.maximum(one[:2], others[:, :2]), np.minimum(one[2:], others[:, 2:])
    common = (high - low).clip(0.0).prod(axis=1)
    areas = (others[:, 2:] - others[:, :2]).prod(axis=1)
    return np.asarray(common / (np.prod(one[2:] - one[:2]) + areas - common))


# Meaning of the outputs of YuNet and CenterFace: faces with five landmarks, of which the first two are the eyes -------

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
    middles = eyes.mean(axis=1, keepdims=True)
    eyes = middles + (eyes - middles) / CENTERFACE_EYES_APART
    return Boxes(corners, score[0, rows, columns].astype(np.float64), eyes)


# The families, and which of them a file is of -------------------------------------------------------------------------

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


# Both ends of a length together err by this many pixels of the input, as a standard deviation. Measured at 16 to 200 px
# on 33 people and 62 faces in pictures of others, whose heads, soles and pupils were read by eye: NanoDet 1.05 (within
# 1.25 in 84 % of resampled sets), a CenterNet 1.8, a YOLOv8 trained for falls 2.1, CenterFace 0.3 to 0.5. No YOLOX and
# no YuNet could be measured: they count as the CenterNet and as CenterFace.
PERSON_SIGMA_PX, NANODET_SIGMA_PX, EYES_SIGMA_PX = 1.8, 1.2, 0.5

# CenterFace marks eyes further apart than the pupils are, by this factor, in few pixels and in many: the mean over 16
# faces whose pupils were read by eye.
CENTERFACE_EYES_APART = 1.05

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
        sigma_px: Standard deviation of the lengths that it gives, in pixels of its input, beside what no pixels mend.
    """

    count_classes: Callable[[Sequence[Shape], tuple[int | None, int | None]], int]
    decode: Callable[[Outputs, WantedClass], Boxes]
    is_rgb: bool = False
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    spread: tuple[float, float, float] = (1.0, 1.0, 1.0)
    fill: int = 114
    free_px: int = 640
    has_eyes: bool = False
    sigma_px: float = PERSON_SIGMA_PX


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
        sigma_px=NANODET_SIGMA_PX,
    ),
    "yunet": NetworkFamily(
        count_classes=_yunet, decode=decode_yunet, fill=0, free_px=320, has_eyes=True, sigma_px=EYES_SIGMA_PX
    ),
    "centerface": NetworkFamily(
        count_classes=_centerface,
        decode=decode_centerface,
        is_rgb=True,
        fill=0,
        free_px=256,
        has_eyes=True,
        sigma_px=EYES_SIGMA_PX,
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
