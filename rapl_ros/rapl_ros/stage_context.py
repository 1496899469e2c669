"""What the stages of the main job work with."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from rapl_msgs.action import Align, Collect, Evaluate, Train
from rapl_msgs.srv import GetProgress

from rapl_ros import topics
from rapl_ros.goals import ActionPort, ParameterPort
from rapl_ros.node import RaplNode
from rapl_ros.run_config import RunConfig


class ShowProgress(Protocol):
    """Takes how far the stage under way is."""

    def __call__(self, done: int, total: int, unit: str, detail: str = "") -> None: ...


class StageContext:
    """What the stages work with.

    :param node: whose clients are used.
    :param show: takes progress.
    :param say: takes what is waited for; empty when the wait is over.
    """

    def __init__(
        self,
        node: RaplNode,
        run: RunConfig,
        folder: Path,
        show: ShowProgress,
        say: Callable[[str], None],
    ) -> None:
        def port(kind: type, name: str, peer: str) -> ActionPort:
            return ActionPort(node, kind, topics.of_node(name, peer), peer, say)

        self.node, self.run, self.folder, self.show, self.say = node, run, folder, show, say
        self.collect = port(Collect, topics.COLLECT, topics.DEMONSTRATOR)
        self.align = port(Align, topics.ALIGN, topics.PREFERENCE)
        self.train = port(Train, topics.TRAIN, topics.LEARNER)
        self.evaluate = port(Evaluate, topics.EVALUATE, topics.LEARNER)
        self.progress = node.create_client(
            GetProgress, topics.of_node(topics.GET_PROGRESS, topics.PREFERENCE)
        )
        self.encoder = ParameterPort(node, topics.ENCODER, say)
        self.human = ParameterPort(node, topics.SIMULATED_HUMAN, say)
