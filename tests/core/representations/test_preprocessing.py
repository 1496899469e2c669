"""Preprocessing: known values, any camera, and refusals."""

import numpy as np
import pytest
import torch

from rapl_core.errors import ShapeError
from rapl_core.representations.preprocessing import Preprocessing, preprocess


def pictures(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, size=shape, dtype=np.uint8)


def test_a_picture_of_the_right_size_is_only_normalised():
    frames = pictures(2, 6, 4, 3)
    x = preprocess(frames, Preprocessing(height=6, width=4, mean=(0.5,) * 3, std=(0.5,) * 3))
    expected = frames.astype(np.float64).transpose(0, 3, 1, 2) / 127.5 - 1
    np.testing.assert_allclose(x, expected, atol=1e-6)
    assert x.dtype == torch.float32


def test_each_channel_has_its_own_mean_and_deviation():
    frames = np.full((1, 2, 2, 3), 255, np.uint8)
    config = Preprocessing(height=2, width=2, mean=(0.0, 0.5, 1.0), std=(1.0, 0.5, 0.25))
    np.testing.assert_allclose(preprocess(frames, config)[0, :, 0, 0], [1.0, 1.0, 0.0], atol=1e-6)


def test_a_camera_of_another_size_is_squeezed_to_the_input():
    frames = np.zeros((1, 480, 640, 3), np.uint8)
    frames[:, :, 320:] = 255  # right half
    x = preprocess(frames, Preprocessing(height=112, width=112))
    assert x.shape == (1, 3, 112, 112)
    assert float(x[..., :50].max()) == 0.0 and float(x[..., 62:].min()) == pytest.approx(1.0)


def test_the_centre_is_cut_when_the_aspect_is_kept():
    frames = np.zeros((1, 100, 300, 3), np.uint8)
    frames[:, :, 100:200] = 255  # the middle square
    x = preprocess(frames, Preprocessing(height=40, width=40, shorter_side=50))
    assert x.shape == (1, 3, 40, 40)
    assert float(x.min()) == pytest.approx(1.0)


def test_a_frame_in_a_batch_comes_out_as_it_does_alone():
    frames = pictures(5, 50, 70, 3)
    config = Preprocessing()
    batch = preprocess(frames, config)
    for i in range(5):
        assert torch.equal(batch[i], preprocess(frames[i : i + 1], config)[0])


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (pictures(5, 5, 3), r"\(5, 5, 3\), expected \(N, H, W, 3\)"),
        (pictures(1, 5, 5, 4), r"\(1, 5, 5, 4\)"),
        (pictures(0, 5, 5, 3), "not empty"),
        (pictures(1, 5, 5, 3).astype(np.float32), "float32, expected uint8"),
    ],
)
def test_what_is_no_picture_is_refused(frames, message):
    with pytest.raises(ShapeError, match=message):
        preprocess(frames, Preprocessing())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"height": 0}, "0 x 112"),
        ({"shorter_side": 100}, "shorter_side is 100"),
        ({"std": (1.0, 0.0, 1.0)}, "std positive"),
    ],
)
def test_impossible_settings_are_refused(settings, message):
    with pytest.raises(ShapeError, match=message):
        Preprocessing(**settings)
