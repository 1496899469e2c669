"""Presets: what each is, and what none may be."""

from dataclasses import replace

import pytest

from rapl_core.errors import ShapeError, UnknownNameError
from rapl_core.representations.presets import get_preset, preset_names


def test_the_three_presets_are_known_by_name():
    assert preset_names() == ["authors_code", "paper", "tuned"]
    assert all(get_preset(name).name == name for name in preset_names())
    with pytest.raises(UnknownNameError, match="best.*authors_code, paper, tuned"):
        get_preset("best")


def test_only_the_tuned_preset_goes_beyond_the_paper():
    for name in ("paper", "authors_code"):
        preset = get_preset(name)
        assert preset.training.solver == "sinkhorn" and preset.reward.expert == "closest"
        assert preset.expert_weight == 0 and preset.longest_cut == 0 and preset.dimension == 32
    assert get_preset("paper").likelihood == "log" and get_preset("paper").tie_weight == 0
    assert get_preset("authors_code").likelihood == "linear"
    assert get_preset("authors_code").training.epsilon == 1.0


@pytest.mark.parametrize(
    ("field", "value"),
    [("epochs", 0), ("held_out", 1.0), ("temperature", 0.0), ("learning_rate", float("nan"))],
)
def test_a_number_out_of_range_is_refused_by_name(field, value):
    with pytest.raises(ShapeError, match=f"tuned: {field} is {value}"):
        replace(get_preset("tuned"), **{field: value})
    with pytest.raises(UnknownNameError, match="sgd.*adam, adamw"):
        replace(get_preset("tuned"), optimiser="sgd")
