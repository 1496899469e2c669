"""Alignment: the loss written out, and what it learns on synthetic videos."""

from dataclasses import replace
from math import exp, log

import numpy as np
import pytest
import torch
from squares import SMALL

from rapl_core.errors import ConvergenceError, RankingError, ShapeError
from rapl_core.representations.alignment import Lesson
from rapl_core.representations.features import MIRRORED, FeatureStore
from rapl_core.representations.presets import AUTHORS_CODE, PAPER, TUNED
from rapl_core.representations.rapl import RaplObjective, align, fit_rapl
from rapl_core.representations.report import wilson_interval
from rapl_core.representations.training import Batch, TiedTriplet, TrainingData, slowness
from rapl_core.transport import ot_distance
from rapl_core.types import EmbeddedEpisode, Triplet


def random_batch(ties: int = 0) -> Batch:
    generator = torch.Generator().manual_seed(0)
    return Batch(
        videos=torch.randn(3, 4, 6, 5, generator=generator),
        experts=torch.randn(2, 6, 5, generator=generator),
        ties=torch.randn(3, ties, 6, 5, generator=generator),
        slow=torch.empty(2, 0, 5),
    )


def probability(batch: torch.Tensor, index: int, preset) -> float:
    best, middle, worst = batch[:, index]
    near = float(ot_distance(best, middle, preset.training)) / preset.temperature
    far = float(ot_distance(best, worst, preset.training)) / preset.temperature
    return exp(-near) / (exp(-near) + exp(-far))


def test_the_loss_of_the_paper_is_its_equation():
    batch = random_batch()
    expected = np.mean([-log(probability(batch.videos, i, PAPER)) for i in range(4)])
    assert float(RaplObjective(PAPER).loss(batch)) == pytest.approx(expected, 1e-4)


def test_the_loss_of_the_authors_code_adds_equal_rankings():
    batch = random_batch(ties=2)
    expected = np.mean([1 - probability(batch.videos, i, AUTHORS_CODE) for i in range(4)])
    expected += np.mean([(0.5 - probability(batch.ties, i, AUTHORS_CODE)) ** 2 for i in range(2)])
    loss = RaplObjective(AUTHORS_CODE).loss(batch)
    assert float(loss) == pytest.approx(expected, 1e-4)


def test_the_tuned_loss_adds_all_pairs_anchored_at_experts():
    batch = random_batch()
    expected = np.mean([-log(probability(batch.videos, i, TUNED)) for i in range(4)])
    for i in range(4):
        a, b, c = (
            -float(torch.cdist(video[None], batch.experts).mean()) for video in batch.videos[:, i]
        )
        expected += sum(log(1 + exp(-(x - y))) for x, y in ((a, b), (b, c), (a, c))) / 4
    assert float(RaplObjective(TUNED).loss(batch)) == pytest.approx(expected, 1e-5)


@pytest.mark.parametrize("preset", [PAPER, AUTHORS_CODE, TUNED], ids=lambda p: p.name)
def test_every_preset_lowers_its_own_loss(preset, features, pool):
    preset = replace(preset, epochs=8, components=preset.components and 32, frames=6)
    lesson = Lesson(pool.triplets, pool.expert_ids)
    history = fit_rapl(features, lesson, preset, np.random.default_rng(0)).history
    assert history.epochs[-1].loss < 0.9 * history.epochs[0].loss


def test_aligned_distances_order_unseen_triplets_better_than_chance(rapl, unseen):
    encoder, _ = rapl
    z = {name: torch.from_numpy(encoder.embed(v)) for name, v in unseen.videos.items()}
    config = SMALL.training
    right = [
        float(ot_distance(z[t.best], z[t.middle], config))
        < float(ot_distance(z[t.best], z[t.worst], config))
        for t in unseen.triplets
    ]
    lower, _ = wilson_interval(float(np.mean(right)), len(right))
    assert lower > 0.55


def test_aligned_rewards_order_unseen_videos_better_than_chance(rapl, unseen, pool):
    encoder, _ = rapl
    experts = [EmbeddedEpisode(n, encoder.embed(pool.videos[n])) for n in encoder.expert_ids]
    totals = {n: encoder.reward(encoder.embed(v), experts).total for n, v in unseen.videos.items()}
    pairs = [(t.best, t.worst) for t in unseen.triplets]
    right = float(np.mean([totals[better] > totals[worse] for better, worse in pairs]))
    assert wilson_interval(right, len(pairs))[0] > 0.65


