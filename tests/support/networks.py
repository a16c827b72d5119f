"""Small networks in the layout of each family: they find what is bright, in the left and in the right half.

Their weights are written down rather than trained: the box of the bright pixels of each half by maxima along rows and
columns, given out by every cell inside of it as the family does. So the whole path is that of a real network.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

SIDE = 256
"""Width and height of the input."""

BRIGHT = 150.0
"""What is brighter than this in all channels is a thing."""

SCORE = 0.9
CLASSES = ("person", "dog", "ball")
MEANS, SPREADS = (103.53, 116.28, 123.675), (57.375, 57.12, 58.395)
"""What NanoDet takes off each channel, and divides it by."""

EYES = ((0.3, 0.4), (0.7, 0.4))
"""Where the eyes of a face are, in shares of its box."""


class Graph:
    """A graph that is written down node by node. Names are those of results."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.weights: list[Any] = []

    def const(self, values: Any) -> str:
        """Return weights."""
        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(values, np.float32), name))
        return name

    def numbers(self, values: Sequence[int]) -> str:
        """Return weights that are whole numbers, such as a shape."""
        name = f"w{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(values, np.int64), name))
        return name

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Return the result of a node."""
        name = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def step(self, values: str) -> str:
        """Return 1 where values are above 0, by 0.01 or more, and 0 elsewhere."""
        scaled = self.op("Mul", values, self.const(100.0))
        return self.op("Min", self.op("Relu", scaled), self.const(1.0))

    def to_file(self, path: Path, outputs: dict[str, str], shapes: dict[str, tuple[int, ...]], **said: Any) -> Path:
        """Write it, with the results that it gives out, by name."""
        for name, result in outputs.items():
            self.nodes.append(helper.make_node("Identity", [result], [name]))
        sides = said.get("sides", (SIDE, SIDE))
        graph = helper.make_graph(
            self.nodes,
            "bright",
            [helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, *sides))],
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, shapes[name]) for name in outputs],
            self.weights,
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8, producer_name="ours"
        )
        for key, value in said.get("notes", {}).items():
            entry = model.metadata_props.add()
            entry.key, entry.value = key, value
        onnx.checker.check_model(model)
        path.write_bytes(model.SerializeToString())
        return path


class _Cells:
    """What each cell of the grids says of the bright things: ``(1, n, 1)`` each."""

    def __init__(self, graph: Graph, levels: str, strides: Sequence[int], middle: float) -> None:
        self.graph = graph
        grids = [np.mgrid[: SIDE // stride, : SIDE // stride].reshape(2, -1) for stride in strides]
        rows, columns = np.concatenate(grids, axis=1)
        stride = np.concatenate([np.full(grid.shape[1], s) for grid, s in zip(grids, strides, strict=True)])
        self.count = len(rows)
        self.column, self.row, self.stride = (graph.const(each[None, :, None]) for each in (columns, rows, stride))
        self.x, self.y = (graph.const(((each + middle) * stride)[None, :, None]) for each in (columns, rows))
        bright = graph.step(graph.op("Sub", levels, graph.const(BRIGHT)))
        half = np.arange(SIDE) < SIDE // 2
        boxes = [self._box(graph.op("Mul", bright, graph.const(each[None, None, None]))) for each in (half, ~half)]
        inside = [self._inside(box) for box in boxes]
        self.left, self.top, self.right, self.bottom = (
            graph.op("Add", *(graph.op("Mul", where, box[edge]) for where, box in zip(inside, boxes, strict=True)))
            for edge in range(4)
        )
        self.score = graph.op("Mul", graph.op("Max", *inside), graph.const(SCORE))

    def _box(self, bright: str) -> tuple[str, ...]:
        """Return left, top, right and bottom of what is bright, ``(1, 1, 1)`` each."""
        op, const = self.graph.op, self.graph.const
        edges = []
        for away, shape in ((2, (1, 1, 1, SIDE)), (3, (1, 1, SIDE, 1))):
            seen = op("ReduceMax", bright, axes=[away], keepdims=1)
            index = np.arange(SIDE).reshape(shape)
            first = op("ReduceMax", op("Mul", seen, const(SIDE - index)), axes=[2, 3], keepdims=1)
            last = op("ReduceMax", op("Mul", seen, const(index + 1)), axes=[2, 3], keepdims=1)
            edges += [op("Sub", const(float(SIDE)), first), last]
        left, right, top, bottom = (op("Reshape", each, self.graph.numbers((1, 1, 1))) for each in edges)
        return left, top, right, bottom

    def _inside(self, box: tuple[str, ...]) -> str:
        """Return 1 for cells in a box."""
        op = self.graph.op
        left, top, right, bottom = box
        depth = op(
            "Min", op("Sub", self.x, left), op("Sub", right, self.x), op("Sub", self.y, top), op("Sub", bottom, self.y)
        )
        return self.graph.step(depth)

    def middle(self, low: str, high: str) -> str:
        """Return half way."""
        return self.graph.op("Mul", self.graph.op("Add", low, high), self.graph.const(0.5))

    def offset(self, low: str, high: str, cell: str, share: float = 0.0) -> str:
        """Return where the middle is, or a share of the size beyond it, in cells from a cell."""
        op = self.graph.op
        place = op("Add", self.middle(low, high), op("Mul", op("Sub", high, low), self.graph.const(share)))
        return op("Sub", op("Div", place, self.stride), cell)

    def log_size(self, low: str, high: str) -> str:
        """Return the logarithm of a size in cells."""
        op = self.graph.op
        return op("Log", op("Max", op("Div", op("Sub", high, low), self.stride), self.graph.const(1e-6)))

    def classes(self, names: Sequence[str]) -> list[str]:
        """Return the score of each class: all of it for a person, nothing for others."""
        nothing = self.graph.op("Mul", self.score, self.graph.const(0.0))
        return [self.score if name == "person" else nothing for name in names]


def _levels(graph: Graph, family: str) -> str:
    """Return the darkest channel, 0 to 255, ``(1, 1, SIDE, SIDE)``."""
    levels = "images"
    if family == "yolov8":
        levels = graph.op("Mul", levels, graph.const(255.0))
    if family == "nanodet":
        scaled = graph.op("Mul", levels, graph.const(np.array(SPREADS).reshape(1, 3, 1, 1)))
        levels = graph.op("Add", scaled, graph.const(np.array(MEANS).reshape(1, 3, 1, 1)))
    return graph.op("ReduceMin", levels, axes=[1], keepdims=1)


def write_network(path: Path, family: str, classes: Sequence[str] = CLASSES, *, is_named: bool = True) -> Path:
    """Write a network of a family that finds what is bright."""
    graph = Graph()
    levels = _levels(graph, family)
    notes = {"names": repr(dict(enumerate(classes)))} if is_named else {}
    if family in {"yunet", "centerface"}:
        outputs, shapes = (_yunet if family == "yunet" else _centerface)(graph, levels)
        return graph.to_file(path, outputs, shapes)
    strides = (8, 16, 32, 64) if family == "nanodet" else (8, 16, 32)
    cells = _Cells(graph, levels, strides, 0.0 if family == "nanodet" else 0.5)
    figures = {"yolox": _yolox, "yolov8": _yolov8, "nanodet": _nanodet}[family](cells, classes)
    rows = graph.op("Concat", *figures, axis=2)
    shape: tuple[int, ...] = (1, cells.count, 32 + len(classes) if family == "nanodet" else len(figures))
    if family == "yolov8":
        rows, shape = graph.op("Transpose", rows, perm=[0, 2, 1]), (1, shape[2], shape[1])
    return graph.to_file(path, {"output": rows}, {"output": shape}, notes=notes)


def _yolox(cells: _Cells, classes: Sequence[str]) -> list[str]:
    sure = cells.graph.op("Add", cells.graph.op("Mul", cells.score, cells.graph.const(0.0)), cells.graph.const(1.0))
    return [
        cells.offset(cells.left, cells.right, cells.column),
        cells.offset(cells.top, cells.bottom, cells.row),
        cells.log_size(cells.left, cells.right),
        cells.log_size(cells.top, cells.bottom),
        cells.score,
        *(sure if name == "person" else cells.graph.op("Mul", sure, cells.graph.const(0.0)) for name in classes),
    ]


def _yolov8(cells: _Cells, classes: Sequence[str]) -> list[str]:
    sides = ((cells.left, cells.right), (cells.top, cells.bottom))
    sizes = [cells.graph.op("Sub", high, low) for low, high in sides]
    return [*(cells.middle(*side) for side in sides), *sizes, *cells.classes(classes)]


def _nanodet(cells: _Cells, classes: Sequence[str]) -> list[str]:
    """Distances as two neighbouring bins, whose mean they are: softmax of the logarithms of their weights."""
    graph = cells.graph
    op, const = graph.op, graph.const
    away = (
        op("Sub", cells.x, cells.left), op("Sub", cells.y, cells.top),
        op("Sub", cells.right, cells.x), op("Sub", cells.bottom, cells.y),
    )  # fmt: skip
    distances = [op("Div", each, cells.stride) for each in away]
    # What is further than 7 strides cannot be said, so cells of a coarser grid say it.
    reached = graph.step(op("Sub", const(7.0), op("Max", *distances)))
    bins = const(np.arange(8.0).reshape(1, 1, 8))
    weights = [op("Relu", op("Sub", const(1.0), op("Abs", op("Sub", each, bins)))) for each in distances]
    scores = [op("Mul", each, reached) for each in cells.classes(classes)]
    return [*scores, *(op("Log", op("Max", each, const(1e-9))) for each in weights)]


def _yunet(graph: Graph, levels: str) -> tuple[dict[str, str], dict[str, tuple[int, ...]]]:
    outputs, shapes = {}, {}
    for stride in (8, 16, 32):
        cells = _Cells(graph, levels, (stride,), 0.5)
        sides = ((cells.left, cells.right), (cells.top, cells.bottom))
        marks = [
            cells.offset(*side, cell, share - 0.5)
            for place in (*EYES, (0.5, 0.6), (0.35, 0.8), (0.65, 0.8))
            for side, cell, share in zip(sides, (cells.column, cells.row), place, strict=True)
        ]
        box = [
            *(cells.offset(*side, cell) for side, cell in zip(sides, (cells.column, cells.row), strict=True)),
            *(cells.log_size(*side) for side in sides),
        ]
        kinds = {"cls": [cells.score], "obj": [cells.score], "bbox": box, "kps": marks}
        for kind, figures in kinds.items():
            name = f"{kind}_{stride}"
            outputs[name] = graph.op("Concat", *figures, axis=2) if len(figures) > 1 else figures[0]
            shapes[name] = (1, cells.count, len(figures))
    order = [f"{kind}_{stride}" for kind in ("cls", "obj", "bbox", "kps") for stride in (8, 16, 32)]
    return {name: outputs[name] for name in order}, shapes


def _centerface(graph: Graph, levels: str) -> tuple[dict[str, str], dict[str, tuple[int, ...]]]:
    cells = _Cells(graph, levels, (4,), 0.5)
    nothing = graph.op("Mul", cells.score, graph.const(0.0))
    shares = [share for x, y in (*EYES, (0.5, 0.6), (0.35, 0.8), (0.65, 0.8)) for share in (y, x)]
    sides = ((cells.top, cells.bottom, cells.row), (cells.left, cells.right, cells.column))
    half = graph.const(0.5)
    maps = {
        "537": [cells.score],
        "538": [cells.log_size(low, high) for low, high, _ in sides],
        "539": [graph.op("Sub", cells.offset(*side), half) for side in sides],
        "540": [graph.op("Add", nothing, graph.const(share)) for share in shares],
    }
    outputs, shapes = {}, {}
    for name, figures in maps.items():
        shape = (1, len(figures), SIDE // 4, SIDE // 4)
        rows = graph.op("Concat", *figures, axis=2) if len(figures) > 1 else figures[0]
        outputs[name] = graph.op("Reshape", graph.op("Transpose", rows, perm=[0, 2, 1]), graph.numbers(shape))
        shapes[name] = shape
    return outputs, shapes


def bright_figure(height_px: int, width_px: int, seed: int = 0) -> NDArray[np.uint8]:
    """Return something bright with a pattern, so that it can be followed."""
    coarse = np.random.default_rng(seed).integers(165, 256, (13, 7, 3), np.uint8)
    rows, columns = (np.arange(size) * cells // size for size, cells in ((height_px, 13), (width_px, 7)))
    return coarse[rows][:, columns]


def put_figure(image: NDArray[np.uint8], figure: NDArray[np.uint8], left: int, top: int) -> None:
    """Paint a figure into a picture, as far as it is inside."""
    height, width = image.shape[:2]
    x, y = max(left, 0), max(top, 0)
    right, bottom = min(left + figure.shape[1], width), min(top + figure.shape[0], height)
    if right > x and bottom > y:
        image[y:bottom, x:right] = figure[y - top : bottom - top, x - left : right - left]
