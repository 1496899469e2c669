"""Videos as sprite sheets: all frames of an episode in one picture.

A browser decodes a sheet in one piece, after which any frame can be drawn at once: playing starts
with the first paint, several videos keep exactly in step because one clock picks the frames, and
scrubbing, speed and looping cost nothing. A stream (H.264, VP9) offers none of the three, and each
browser brings its own choice of codecs.
"""

import io
import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rapl_core.episodes import EpisodeStore, EpisodeSummary

LONGEST_SIDE = 4096
"""Pixels; telephones refuse larger pictures."""
LOSSLESS_PIXELS = 1_500_000
"""Up to so many a sheet keeps every pixel: small objects in small pictures matter."""
QUALITY = 88
EFFORT = 2
"""Of the WebP encoder: 50 ms a sheet of 61 frames; more effort saves a tenth of the bytes."""


@dataclass(frozen=True)
class SheetLayout:
    """Where the frames of one video stand in its sheet; follows from the summary alone."""

    frames: int
    """In the sheet; a long video shows every ``stride``-th one."""
    stride: int
    columns: int
    width: int
    """Of a frame, pixels."""
    height: int
    period_s: float
    """Between two frames of the sheet, in the video's own time."""

    @property
    def rows(self) -> int:
        """Rows of frames."""
        return math.ceil(self.frames / self.columns)


def layout_of(summary: EpisodeSummary) -> SheetLayout:
    """Return how the sheet of an episode is laid out; frames shrink only if they must."""
    total = summary.steps + 1
    span_s = (summary.last_stamp_ns - summary.first_stamp_ns) / 1e9
    width, height = summary.image_width, summary.image_height
    stride = max(1, math.ceil(total / _capacity(min(width, 96), min(height, 96))))
    frames = math.ceil(total / stride)
    scale = 1.0
    while _capacity(_scaled(width, scale), _scaled(height, scale)) < frames:
        scale *= 0.9
    width, height = _scaled(width, scale), _scaled(height, scale)
    columns = min(LONGEST_SIDE // width, math.ceil(math.sqrt(frames * height / width)))
    while math.ceil(frames / columns) * height > LONGEST_SIDE:
        columns += 1
    period_s = span_s / (total - 1) * stride if total > 1 else 1.0
    return SheetLayout(frames, stride, columns, width, height, period_s)


def make_sheet(frames: NDArray[np.uint8], layout: SheetLayout) -> bytes:
    """Return the WebP picture of ``frames`` (N, H, W, 3), the first at the top left."""
    chosen = frames[:: layout.stride][: layout.frames]  # (F, H, W, 3)
    height, width = layout.height, layout.width
    sheet = np.zeros((layout.rows * height, layout.columns * width, 3), np.uint8)
    for number, frame in enumerate(chosen):
        row, column = divmod(number, layout.columns)
        if frame.shape[:2] != (height, width):
            smaller = Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS)
            frame = np.asarray(smaller)
        sheet[row * height : (row + 1) * height, column * width : (column + 1) * width] = frame
    picture, buffer = Image.fromarray(sheet), io.BytesIO()
    if sheet.shape[0] * sheet.shape[1] <= LOSSLESS_PIXELS:
        picture.save(buffer, "WEBP", lossless=True, quality=20, method=0)
    else:
        picture.save(buffer, "WEBP", quality=QUALITY, method=EFFORT)
    return buffer.getvalue()


class SheetCache:
    """Sheets of the videos asked for lately; safe for several threads.

    :param store: where the videos are.
    :param capacity: sheets kept, some 0.15 MB each for 61 frames of 112 x 112 pixels.
    """

    def __init__(self, store: EpisodeStore, capacity: int = 128) -> None:
        self._store = store
        self._capacity = capacity
        self._sheets: OrderedDict[str, bytes] = OrderedDict()
        self._lock = threading.Lock()
        self._making: dict[str, threading.Lock] = {}

    def layout(self, episode_id: str) -> SheetLayout:
        """Return the layout of a video's sheet; errors as :meth:`EpisodeStore.load`."""
        return layout_of(self._store.summary(episode_id))

    def sheet(self, episode_id: str) -> bytes:
        """Return a video's sheet, made now unless it is here; errors as :meth:`EpisodeStore.load`.

        Two that ask for the same at once wait for one making.
        """
        return self._kept(episode_id) or self._once(episode_id, lambda: self._make(episode_id))

    def _make(self, episode_id: str) -> bytes:
        return make_sheet(self._store.frames(episode_id), self.layout(episode_id))

    def _kept(self, episode_id: str) -> bytes | None:
        with self._lock:
            if episode_id in self._sheets:
                self._sheets.move_to_end(episode_id)
            return self._sheets.get(episode_id)

    def _once(self, episode_id: str, make: Callable[[], bytes]) -> bytes:
        with self._lock:
            turn = self._making.setdefault(episode_id, threading.Lock())
        with turn:
            kept = self._kept(episode_id)
            if kept is None:
                kept = make()
                with self._lock:
                    self._sheets[episode_id] = kept
                    while len(self._sheets) > self._capacity:
                        self._sheets.popitem(last=False)
        with self._lock:
            self._making.pop(episode_id, None)
        return kept


def _capacity(width: int, height: int) -> int:
    """Frames of that size in the largest sheet."""
    return (LONGEST_SIDE // width) * (LONGEST_SIDE // height)


def _scaled(length: int, scale: float) -> int:
    return max(1, min(LONGEST_SIDE, round(length * scale)))
