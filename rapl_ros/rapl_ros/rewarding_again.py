"""``ot_reward/reward_again``: rewards of recorded episodes by the encoder at work."""

from collections.abc import Sequence

from rapl_msgs.srv import EmbedEpisodes, RewardAgain
from rclpy.callback_groups import ReentrantCallbackGroup

from rapl_core.errors import RaplError
from rapl_core.streaming.reward_desk import RewardDesk
from rapl_core.types import RewardTrace
from rapl_ros import conversions, topics
from rapl_ros.calls import CallError, call_peer, pause
from rapl_ros.node import RaplNode
from rapl_ros.wire import EpisodeReward, RewardsAgain

EMBEDDING_S = 60.0
"""For the encoder to embed a request's episodes: some seconds on a quiet machine. What it has
done by then stays on its disk, so that a second request is quicker."""


class RewardingAgain:
    """Has recorded episodes embedded and scores them by the rule of that version.

    :param desk: knows rules and experts.
    """

    def __init__(self, node: RaplNode, desk: RewardDesk) -> None:
        self._node, self._desk = node, desk
        self._encoder = node.create_client(
            EmbedEpisodes, topics.of_node(topics.EMBED_EPISODES, topics.ENCODER)
        )
        # Its callback waits; in the node's own group it would stop all others.
        node.create_service(
            RewardAgain,
            topics.REWARD_AGAIN,
            self._on_request,
            callback_group=ReentrantCallbackGroup(),
        )

    async def _on_request(
        self, request: RewardAgain.Request, response: RewardAgain.Response
    ) -> RewardAgain.Response:
        try:
            again = await self._reward(request.episode_ids)
        except RaplError as error:
            response.message = str(error)
            self._node.diagnostics.count("refused_rewards_again")
            return response
        conversions.fill_reward_again(response, again)
        self._node.diagnostics.count("rewarded_again", len(again.rewards))
        return response

    async def _reward(self, episode_ids: Sequence[str]) -> RewardsAgain:
        if topics.ENCODER not in self._node.peers:
            raise RaplError("rewards come from human_reward: no encoder changes them")
        asked = EmbedEpisodes.Request(episode_ids=list(episode_ids))
        answer = await call_peer(self._node, self._encoder, asked, topics.ENCODER, EMBEDDING_S)
        if not answer.success:
            raise CallError(f"the encoder embeds nothing: {answer.message}")
        embedded = conversions.embeddings_again_from_ros(answer)
        rewards: list[tuple[EpisodeReward, RewardTrace]] = []
        for record, episode in embedded.episodes:
            trace = self._desk.reward_again(embedded.version, episode.values)
            whose = EpisodeReward(
                record.key,
                record.episode_id,
                record.world,
                record.purpose,
                embedded.encoder,
                embedded.version,
            )
            rewards.append((whose, trace))
            await pause(self._node, 0.0)  # live episodes come first
        return RewardsAgain(embedded.encoder, embedded.version, tuple(rewards), embedded.missing)
