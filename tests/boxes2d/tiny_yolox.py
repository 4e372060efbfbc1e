"""A graph with the head of YOLOX whose objectness is the blue of each cell: a blue square is an object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper, save

SIDE = 64
NAMES = ("square", "other")


def write_graph(
    path: Path,
    *,
    names: int = len(NAMES),
    size: tuple[Any, ...] = (1, 3, SIDE, SIDE),
    kind: int = TensorProto.FLOAT,
    outputs: int = 1,
    values: float = 0.0,
    cells: int = 84,
) -> Path:
    """Write the graph.

    Args:
        path: Where.
        names: Number of kinds; the first has all the score.
        size: Shape of the input.
        kind: Type of the input.
        outputs: How often the output is given.
        values: Added to all numbers.
        cells: Number of cells that it gives.
    """
    box = np.zeros((1, cells, 4), np.float32)
    box[..., :2] = 0.5  # the middle of the cell, one stride wide
    kinds = np.zeros((1, cells, names), np.float32)
    kinds[..., 0] = 1
    # Only grid by grid: the blue of 8 x 8 pixels; the coarser grids see nothing.
    constants = {
        "box": box + np.float32(values),
        "kinds": kinds,
        "scale": np.float32(1 / 255),
        "coarse": np.zeros((1, max(cells - 64, 0), 1), np.float32),
        "rows": np.array([1, min(cells, 64), 1]),
        "begin": np.array([0]),
        "end": np.array([1]),
        "axis": np.array([1]),
    }
    nodes = [
        helper.make_node("Slice", ["images", "begin", "end", "axis"], ["blue"]),
        helper.make_node("AveragePool", ["blue"], ["cells"], kernel_shape=[8, 8], strides=[8, 8]),
        helper.make_node("Reshape", ["cells", "rows"], ["fine"]),
        helper.make_node("Concat", ["fine", "coarse"], ["each"], axis=1),
        helper.make_node("Mul", ["each", "scale"], ["objectness"]),
        *(
            helper.make_node("Concat", ["box", "objectness", "kinds"], [f"output{number}"], axis=2)
            for number in range(outputs)
        ),
    ]
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info("images", kind, size)],
        [helper.make_tensor_value_info(f"output{number}", kind, None) for number in range(outputs)],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path
