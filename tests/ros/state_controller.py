"""A controller of the test's own: answers the simulator's states as ``learner``."""

from collections.abc import Callable, Sequence

from rapl_msgs.msg import Action, State
from rapl_msgs.srv import Reset
from ros_harness import DISCOVERY_S, Probe

from rapl_ros import conversions, qos, topics
from rapl_ros.wire import answer

RESET = topics.of_node(topics.RESET, topics.SIMULATOR)


class Controller:
    """Answers states with a constant push, as ``learner``.

    :param choose: chooses another action (A,).
    """

    def __init__(
        self, probe: Probe, choose: Callable[[State], Sequence[float]] = lambda _: (0.5, 0.1)
    ) -> None:
        self.probe = probe
        self.obeys = True
        self._choose = choose
        self.publisher = probe.node.create_publisher(Action, topics.ACTION, qos.stream())
        self.states = probe.listen(State, topics.STATE, qos.stream(), self._on_state)

    def _on_state(self, msg: State) -> None:
        if self.obeys and not msg.is_last:
            self.send(msg)

    def send(self, msg: State, **changes) -> None:
        action = conversions.action_to_ros(
            answer(conversions.state_from_ros(msg), self._choose(msg))
        )
        for name, value in changes.items():
            setattr(action, name, value)
        self.publisher.publish(action)

    def reset(self, **fields) -> Reset.Response:
        values = dict(purpose="train", controller=topics.LEARNER, episodes=1, seed=5) | fields
        return self.probe.call(Reset, RESET, Reset.Request(**values))

    def until(self, condition, deadline_s, what):
        return self.probe.until(condition, deadline_s, what)


def wait_for(controller):
    """Until the simulator's topics are matched."""
    controller.until(
        lambda: (
            controller.publisher.get_subscription_count() > 0
            and controller.probe.node.count_publishers(topics.STATE) > 0
        ),
        DISCOVERY_S,
        "the simulator is discovered",
    )