def test_the_report_tells_what_was_done(rapl, pool):
    encoder, report = rapl
    assert (report.method, report.preset) == ("rapl", "small")
    assert (report.train_triplets, report.held_out_triplets) == (64, 16)
    assert len(report.history) == SMALL.epochs and report.seconds > 0
    best = report.history[report.best_epoch - 1]
    assert best.held_out_loss == min(e.held_out_loss for e in report.history)
    assert report.held_out_accuracy == best.held_out_accuracy
    low, high = report.held_out_interval
    assert low < report.held_out_accuracy < high
    assert 0.5 < report.explained_variance < 1
    assert encoder.expert_ids == tuple(pool.expert_ids)


def test_the_same_seed_gives_the_same_encoder_and_another_seed_another(features, pool, rapl):
    def version(seed: int) -> str:
        args = (features, pool.triplets, pool.expert_ids, replace(SMALL, epochs=2))
        return align(*args, np.random.default_rng(seed))[0].info.version

    assert version(5) == version(5) != version(6)


def test_statistics_do_not_see_videos_of_held_out_triplets_alone(features, pool):
    held_out = [Triplet(*pool.names[-3:])]
    rest = [t for t in pool.triplets if {t.best, t.middle, t.worst}.isdisjoint(pool.names[-3:])]
    preset = replace(SMALL, epochs=2)

    def fit(videos):
        lesson = Lesson(rest, pool.expert_ids, held_out=held_out)
        return fit_rapl(videos, lesson, preset, np.random.default_rng(0))

    changed = {n: f + 5.0 if n in pool.names[-3:] else f for n, f in features.items()}
    first, second = fit(features), fit(changed)
    assert set(pool.names) - set(first.statistics_videos) == set(pool.names[-3:])
    assert torch.equal(first.embedder.projection.mean, second.embedder.projection.mean)
    assert torch.equal(first.embedder.projection.components, second.embedder.projection.components)


def test_early_stopping_and_progress(features, pool):
    seen = []
    preset = replace(SMALL, patience=2, epochs=200, learning_rate=0.1)
    _, report = align(
        features, pool.triplets, pool.expert_ids, preset, np.random.default_rng(0), seen.append
    )
    assert tuple(seen) == report.history
    assert len(seen) == report.best_epoch + 2 < 200


def test_ties_take_part_in_training(features, pool):
    preset = replace(AUTHORS_CODE, epochs=3, frames=4)
    tie = TiedTriplet(pool.names[0], pool.names[7], pool.names[8])

    def weights(ties):
        lesson = Lesson(pool.triplets, pool.expert_ids, ties)
        return fit_rapl(features, lesson, preset, np.random.default_rng(0)).embedder.head.weight

    assert not torch.equal(weights(()), weights((tie,)))


def test_bad_input_is_refused_by_name(features, pool):
    rng = np.random.default_rng(0)
    with pytest.raises(RankingError, match="no triplet"):
        align(features, [], pool.expert_ids, SMALL, rng)
    with pytest.raises(RankingError, match="no expert"):
        align(features, pool.triplets, [], SMALL, rng)
    with pytest.raises(RankingError, match="1 of the ranked videos have no features.*nobody"):
        align(features, pool.triplets, ["nobody"], SMALL, rng)
    with pytest.raises(ShapeError, match="preset paper expects"):
        align(features, pool.triplets, pool.expert_ids, PAPER, rng)
    with pytest.raises(ConvergenceError, match="learning_rate"):
        broken = replace(SMALL, learning_rate=1e30)
        align(features, pool.triplets, pool.expert_ids, broken, rng)


