"""Features of a frozen backbone, computed once per video and kept on disk."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from rapl_core.atomic import write_atomically
from rapl_core.errors import ShapeError, UnknownNameError, WeightsError
from rapl_core.representations.engines import Engine
from rapl_core.representations.extractor import FeatureExtractor, Precision
from rapl_core.types import Episode, check_episode_id

_STORED = {"float16": np.float16, "float32": np.float32}

_PARTS_STREAM = 0x9A27
_PARTS_VIDEOS, _PARTS_FRAMES = 150, 12
"""Parts are found in at most so many videos, and so many frames of each."""

MIRRORED = "mirrored-"
"""How the name of a video's left-right mirrored twin begins."""


class FeatureStore(Mapping[str, NDArray[np.float32]]):
    """(T, F) features by episode id.

    A video's features lie in ``folder/<extractor version>-<precision>-<dtype>/<hash of its
    frames>.safetensors``, so that they are found again whatever the episode is called; those of
    another engine than torch in ``<extractor version>-<engine>-<its precision>-<dtype>``. Training
    reads them in float16, which is off by 5e-4; what the robot is rewarded with is embedded from
    the frames, or from features in float32 and of precision float32, which are the same.
    """

    def __init__(
        self,
        extractor: FeatureExtractor,
        folder: Path | None = None,
        precision: Precision = "float32",
        dtype: Literal["float16", "float32"] = "float16",
        mirror: bool = False,
    ) -> None:
        """
        :param mirror: whether each video brings its left-right mirrored twin.
        """
        if dtype not in _STORED:
            raise UnknownNameError("feature dtype", dtype, _STORED)
        if extractor.needs_parts:
            raise WeightsError("features need the parts of the task's pictures: find them first")
        self.extractor = extractor
        self.precision: Precision = precision
        self.mirror = mirror
        self.computed = 0
        """Videos that went through the backbone; the others came from the cache."""
        self._dtype = dtype
        engine = extractor.engine
        made_by = precision if engine == "torch" else f"{engine}-{extractor.engine_precision}"
        self._folder = folder and Path(folder) / f"{extractor.version}-{made_by}-{dtype}"
        self._features: dict[str, NDArray[Any]] = {}

    def add(self, episode_id: str, frames: NDArray[np.uint8]) -> None:
        """Compute or find the features of a video's (T, H, W, 3) frames.

        :raises ShapeError: for frames of another shape or dtype, or features beyond the dtype.
        :raises RaplError: if they cannot be written to the folder.
        """
        check_episode_id(episode_id)
        self._features[episode_id] = self._found(episode_id, frames)
        if self.mirror:
            twin = np.ascontiguousarray(frames[:, :, ::-1])
            self._features[MIRRORED + episode_id] = self._found(episode_id, twin)

    def look_up(self, episode_id: str, frames: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Compute or find the features (T, F) of a video's frames without keeping them in memory.

        :raises ShapeError: as :meth:`add`.
        """
        return self._found(check_episode_id(episode_id), frames).astype(np.float32)

    def _found(self, episode_id: str, frames: NDArray[np.uint8]) -> NDArray[Any]:
        """From the cache or the backbone."""
        path = self._folder and self._folder / f"{_content_hash(frames)}.safetensors"
        found = _read(path) if path else None
        if found is None:
            found = self._compute(episode_id, frames)
            if path:
                _write(path, found)
        return found

    def add_episode(self, episode: Episode) -> None:
        """Add frames 1..T of an episode: those arrived in by its transitions."""
        self.add(episode.episode_id, episode.frames[1:])

    def _compute(self, episode_id: str, frames: NDArray[np.uint8]) -> NDArray[Any]:
        features = self.extractor.extract(frames, self.precision).numpy()
        with np.errstate(over="ignore"):
            stored = features.astype(_STORED[self._dtype])
        if not np.all(np.isfinite(stored)):
            raise ShapeError(
                f"features of episode {episode_id} reach {np.abs(features).max():.3g}, "
                f"more than {self._dtype} holds"
            )
        self.computed += 1
        return stored

    def __getitem__(self, episode_id: str) -> NDArray[np.float32]:
        return self._features[episode_id].astype(np.float32)

    def __iter__(self) -> Iterator[str]:
        return iter(self._features)

    def __len__(self) -> int:
        return len(self._features)


def find_parts(
    extractor: FeatureExtractor,
    videos: Sequence[str],
    frames_of: Callable[[str], NDArray[np.uint8]],
    seed: int,
) -> None:
    """Let an extractor find the parts of a pool's pictures, if it is read by parts.

    :param videos: the pool; training videos only.
    :param frames_of: a video's (T, H, W, 3) frames.
    """
    if not extractor.needs_parts:
        return
    rng = np.random.default_rng([seed, _PARTS_STREAM])
    chosen = rng.choice(len(videos), min(_PARTS_VIDEOS, len(videos)), replace=False)

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for index in np.sort(chosen):
            frames = frames_of(videos[index])
            yield frames[rng.choice(len(frames), min(_PARTS_FRAMES, len(frames)), replace=False)]

    extractor.find_parts(pictures(), rng)


def prepare_extractor(
    extractor: FeatureExtractor,
    videos: Sequence[str],
    frames_of: Callable[[str], NDArray[np.uint8]],
    seed: int,
    engine: Engine = "torch",
) -> None:
    """Make an extractor ready for a pool: :func:`find_parts`, then let ``engine`` compute.

    :raises EngineError: if the engine is not installed or disagrees with torch.
    """
    find_parts(extractor, videos, frames_of, seed)
    if engine != "torch":
        pictures = frames_of(videos[0]) if videos else None
        extractor.use_engine(engine, torch.get_num_threads(), pictures)


def _content_hash(frames: NDArray[np.uint8]) -> str:
    digest = hashlib.sha256(repr((frames.shape, str(frames.dtype))).encode())
    digest.update(np.ascontiguousarray(frames).data)
    return digest.hexdigest()[:32]


def _read(path: Path) -> NDArray[Any] | None:
    """A cached file's features; None where there is none or it is damaged (a cache may be)."""
    try:
        return load_file(path)["features"]
    except (FileNotFoundError, SafetensorError, KeyError):
        return None


def _write(path: Path, features: NDArray[Any]) -> None:
    write_atomically(path, save({"features": features}), flush=False)


def stack_frames(features: Mapping[str, NDArray[np.float32]]) -> torch.Tensor:
    """All frames of all videos, (N, F)."""
    return torch.from_numpy(np.concatenate([features[name] for name in features]))
