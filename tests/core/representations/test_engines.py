"""OpenVINO computes what torch computes, and is refused where it does not."""

import importlib.util

import numpy as np
import pytest
import torch
from torch import nn

from rapl_core.errors import UnknownNameError
from rapl_core.representations import engines
from rapl_core.representations.engines import EngineError, OpenVinoEngine
from rapl_core.representations.extractor import FeatureRecipe, make_extractor
from rapl_core.representations.pooling import Pooling

needs_openvino = pytest.mark.skipif(
    importlib.util.find_spec("openvino") is None, reason="openvino is not installed"
)


@needs_openvino
def test_features_agree_with_torch_for_any_batch_size():
    recipe = FeatureRecipe(("stride16", "final"), (Pooling("grid", grid=2),), size=(64, 64))
    extractor = make_extractor("efficientnet_lite0", recipe)
    frames = np.random.default_rng(0).integers(0, 256, (5, 64, 64, 3), dtype=np.uint8)
    expected = extractor.extract(frames)
    extractor.use_engine("openvino")
    for batch_size in (1, 2, 5):
        found = extractor.extract(frames, batch_size=batch_size)
        assert float(torch.cosine_similarity(found, expected).min()) > 0.999
    assert not torch.equal(found, expected)  # it really is another engine
    extractor.use_engine("torch")
    assert torch.equal(extractor.extract(frames), expected)


@needs_openvino
def test_its_converter_has_nothing_to_report_with():
    recipe = FeatureRecipe(("stride2",), (Pooling("gap"),), size=(32, 32))
    make_extractor("efficientnet_lite0", recipe).use_engine("openvino")
    from openvino.tools.ovc import telemetry_utils

    assert "stub" in telemetry_utils.tm.__name__ or telemetry_utils.tm.__name__.endswith("stub")


@needs_openvino
def test_an_engine_that_disagrees_is_refused(monkeypatch):
    class Moody(nn.Module):
        """Gives OpenVINO, which traces it, something else than torch."""

        def forward(self, x):
            flat = x.flatten(1)[:, :64]
            return flat if torch.jit.is_tracing() else -flat

    with pytest.raises(EngineError, match="cosine -1.0.*expected at least 0.999"):
        OpenVinoEngine(Moody(), torch.randn(3, 3, 16, 16))


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(EngineError, match="pip install openvino.*engine torch"):
        OpenVinoEngine(nn.Identity(), torch.zeros(1, 3, 8, 8))


def test_an_unknown_engine_names_the_known():
    extractor = make_extractor("efficientnet_lite0", FeatureRecipe())
    with pytest.raises(UnknownNameError, match="tensorrt.*known: openvino, torch"):
        extractor.use_engine("tensorrt")  # type: ignore[arg-type]
    assert extractor.engine == "torch"
