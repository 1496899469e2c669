"""Attention maps of several encoders over the same pictures, side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from rapl_core.analysis.attention import attention_map
from rapl_core.errors import ShapeError
from rapl_core.representations.encoder import Encoder
from rapl_core.representations.preprocessing import Preprocessing
from rapl_core.types import check_shape

OPACITY = 0.55
INCHES = 1.25
"""A picture's side."""
DPI = 90
COLOURS = 192


def write_attention(
    path: Path,
    frames: NDArray[np.uint8],
    titles: Sequence[str],
    encoders: Mapping[str, Encoder],
) -> Path:
    """Draw the pictures, and under them each encoder's attention map over them; a PNG.

    Bright (viridis) adds most to the embedding's mean, dark least, on one scale for all pictures of
    an encoder. Squares are the cells of the map: it knows nothing finer.

    :param frames: (N, H, W, 3) uint8 RGB.
    :param titles: N of them, one over each column.
    :param encoders: by the name that stands beside its row.
    :raises AttentionError: if an encoder has no attention map.
    :raises ShapeError: for frames of another shape, or another number of titles.
    """
    check_shape("frames", frames, (None, None, None, 3))
    if len(titles) != len(frames):
        raise ShapeError(f"{len(titles)} titles for {len(frames)} pictures")
    rows, columns = 1 + len(encoders), len(frames)
    size = (INCHES * columns + 0.3, INCHES * rows + 0.3)
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis, frame, title in zip(axes[0], frames, titles, strict=True):
        axis.set_title(title, fontsize=7)
        _show(axis, frame)
    for row, (name, encoder) in zip(axes[1:], encoders.items(), strict=True):
        maps = attention_map(encoder, frames)
        seen = seen_part(encoder.extractor.preprocessing, *frames.shape[1:3])
        row[0].set_ylabel(name, fontsize=8)
        for axis, frame, values in zip(row, frames, maps, strict=True):
            _show(axis, frame)
            axis.imshow(
                values, cmap="viridis", vmin=float(maps.min()), vmax=float(maps.max()),
                alpha=OPACITY, extent=seen, interpolation="nearest",
            )  # fmt: skip
            axis.set(xlim=(0, frame.shape[1]), ylim=(frame.shape[0], 0))
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = Image.fromarray(_pixels(figure))
    drawn.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def seen_part(config: Preprocessing, height: int, width: int) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of what of a picture reaches the backbone, in pixels."""
    if config.shorter_side is None:
        return 0.0, float(width), float(height), 0.0
    scale = min(height, width) / config.shorter_side
    half_width, half_height = config.width * scale / 2, config.height * scale / 2
    return (
        width / 2 - half_width,
        width / 2 + half_width,
        height / 2 + half_height,
        height / 2 - half_height,
    )


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])


def _show(axis: Axes, frame: NDArray[Any]) -> None:
    height, width = frame.shape[:2]
    axis.imshow(frame, extent=(0, width, height, 0))
    axis.set(xticks=[], yticks=[])
