"""The node ``simulator``: N worlds of a task in one process."""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rapl_msgs.msg import Action, State, WorldInfo
from rapl_msgs.srv import Reset
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState

from rapl_core.errors import RaplError, ShapeError
from rapl_core.simulation.simulation import Simulation
from rapl_core.tasks import get_task
from rapl_ros import conversions, qos, topics
from rapl_ros.diagnostics import BAD_INPUT_S
from rapl_ros.lockstep import Assignment, Lockstep, Scene
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.sim_clock import SimClock, default_clock_file
from rapl_ros.wire import Instant, World

REPEAT_S = 1.0
"""Wall time after which a pending state and its image are published again."""


@dataclass(frozen=True)
class SimulatorConfig:
    """Parameters of the simulator."""

    task: str = "franka_group"
    """Registered task, e.g. franka_group."""
    worlds: int = field(default=4, metadata={"minimum": 1, "maximum": 1024})
    """Worlds in this process."""
    render: bool = True
    """Whether pictures are drawn; a reward from the true state needs none."""
    real_time_factor: float = field(default=0.0, metadata={"minimum": 0.0, "maximum": 100.0})
    """Simulated seconds a wall second at most; 0: as fast as the controllers answer."""
    clock_file: Path = field(default_factory=default_clock_file)
    """Keeps how far simulation time went, so that stamps increase across restarts."""


