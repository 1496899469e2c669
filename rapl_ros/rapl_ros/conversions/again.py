"""Recorded episodes that are embedded and rewarded again."""

from collections.abc import Mapping
from typing import Any

from rapl_msgs.srv import EmbedEpisodes, RewardAgain

from rapl_core.errors import ShapeError
from rapl_ros.conversions.encoders import embedded_episode_from_ros, embedded_episode_to_ros
from rapl_ros.conversions.episodes import episode_record_from_ros, episode_record_to_ros
from rapl_ros.conversions.rewards import reward_from_ros, reward_to_ros
from rapl_ros.wire import EmbeddingsAgain, RewardsAgain


def fill_embed_episodes(response: EmbedEpisodes.Response, again: EmbeddingsAgain) -> None:
    """EmbeddingsAgain to the response of EmbedEpisodes."""
    _fill(response, again)
    response.episodes = [embedded_episode_to_ros(embedded) for _, embedded in again.episodes]
    response.infos = [episode_record_to_ros(record) for record, _ in again.episodes]


def embeddings_again_from_ros(response: EmbedEpisodes.Response) -> EmbeddingsAgain:
    """The response of EmbedEpisodes to EmbeddingsAgain.

    :raises ShapeError: if values do not fit their sizes or are not finite, or lists differ in
        length.
    """
    _check_equal("episodes", response.episodes, "infos", response.infos)
    pairs = zip(response.infos, response.episodes, strict=True)
    return EmbeddingsAgain(
        response.encoder,
        response.version,
        tuple((episode_record_from_ros(i), embedded_episode_from_ros(e)) for i, e in pairs),
        _missing(response),
    )


def fill_reward_again(response: RewardAgain.Response, again: RewardsAgain) -> None:
    """RewardsAgain to the response of RewardAgain."""
    _fill(response, again)
    response.rewards = [reward_to_ros(whose, trace) for whose, trace in again.rewards]


def rewards_again_from_ros(response: RewardAgain.Response) -> RewardsAgain:
    """The response of RewardAgain to RewardsAgain.

    :raises ShapeError: if a reward is empty, not finite or not valid, or lists differ in length.
    """
    rewards = []
    for msg in response.rewards:
        whose, trace = reward_from_ros(msg)
        if trace is None:
            raise ShapeError(f"reward of episode {msg.episode_id} is not valid: {msg.reason}")
        rewards.append((whose, trace))
    return RewardsAgain(response.encoder, response.version, tuple(rewards), _missing(response))


def _fill(response: Any, again: EmbeddingsAgain | RewardsAgain) -> None:
    response.success = True
    response.encoder, response.version = again.encoder, again.version
    response.missing, response.reasons = list(again.missing), list(again.missing.values())


def _missing(response: Any) -> Mapping[str, str]:
    _check_equal("missing", response.missing, "reasons", response.reasons)
    return dict(zip(response.missing, response.reasons, strict=True))


def _check_equal(name: str, ones: Any, other: str, others: Any) -> None:
    if len(ones) != len(others):
        raise ShapeError(f"{len(ones)} {name} and {len(others)} {other}, expected as many")
