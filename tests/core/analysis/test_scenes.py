"""Scenes placed by hand: what r* says of them, and what stand-ins for rewards do."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rapl_core.analysis import scenes
from rapl_core.analysis.scenes import ARM, LANES, PATH, TOGETHER, Landscape, Scenes, ways
from rapl_core.types import EmbeddedEpisode, RewardTrace


class ByState:
    """Rewards a scene by one number that stands for its picture."""

    def embed(self, frames: NDArray[Any]) -> NDArray[np.float32]:
        return frames.reshape(len(frames), -1)[:, :1].astype(np.float32)

    def reward(self, z: NDArray[Any], experts: Sequence[EmbeddedEpisode]) -> RewardTrace:
        return RewardTrace(z[:, 0].astype(np.float64), "", 0.0, True, 0, 0.0, 1.0)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scenes]:
    patched = pytest.MonkeyPatch()
    patched.setattr(scenes, "RANDOM_SCENES", 12)
    folder = tmp_path_factory.mktemp("scenes")
    found = Scenes.drawn(folder)
    again = Scenes.drawn(folder)  # from the file
    np.testing.assert_array_equal(found.frames, again.frames)
    yield found
    patched.undo()


def test_there_is_a_picture_and_r_star_of_each_scene(drawn: Scenes) -> None:
    placed = len(LANES) * sum(map(len, ways(0.0).values()))
    assert drawn.frames.shape[0] == len(drawn.human) == placed + 12
    assert drawn.frames.dtype == np.uint8 and drawn.frames.std(axis=0).max() > 0


def test_r_star_expresses_every_wish(drawn: Scenes) -> None:
    truth = drawn.truth()
    found = truth.wishes()
    # pushed on in a column the first cube leaves the best place: r* falls a little at the end
    assert truth.spearman == 1.0 and found.rise > 0.95 and found.pit < 0.05
    assert found.over_alone > 0.2 and found.gap > 0.2
    assert found.arm == pytest.approx(0.0, abs=1e-6)
    scaled = truth.scaled()
    assert scaled[ARM][0] == pytest.approx(0.0) and scaled[TOGETHER[0]][-1] == pytest.approx(1.0)


def test_a_reward_that_is_r_star_has_its_landscape(drawn: Scenes) -> None:
    known = drawn.human.astype(np.float32)[:, None]
    found = drawn.judge(ByState(), (), known)  # type: ignore[arg-type]
    assert found.spearman == pytest.approx(1.0)
    for name, way in drawn.truth().ways.items():
        assert len(way) == len(PATH)
        np.testing.assert_allclose(found.ways[name], way, atol=1e-6)


def test_a_reward_that_is_the_same_everywhere_has_no_landscape() -> None:
    flat = Landscape(float("nan"), {name: np.zeros(9) for name in ways(0.0)})
    assert np.isnan(flat.wishes().over_alone)
