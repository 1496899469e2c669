"""The node ``web``: the page on which people rank videos and watch the system."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rapl_msgs import msg as wire_msg
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from rapl_core.atomic import write_atomically
from rapl_core.episodes import EpisodeStore
from rapl_core.errors import CorruptFileError, RaplError
from rapl_ros import conversions, qos, topics
from rapl_ros.liveness import Peer
from rapl_ros.node import RaplNode, main
from rapl_ros.parameters import declare_config
from rapl_ros.run_config import WEB_ADDRESS_FILE, RunConfig, load_config, where
from rapl_ros.web.app import WebApp
from rapl_ros.web.guard import HostRule
from rapl_ros.web.live import EncoderView, LiveBoard, RewardView
from rapl_ros.web.server import (
    OPERATOR_TOKEN_FILE,
    TOKEN_FILE,
    ServerThread,
    address_of,
    addresses_for_others,
    listen,
    token_of,
)
from rapl_ros.web.sprites import SheetCache
from rapl_ros.web_graph import WebGraph

QUESTION: Final = "Which do you like best?"
NODES: Final = (
    topics.SIMULATOR,
    topics.ENCODER,
    topics.OT_REWARD,
    topics.RECORDER,
    topics.PREFERENCE,
    topics.SIMULATED_HUMAN,
    topics.DEMONSTRATOR,
    topics.LEARNER,
    topics.CONDUCTOR,
)


@dataclass(frozen=True)
class WebConfig:
    """Parameters of the web node."""

    run_folder: Path = Path(".")
    """Run folder: episodes/ has the videos, encoders/ the encoders, policies/ the curve."""
    host: str = "127.0.0.1"
    """Address to listen on. Beyond this machine (e.g. 0.0.0.0) every request needs a token."""
    port: int = field(default=8765, metadata={"minimum": 0, "maximum": 65535})
    """Port, or the next free one of twenty; 0: any."""
    allowed_hosts: tuple[str, ...] = ()
    """Further names under which browsers may ask, e.g. that of a proxy. With any, every request
    needs a token."""
    question: str = ""
    """What people are asked, above the videos; empty: which one they like best."""


class WebNode(RaplNode):
    """Serves the page; a client of the preference node's services.

    Subscribes ``progress``, ``metrics``, ``reward``, ``encoder_info``, ``/diagnostics``, the
    heartbeats of all nodes and, while somebody looks at them, the pictures of
    ``camera/image_raw``. Publishes ``unreadable_episode`` (std_msgs/String). Calls
    ``preference/get_query``, ``preference/submit_ranking``, ``preference/undo``,
    ``preference/get_progress``, ``preference/align`` and sets the parameter ``encoder`` of
    ``encoder``. HTTP is served on a thread of its own.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.WEB, peers=(topics.PREFERENCE,), **options)
        self.config = declare_config(self, WebConfig())
        folder = self.config.run_folder
        run = _run_of(folder)
        self._board = LiveBoard(folder, run.task, NODES, topics.CONDUCTOR)
        self._graph = WebGraph(self, self._board, run.reward if run.aligns else "rapl", run.preset)
        self._sheets = SheetCache(EpisodeStore(folder / "episodes"))
        self._server: ServerThread | None = None
        self._camera: Subscription | None = None
        self._peers_shown = [
            Peer(self, name, lambda _: None, lambda _name, _restarted: None) for name in NODES
        ]
        self._subscribe()
        self.address = ""
        self._start = self.steady_timer(0.01, self._begin)
        self.steady_timer(0.5, self._refresh)

    def close(self) -> None:
        """Stop serving."""
        if self._server is not None:
            self._server.close()
            (self.config.run_folder / WEB_ADDRESS_FILE).unlink(missing_ok=True)

    def _subscribe(self) -> None:
        self.subscribe_to(
            wire_msg.Progress,
            topics.PROGRESS,
            lambda msg: self._board.add_progress(conversions.progress_from_ros(msg)),
            qos.progress(),
        )
        self.subscribe_to(
            wire_msg.Metrics,
            topics.METRICS,
            lambda msg: self._board.add_metrics(conversions.metrics_from_ros(msg)),
            qos.event(),
        )
        self.subscribe_to(wire_msg.Reward, topics.REWARD, self._on_reward, qos.event())
        self.subscribe_to(
            wire_msg.EncoderInfo, topics.ENCODER_INFO, self._on_encoder, qos.latched()
        )
        self.subscribe_to(
            DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.diagnostics()
        )

    def _begin(self) -> None:
        """Serve, now that an executor turns this node."""
        self._start.cancel()
        config = self.config
        hosts = HostRule(config.host, config.allowed_hosts)
        # Behind a proxy the whole world may come from this machine.
        is_private = hosts.is_local and not any(config.allowed_hosts)
        token, operator = (
            "" if is_private else token_of(config.run_folder, name)
            for name in (TOKEN_FILE, OPERATOR_TOKEN_FILE)
        )
        listener = listen(config.host, config.port)
        graph, question = self._graph, config.question or QUESTION
        web = WebApp(graph, graph, self._sheets, self._board, question, self._on_refusal)
        self._server = ServerThread(web.guarded(hosts, token, operator), listener)
        bare = address_of(listener)
        addresses = [bare, *addresses_for_others(listener)]
        if token:
            addresses = [f"{address}#token={token}" for address in addresses]
            addresses.append(f"{bare}live#token={operator}")
        self.address = addresses[0]
        text = "".join(f"{address}\n" for address in addresses)
        write_atomically(config.run_folder / WEB_ADDRESS_FILE, text, mode=0o600)
        self.get_logger().info(f"people rank at {where(addresses)}")
        self.heartbeat.report("active", bare)

    def _refresh(self) -> None:
        """Twice a second: how the nodes are, whether the camera is wanted."""
        for peer in self._peers_shown:
            state = self._board.nodes[peer.name]
            state.seen = state.seen or peer.alive
            state.alive, state.status, state.detail = peer.alive, peer.status, peer.detail
        if self._graph.wants_pictures and self._camera is None:
            self._camera = self.subscribe_to(
                Image, topics.CAMERA_IMAGE, self._graph.show, qos.preview()
            )
        elif not self._graph.wants_pictures and self._camera is not None:
            self.destroy_subscription(self._camera)
            self._camera = None
            self._graph.show(None)
        if self._server is not None and not self._server.alive:
            raise RaplError("the web server has ended")

    def _on_reward(self, msg: wire_msg.Reward) -> None:
        self._board.add_reward(
            RewardView(
                episode_id=msg.episode_id,
                purpose=msg.purpose,
                valid=msg.valid,
                reason=msg.reason,
                total=msg.total if msg.valid else None,
                version=msg.version,
            )
        )

    def _on_encoder(self, msg: wire_msg.EncoderInfo) -> None:
        info = conversions.encoder_info_from_ros(msg)
        self._board.encoder = EncoderView(
            name=info.name,
            version=info.version,
            backbone=info.backbone,
            preset=info.preset,
            dimension=info.dimension,
        )

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        prefix = f"{self.get_namespace()}/"
        for status in msg.status:
            state = self._board.nodes.get(status.name.removeprefix(prefix))
            if state is not None:
                state.level, state.complaint = int.from_bytes(status.level), status.message

    def _on_refusal(self, code: str, message: str) -> None:
        """Count and log what was refused; on the server's thread, so it is handed over."""

        def tell() -> None:
            self.diagnostics.count("refused_requests")
            self.get_logger().warning(f"refused ({code}): {message}")

        if self.executor is not None:
            self.executor.create_task(tell)


def _run_of(folder: Path) -> RunConfig:
    """The settings of the run, where there is one; else those of the method."""
    try:
        return load_config(folder)
    except CorruptFileError:
        return RunConfig(task="")


if __name__ == "__main__":
    main(WebNode)
