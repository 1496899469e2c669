"""Standardisation and components against numpy."""

import numpy as np
import pytest
import torch

from rapl_core.errors import ShapeError
from rapl_core.representations.projection import Projection


def frames(count: int, width: int) -> torch.Tensor:
    rng = np.random.default_rng(0)
    mixed = rng.normal(size=(count, width)) @ rng.normal(size=(width, width)) + 3.0
    return torch.from_numpy(mixed.astype(np.float32))


def fitted(x: torch.Tensor, components: int | None) -> Projection:
    projection = Projection(x.shape[1], components)
    projection.fit(x, np.random.default_rng(0))
    return projection


def test_without_components_features_are_standardised():
    x = frames(200, 6)
    y = fitted(x, None)(x)
    np.testing.assert_allclose(y.mean(0), 0.0, atol=1e-5)
    np.testing.assert_allclose(y.std(0), 1.0, atol=1e-2)


@pytest.mark.parametrize(("count", "width"), [(300, 12), (10, 40)])
def test_components_are_the_principal_ones_with_their_spectrum_kept(count, width):
    x = frames(count, width)
    projection = fitted(x, 5)
    y = projection(x)
    standardised = ((x - x.mean(0)) / (x.std(0) + 1e-3)).double().numpy()
    singular = np.linalg.svd(standardised, compute_uv=False)
    np.testing.assert_allclose(np.linalg.norm(y, axis=0), singular[:5] / singular[0] * count**0.5,
                               rtol=1e-3)  # fmt: skip
    correlation = (y.T @ y).numpy()
    np.testing.assert_allclose(correlation - np.diag(np.diag(correlation)), 0, atol=1e-2)
    assert projection.explained == pytest.approx(
        (singular[:5] ** 2).sum() / (singular**2).sum(), rel=1e-3
    )


def test_a_constant_feature_stays_finite():
    x = frames(50, 4)
    x[:, 2] = 7.0
    assert torch.isfinite(fitted(x, 3)(x)).all()


def test_videos_are_projected_frame_by_frame():
    x = frames(60, 6)
    projection = fitted(x, 3)
    torch.testing.assert_close(projection(x.reshape(5, 12, 6)).reshape(60, 3), projection(x))


def test_wrong_widths_are_refused():
    with pytest.raises(ShapeError, match="9 principal components of 6"):
        Projection(6, 9)
    with pytest.raises(ShapeError, match=r"\(50, 4\), expected \(2 or more, 6\)"):
        Projection(6, None).fit(frames(50, 4), np.random.default_rng(0))
