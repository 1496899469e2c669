"""Inference engines for the frozen part of an encoder: torch, or OpenVINO where installed."""

import importlib.util
import sys
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from rapl_core.errors import RaplError

Engine = Literal["torch", "openvino"]

LEAST_COSINE = 0.999
"""Between the two engines' features of every picture of the parity check."""


class EngineError(RaplError):
    """An inference engine is not installed, or computes something else than torch."""


class OpenVinoEngine:
    """The same function as a torch module on pictures, compiled by OpenVINO for this CPU.

    In bfloat16 where the CPU has it and the features stay those of torch, which depends on the
    network (ResNet-18's do, EfficientNet-Lite0's do not); else in float32.
    """

    def __init__(self, module: nn.Module, pictures: torch.Tensor, threads: int = 1) -> None:
        """
        :param module: (N, 3, H, W) -> (N, F).
        :param pictures: (N, 3, H, W) on which the two must agree; like those to come, for the
            error of bfloat16 depends on them.
        :raises EngineError: if OpenVINO is not installed, cannot compile the module, or does not
            agree with torch.
        """
        if importlib.util.find_spec("openvino") is None:
            raise EngineError(
                "the engine openvino needs the Python package openvino, which is not installed; "
                "`pip install openvino`, or use the engine torch"
            )
        # OpenVINO's converter reports its use to its makers if this package is there; with None in
        # its place it takes its own stub instead. Nothing here may leave the machine unasked.
        sys.modules["openvino_telemetry"] = None  # type: ignore[assignment]
        import openvino  # takes half a second

        core = openvino.Core()
        try:
            model = openvino.convert_model(
                module,
                example_input=torch.zeros(2, *pictures.shape[1:]),
                input=[-1, *pictures.shape[1:]],
            )
        except Exception as error:  # OpenVINO's own kinds of error are not exported
            raise EngineError(f"OpenVINO cannot compile this backbone: {error}") from error
        has_bf16 = "BF16" in core.get_property("CPU", "OPTIMIZATION_CAPABILITIES")
        for precision in ("bf16", "f32") if has_bf16 else ("f32",):
            self.precision = precision
            self._compiled = core.compile_model(
                model,
                "CPU",
                {
                    "INFERENCE_PRECISION_HINT": precision,
                    "INFERENCE_NUM_THREADS": threads,
                    "PERFORMANCE_HINT": "LATENCY",
                },
            )
            self.cosine = self._parity(module, pictures)
            """Least cosine to torch's float32 features in the parity check."""
            if self.cosine >= LEAST_COSINE:
                return
        raise EngineError(
            f"OpenVINO's features differ from torch's: cosine {self.cosine:.5f}, expected at least "
            f"{LEAST_COSINE}; use the engine torch"
        )

    def __call__(self, x: torch.Tensor) -> torch.Tensor:
        """(N, 3, height, width) -> (N, F) float32."""
        result = self._compiled(np.ascontiguousarray(x.numpy()))[0]
        return torch.from_numpy(np.array(result, dtype=np.float32))

    def _parity(self, module: nn.Module, x: torch.Tensor) -> float:
        with torch.inference_mode():
            expected = module(x)
        return float(torch.cosine_similarity(self(x), expected).min())


def flat_scenes(count: int = 8, size: int = 96) -> NDArray[np.uint8]:
    """Return (count, size, size, 3) pictures of boxes on a plain ground, always the same."""
    rng = np.random.default_rng(0)
    scenes = np.empty((count, size, size, 3), np.uint8)
    for scene in scenes:
        scene[:] = rng.integers(100, 240, 3)
        for _ in range(5):
            top, left = rng.integers(0, size - 10, 2)
            rows, columns = rng.integers(6, size // 2, 2)
            scene[top : top + rows, left : left + columns] = rng.integers(0, 256, 3)
    return scenes
