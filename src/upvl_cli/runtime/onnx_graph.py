"""Graphs of ONNX: opened and run by onnxruntime, its many failures as errors of one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from upvl_cli.errors import BadInput, BadSetting, one_line

FLOAT, INTEGER = "tensor(float)", "tensor(int64)"


def open_graph(path: Path, expected: str, workers: int) -> Any:
    """Load a graph of one input and one output, ready to run.

    Args:
        path: File of the graph.
        expected: Type of its only input.
        workers: Threads that one run of it takes.

    Raises:
        BadSetting: onnxruntime is not installed.
        BadInput: The file is no such graph.
    """
    session = load_graph(path, workers)
    types = [argument.type for argument in session.get_inputs()]
    if types != [expected] or len(session.get_outputs()) != 1:
        raise BadInput(
            f"{path}: has inputs {types} and {len(session.get_outputs())} outputs, "
            f"expected one input {expected} and one output"
        )
    return session


def load_graph(path: Path, workers: int) -> Any:
    """Load a graph, whatever its inputs and outputs are.

    Args:
        path: File of the graph.
        workers: Threads that one run of it takes.

    Raises:
        BadSetting: onnxruntime is not installed.
        BadInput: The file is no graph.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise BadSetting(f"{path}: running it needs onnxruntime; pip install 'upvl[onnx]'") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = workers
    wanted = ("CUDAExecutionProvider", "CPUExecutionProvider")
    providers = [name for name in wanted if name in onnxruntime.get_available_providers()]
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=providers)
    except Exception as error:  # onnxruntime's many errors have no class in common
        raise BadInput(f"{path}: onnxruntime cannot read it ({one_line(error)})") from error


def run_graph(session: Any, path: Path, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Run a graph of one input on an array and return its output.

    Args:
        session: The loaded graph.
        path: File of the graph, for messages.
        values: The input.

    Raises:
        BadInput: The graph refuses the input.
    """
    try:
        (output,) = session.run(None, {session.get_inputs()[0].name: values})
    except Exception as error:
        raise BadInput(f"{path}: cannot take an input of shape {values.shape} ({one_line(error)})") from error
    return np.asarray(output)
