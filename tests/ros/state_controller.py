"""A controller of the test's own: answers the simulator's states as ``learner``."""

from rapl_msgs.msg import Action, State
from rapl_msgs.srv import Reset
from ros_harness import DISCOVERY_S, Probe

from rapl_ros import conversions, qos, topics
from rapl_ros.wire import answer

RESET = topics.of_node(topics.RESET, topics.SIMULATOR)


class Controller:
    """Answers states with a constant push, as ``learner``."""

    def __init__(self, probe: Probe) -> None:
        self.probe = probe
        self.obeys = True
        self.publisher = probe.node.create_publisher(Action, topics.ACTION, qos.stream())
        self.states = probe.listen(State, topics.STATE, qos.stream(), self._on_state)

    def _on_state(self, msg: State) -> None:
        if self.obeys and not msg.is_last:
            self.send(msg)

    def send(self, msg: State, **changes) -> None:
        action = conversions.action_to_ros(answer(conversions.state_from_ros(msg), [0.5, 0.1]))
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
