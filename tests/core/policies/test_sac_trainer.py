"""The trainer follows from its seed, and a resumed one goes on to the last bit."""

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from learning_cases import SMALL, A, F, filled_trainer, transitions

from rapl_core.errors import CorruptFileError, RaplError, ShapeError
from rapl_core.policies import SacTrainer

OBSERVATIONS = np.linspace(-1, 1, 3 * F, dtype=np.float32).reshape(3, F)


def go_on(trainer: SacTrainer) -> list[np.ndarray]:
    """Everything that draws a random number or learns, and what came of it."""
    results = []
    for number in range(20, 23):
        trainer.add_episode(transitions(number))
        metrics = trainer.update(7)
        trainer.refresh()
        results += [trainer.act(OBSERVATIONS), trainer.random_actions(2)]
        results.append(np.array([metrics.actor_loss, metrics.critic_loss, metrics.updates]))
    results += [value.numpy().copy() for value in trainer.model.policy.state_dict().values()]
    return results


def test_a_resumed_trainer_goes_on_to_the_last_bit(tmp_path: Path) -> None:
    trainer = filled_trainer()
    trainer.update(11)  # and no refresh: the acting policy is an older one
    trainer.save(tmp_path / "saved")
    resumed = SacTrainer(F, A, SMALL, seed=0)
    resumed.load(tmp_path / "saved")
    for one, other in zip(go_on(trainer), go_on(resumed), strict=True):
        assert np.array_equal(one, other)


def test_a_trainer_saved_before_its_first_step_resumes_too(tmp_path: Path) -> None:
    trainer = filled_trainer()
    trainer.save(tmp_path / "saved")
    resumed = SacTrainer(F, A, SMALL, seed=0)
    resumed.load(tmp_path / "saved")
    for one, other in zip(go_on(trainer), go_on(resumed), strict=True):
        assert np.array_equal(one, other)


def test_loading_undoes_what_was_learnt_meanwhile(tmp_path: Path) -> None:
    trainer = filled_trainer()
    trainer.update(3)
    trainer.save(tmp_path / "saved")
    expected = go_on(trainer)
    trainer.load(tmp_path / "saved")
    for one, other in zip(expected, go_on(trainer), strict=True):
        assert np.array_equal(one, other)


def test_the_seed_decides() -> None:
    one, same, other = (go_on(filled_trainer(seed=seed)) for seed in (0, 0, 1))
    assert all(np.array_equal(a, b) for a, b in zip(one, same, strict=True))
    assert not np.array_equal(one[0], other[0])
    assert not np.array_equal(one[1], other[1])


def test_the_acting_policy_is_that_of_the_last_refresh() -> None:
    trainer = filled_trainer()
    before = trainer.act(OBSERVATIONS, deterministic=True)
    trainer.update(5)
    assert np.array_equal(trainer.act(OBSERVATIONS, deterministic=True), before)
    trainer.refresh()
    assert not np.array_equal(trainer.act(OBSERVATIONS, deterministic=True), before)


def test_acting_while_updating_changes_nothing() -> None:
    alone, beside = filled_trainer(), filled_trainer()
    alone.update(60)
    worker = threading.Thread(target=beside.update, args=(60,))
    worker.start()
    acted = [beside.act(OBSERVATIONS) for _ in range(50)]
    worker.join()
    expected = filled_trainer()
    assert all(np.array_equal(a, expected.act(OBSERVATIONS)) for a in acted)
    for one, other in zip(
        alone.model.policy.state_dict().values(),
        beside.model.policy.state_dict().values(),
        strict=True,
    ):
        assert torch.equal(one, other)


def test_actions_are_within_bounds_and_of_every_world() -> None:
    trainer = filled_trainer()
    for actions in (
        trainer.act(100 * OBSERVATIONS),
        trainer.act(OBSERVATIONS, deterministic=True),
        trainer.random_actions(3),
    ):
        assert actions.shape == (3, A) and np.abs(actions).max() <= 1.0
    with pytest.raises(ShapeError, match=r"observations has shape \(3, 4\), expected \(\*, 5\)"):
        trainer.act(OBSERVATIONS[:, :4])


def test_too_little_to_learn_from_is_an_error() -> None:
    trainer = SacTrainer(F, A, SMALL, 0)
    assert not trainer.can_update
    with pytest.raises(RaplError, match="0 transitions; a batch has 32"):
        trainer.update(1)


@pytest.mark.parametrize("name", ["trainer.safetensors", "card.json"])
@pytest.mark.parametrize("damage", ["truncated", "missing", "altered"])
def test_a_damaged_checkpoint_is_named(tmp_path: Path, name: str, damage: str) -> None:
    folder = filled_trainer().save(tmp_path / "saved")
    file = folder / name
    content = bytearray(file.read_bytes())
    if damage == "missing":
        file.unlink()
    else:
        content[0] ^= 255
        file.write_bytes(content if damage == "altered" else content[1 : len(content) // 2])
    with pytest.raises(CorruptFileError, match=name):
        SacTrainer(F, A, SMALL, 0).load(folder)


def test_a_checkpoint_of_another_kind_is_refused(tmp_path: Path) -> None:
    folder = filled_trainer().save(tmp_path / "saved")
    with pytest.raises(CorruptFileError, match=r"sizes \[5, 2\], expected \[6, 2\]"):
        SacTrainer(F + 1, A, SMALL, 0).load(folder)
    with pytest.raises(CorruptFileError, match="discount: 0.98 != 0.9"):
        SacTrainer(F, A, replace(SMALL, discount=0.9), 0).load(folder)
    card = json.loads((folder / "card.json").read_text())
    del card["parts"]["trainer"]["values"]["config"]["critic_layer_norm"]  # an older one
    (folder / "card.json").write_text(json.dumps(card))
    with pytest.raises(CorruptFileError, match="critic_layer_norm: False != True"):
        SacTrainer(F, A, SMALL, 0).load(folder)
    card["format"] = 7
    (folder / "card.json").write_text(json.dumps(card))
    with pytest.raises(CorruptFileError, match="format 7, expected 1"):
        SacTrainer(F, A, SMALL, 0).load(folder)


def test_a_checkpoint_is_never_overwritten(tmp_path: Path) -> None:
    trainer = filled_trainer()
    trainer.save(tmp_path / "saved")
    with pytest.raises(RaplError, match="already there"):
        trainer.save(tmp_path / "saved")
    with pytest.raises(RaplError, match="cannot write the checkpoint /proc/self/saved"):
        trainer.save("/proc/self/saved")