class SimulatorNode(RaplNode):
    """Steps and draws the worlds; obeys the controller that ``~/reset`` names.

    Subscribes ``action`` (rapl_msgs/Action). Publishes ``state`` (rapl_msgs/State), ``world_info``
    (rapl_msgs/WorldInfo, latched), ``/clock``, and for world 0 ``camera/image_raw``
    (sensor_msgs/Image), ``camera/camera_info``, ``joint_states``, for the others ``env_<i>/...``.
    Serves ``~/reset`` (rapl_msgs/Reset).

    A step runs in the executor's thread although it takes milliseconds: the GL context belongs to
    one thread, and there is nothing else that this node could do meanwhile.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.SIMULATOR, **options)
        self.config = declare_config(self, SimulatorConfig())
        self.task = get_task(self.config.task)
        needed = qos.stream_depth(self.config.worlds, self.task.horizon)
        if needed > qos.STREAM_DEPTH:
            raise ShapeError(
                f"{self.config.worlds} worlds of {self.task.horizon} steps need queues of {needed} "
                f"messages, they hold {qos.STREAM_DEPTH}: take fewer worlds"
            )
        self._simulation = Simulation(self.task, self.config.worlds, self.config.render)
        self._fovy_deg = float(self._simulation.model.camera(self.task.camera).fovy[0])
        self._sim_clock = SimClock(self.config.clock_file, self.task.period_s)
        self._shares = self.diagnostics.shares
        self._lockstep = Lockstep(self._simulation, self._shares, self.config.render)
        self._answered_s = time.monotonic()
        self._create_interfaces()
        if self.config.real_time_factor > 0:
            period_s = self.task.period_s / self.config.real_time_factor
            self.steady_timer(period_s, self._step_when_ready)
        self.steady_timer(REPEAT_S, self._repeat)
        self.heartbeat.report("waiting", "for a reset")

    def _create_interfaces(self) -> None:
        worlds = range(self.config.worlds)

        def per_world(kind: type, name: str) -> list[Any]:
            return [
                self.publish_to(kind, topics.world_topic(name, world), qos.stream())
                for world in worlds
            ]

        self._images = per_world(Image, topics.CAMERA_IMAGE)
        self._cameras = per_world(CameraInfo, topics.CAMERA_INFO)
        self._joints = per_world(JointState, topics.JOINT_STATES)
        self._states = self.publish_to(State, topics.STATE, qos.stream())
        self._clocks = self.publish_to(Clock, topics.CLOCK, qos.clock())
        self._world_infos = self.publish_to(WorldInfo, topics.WORLD_INFO, qos.latched())
        self._world_infos.publish(
            conversions.world_to_ros(
                World(
                    task=self.task.name,
                    worlds=self.config.worlds,
                    period_s=self.task.period_s,
                    max_steps=self.task.horizon,
                    lockstep=True,
                    state_names=self.task.state_names,
                    state_units=self.task.state_units,
                    action_names=self.task.action_names,
                    camera_frames=tuple(topics.camera_frame(world) for world in worlds),
                    seed=0,
                ),
                self._sim_clock.now_ns,
            )
        )
        self.subscribe_to(Action, topics.ACTION, self._on_action, qos.stream())
        self.create_service(Reset, topics.RESET, self._on_reset)

    def _on_reset(self, request: Reset.Request, response: Reset.Response) -> Reset.Response:
        try:
            assignment = None
            if request.controller:
                assignment = Assignment(
                    request.purpose,
                    request.controller,
                    request.episodes,
                    request.first_episode,
                    request.seed,
                )
            scenes = self._lockstep.assign(list(request.worlds), assignment, self._tick())
        except RaplError as error:
            response.message = str(error)
            return response
        for scene in scenes:
            self._publish(scene)
        self._answered_s = time.monotonic()
        self._watch_controllers()
        response.success = True
        response.message = f"{len(scenes)} worlds reset"
        response.episode_ids = [scene.instant.episode_id for scene in scenes]
        return response

    def _watch_controllers(self) -> None:
        controllers = self._lockstep.controllers
        for peer in set(self.peers) - controllers:
            self.unwatch(peer)
        for peer in controllers:
            self.watch(peer)
        names = ", ".join(sorted(controllers))
        self.heartbeat.report("active" if names else "waiting", names or "for a reset")

    def _on_action(self, msg: Action) -> None:
        try:
            ignored = self._lockstep.offer(conversions.action_from_ros(msg))
        except ShapeError as error:
            self.diagnostics.warn_for(BAD_INPUT_S, "action", str(error))
            ignored = "not finite or empty"
        if ignored:
            self.diagnostics.count("ignored_actions")
            self.diagnostics.count(f"ignored_actions: {ignored}")
            return
        if self.config.real_time_factor == 0:
            self._step_when_ready()

    def _step_when_ready(self) -> None:
        # A round in which all episodes ended is followed by one that begins the next: no action.
        while self._lockstep.is_ready:
            for scene in self._lockstep.advance(self._tick()):
                self._publish(scene)
                self.diagnostics.count("instants")
            self._answered_s = time.monotonic()
            if self.config.real_time_factor > 0:
                break

    def _tick(self) -> int:
        """Advance /clock by a control period and return its time in nanoseconds."""
        now_ns = self._sim_clock.advance()
        self._publish_clock()
        return now_ns

    def _publish_clock(self) -> None:
        self._clocks.publish(Clock(clock=conversions.time_to_ros(self._sim_clock.now_ns)))

    def _publish(self, scene: Scene) -> None:
        instant = scene.instant
        with self._shares.of("ros"):
            if scene.picture is not None:
                image = conversions.image_to_ros(scene.picture, instant.image)
                self._images[instant.world].publish(image)
                self._publish_camera(instant, image.width, image.height)
            self._joints[instant.world].publish(
                conversions.joint_state_to_ros(
                    instant.key,
                    self.task.joint_names,
                    scene.joint_positions,
                    scene.joint_velocities,
                )
            )
            self._states.publish(conversions.state_to_ros(instant))

    def _publish_camera(self, instant: Instant, width: int, height: int) -> None:
        camera = self._cameras[instant.world]
        if camera.get_subscription_count() > 0:  # few want it, and it costs as much as a state
            camera.publish(
                conversions.camera_info_to_ros(instant.image, width, height, self._fovy_deg)
            )

    def _repeat(self) -> None:
        """Publish what waits for an answer again, so that nothing lost can stall the graph."""
        self._publish_clock()
        waited_s = time.monotonic() - self._answered_s
        pending = self._lockstep.pending()
        if waited_s < REPEAT_S or not pending:
            if self._lockstep.controllers:
                self.heartbeat.report("active", ", ".join(sorted(self._lockstep.controllers)))
            return
        names = ", ".join(sorted({scene.instant.controller for scene in pending}))
        self.heartbeat.report("waiting", f"for actions of {names}")
        for scene in pending:
            self._publish(scene)
            self.diagnostics.count("repeated_instants")

    def close(self) -> None:
        """Free the GL context."""
        self._simulation.close()


if __name__ == "__main__":
    main(SimulatorNode)
