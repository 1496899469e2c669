"""The gallery shows of a task what it says: one episode that succeeds and one that does not."""

import numpy as np
import pytest
from PIL import Image

from rapl_core.analysis.gallery import PICTURES, draw_picture, film_pair, write_picture, write_video
from rapl_core.tasks import get_task


@pytest.fixture(scope="module")
def pair():
    return film_pair(get_task("xmagical_avoid"))


def test_both_start_alike_and_only_the_preferred_one_succeeds(pair):
    assert pair.preferred.success and not pair.disliked.success
    assert np.array_equal(pair.preferred.frames[0], pair.disliked.frames[0])
    assert len(pair.preferred.frames) == pair.task.horizon + 1


def test_the_picture_holds_the_frames_that_the_robot_sees(pair):
    page = np.asarray(draw_picture(pair).convert("RGB")).astype(int)
    last = pair.preferred.frames[-1].astype(int)
    size = pair.task.image_size
    shown = page[20 : 20 + size, -size:]
    assert page.shape[1] > PICTURES * size
    assert np.abs(shown - last).mean() < 6, "another frame, or too few colours"


def test_picture_and_video_are_files_that_open_and_are_small(pair, tmp_path):
    write_picture(pair, tmp_path / "p" / "a.png")
    write_video(pair, tmp_path / "v" / "a.webp")
    assert (tmp_path / "p" / "a.png").stat().st_size < 40_000
    with Image.open(tmp_path / "v" / "a.webp") as video:
        assert video.n_frames > 10 and video.size == (448, 224)