def test_slow_pairs_are_frames_of_one_video_a_fixed_time_apart():
    videos = {n: np.arange(24, dtype=np.float32)[:, None] + 100 * i for i, n in enumerate("abc")}
    data = TrainingData(videos, [], [], ["a"], [], None)
    numbers = data.slow(300, 1 / 12, np.random.default_rng(0))
    earlier, later = data.frames[torch.from_numpy(numbers)].squeeze(-1).numpy()
    assert set(np.unique(earlier // 100)) == {0, 1, 2}, "of any video, not of experts alone"
    assert np.array_equal(earlier // 100, later // 100), "of one video"
    assert np.all(later - earlier == 2)


def test_a_batch_is_what_each_video_shows_from_a_frame_on_and_the_last_part_of_experts():
    videos = {n: np.arange(24, dtype=np.float32)[:, None] + 100 * i for i, n in enumerate("abcd")}
    triplets, ties = [Triplet("a", "b", "c"), Triplet("d", "c", "b")], [TiedTriplet("b", "d", "a")]
    data = TrainingData(videos, triplets, [], ["d", "a"], ties, None, expert_from=0.5)
    drawn = data.draw(data.train, data.train_mistakes, data.experts, data.ties, start=9)
    batch = data.batch(torch.nn.Identity(), drawn)
    shown = torch.arange(9.0, 24)[:, None]
    rows = torch.tensor([[0, 3], [1, 2], [2, 1]])[..., None, None]
    assert torch.equal(batch.videos, 100 * rows + shown)  # (3, 2, 15, 1)
    assert torch.equal(batch.ties, 100 * torch.tensor([1, 3, 0])[:, None, None, None] + shown)
    assert torch.equal(batch.experts, 100 * torch.tensor([3, 0])[:, None, None] + shown[3:])
    assert batch.slow.shape == (2, 0, 1)


def test_slowness_is_how_far_things_move_over_how_far_they_lie_apart():
    place = torch.randn(2000, 1, generator=torch.Generator().manual_seed(0))
    resting, moving = torch.stack([place, place]), torch.stack([place, place.roll(1, 0)])
    # two independent draws lie sqrt(2) times as far apart as each from the mean, in any unit
    wanted = np.sqrt(2)
    assert float(slowness(resting)) == 0.0
    assert float(slowness(moving)) == pytest.approx(wanted, rel=0.05)
    assert float(slowness(10 * moving + 3)) == pytest.approx(float(slowness(moving)), rel=1e-4)


def test_a_head_that_is_to_be_slow_turns_away_from_what_always_moves():
    rng = np.random.default_rng(0)
    names = [f"v{i}" for i in range(30)]
    good = dict(zip(names, np.sort(rng.uniform(0, 1, 30))[::-1], strict=True))
    # what is judged rests from the third frame on; what moves is as good a sign of it at the end
    videos = {
        name: np.stack(
            [np.r_[0.0, 0.0, np.full(22, value)], value * np.linspace(0, 2, 24)], axis=1
        ).astype(np.float32)
        for name, value in good.items()
    }
    drawn = [np.sort(rng.choice(30, 3, replace=False)) for _ in range(60)]
    lesson = Lesson([Triplet(*(names[i] for i in three)) for three in drawn], names[:3])
    plain = replace(SMALL, has_projection=False, components=None, slow_weight=0.0)
    shares = []
    for preset in (plain, replace(plain, slow_weight=4.0)):
        head = fit_rapl(videos, lesson, preset, np.random.default_rng(1)).embedder.head
        resting, moving = head.weight.detach().norm(dim=0)
        shares.append(float(moving / (moving + resting)))
    assert shares[1] < 0.8 * shares[0]


def test_mirrored_videos_are_learnt_from_and_choose_nothing(extractor, pool):
    mirrored = replace(SMALL, mirror=True)
    store = FeatureStore(extractor, mirror=True)
    for name, frames in pool.videos.items():
        store.add(name, frames)
    fit = fit_rapl(
        store, Lesson(pool.triplets, pool.expert_ids), mirrored, np.random.default_rng(2)
    )
    assert not any(t.best.startswith(MIRRORED) for t in fit.split.held_out)
    unseen = fit.split.unseen_videos
    used = set(fit.statistics_videos)
    assert {n for n in used if not n.startswith(MIRRORED)} == set(pool.names) - unseen
    assert {n.removeprefix(MIRRORED) for n in used if n.startswith(MIRRORED)} == (
        set(pool.names) - unseen
    )


def test_features_without_mirrored_twins_are_refused_where_the_preset_wants_them(features, pool):
    with pytest.raises(ShapeError, match="without mirrored twins.*mirror=True"):
        mirrored = replace(SMALL, mirror=True)
        align(features, pool.triplets, pool.expert_ids, mirrored, np.random.default_rng(2))
