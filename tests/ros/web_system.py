"""The page as people have it: real nodes `preference` and `web` on a folder of videos."""

import os
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray
from own_domain import enter_own_domain
from ros_harness import NodeProcess

from rapl_core.episodes import EpisodeStore
from rapl_core.preferences import RankingStore
from rapl_core.types import Episode
from rapl_ros import topics
from rapl_ros.run_config import WEB_ADDRESS_FILE

START_S = 120.0
PERIOD_NS = 80_000_000


def colour_of(number: int) -> tuple[int, int, int]:
    """Of the corner of a video: tells which one it is."""
    return 20 + 6 * (number % 32), 40 + 12 * (number // 32), 90


def make_frames(number: int, frames: int, size: int) -> NDArray[np.uint8]:
    """A bright square on its way; the corner has the video's own colour."""
    pictures = np.full((frames, size, size, 3), 70, np.uint8)
    pictures[:, :8, :8] = colour_of(number)
    side = size // 5
    for frame in range(frames):
        x = round(frame / frames * (size - side))
        pictures[frame, size // 2 : size // 2 + side, x : x + side] = (240, 200, 30)
    return pictures


def make_videos(
    folder: Path, count: int, frames: int = 31, size: int = 112, purpose: str = "demonstrate"
) -> list[str]:
    """Write videos into a run folder and return their ids."""
    name = "secret" if purpose == "demonstrate" else purpose
    store = EpisodeStore(folder / "episodes")
    for number in range(count):
        store.add(
            Episode(
                episode_id=f"{name}-{number:03d}",
                task="franka_group",
                world=0,
                purpose=purpose,
                controller="demonstrator",
                frames=make_frames(number, frames, size),
                states=np.zeros((frames, 2)),
                actions=np.zeros((frames - 1, 2)),
                stamps_ns=(1 + np.arange(frames, dtype=np.int64)) * PERIOD_NS,
                behaviour="secret",
            )
        )
    return store.ids()


class WebSystem:
    """The two nodes, and what a test asks of them."""

    def __init__(self, folder: Path, preference: NodeProcess, web: NodeProcess) -> None:
        self.folder, self.preference, self.web = folder, preference, web
        self.address, _, self.token = self._address().partition("#token=")

    def _address(self) -> str:
        file = self.folder / WEB_ADDRESS_FILE
        end = time.monotonic() + START_S
        while time.monotonic() < end:
            assert self.web.process.poll() is None, self.web.text()
            if file.exists():
                return file.read_text().split()[0]
            time.sleep(0.05)
        raise AssertionError(f"no page within {START_S:g} s: {self.web.text()}")

    def client(self, **headers: str) -> httpx.Client:
        """A client of the HTTP interface that has the token."""
        if self.token:
            headers.setdefault("Authorization", f"Bearer {self.token}")
        return httpx.Client(base_url=self.address, headers=headers, timeout=30.0)

    def set_preference(self, name: str, value: Any) -> None:
        """Set a parameter of the preference node, as the conductor does while it runs."""
        command = [sys.executable, "-m", "rapl_ros.ros2_standin", "param", "set"]
        command += [f"/rapl/{topics.PREFERENCE}", name, str(value)]
        subprocess.run(command, check=True, timeout=START_S, capture_output=True)

    def store(self) -> RankingStore:
        """The rankings on disk."""
        return RankingStore(self.folder / "rankings.sqlite")

    def until_ready(self) -> None:
        """Wait until the preference node answers."""
        end = time.monotonic() + START_S
        with self.client() as client:
            own = {"annotator": "nobody"}  # of all only an operator may know
            while (answer := client.get("api/progress", params=own)).status_code != 200:
                assert time.monotonic() < end, answer.text
                time.sleep(0.2)


@contextmanager
def web_system(folder: Path, **parameters: Any) -> Iterator[WebSystem]:
    """Start the nodes on ``folder`` and end them.

    :param parameters: of the web node, and with the prefix ``preference_`` of the other.
    """
    shared = {k.removeprefix("preference_"): v for k, v in parameters.items() if "preference_" in k}
    own = {"port": 0} | {k: v for k, v in parameters.items() if "preference_" not in k}
    nodes = []
    outer = os.environ["ROS_DOMAIN_ID"]
    enter_own_domain()
    try:
        for module, values in (("preference_node", shared), ("web_node", own)):
            log = folder / f"{module}.log"
            nodes.append(NodeProcess(f"rapl_ros.{module}", log, run_folder=folder, **values))
        system = WebSystem(folder, *nodes)
        system.until_ready()
        yield system
    finally:
        for node in reversed(nodes):
            node.stop()
        os.environ["ROS_DOMAIN_ID"] = outer


def ask(client: httpx.Client, annotator: str, **more: Any) -> dict[str, Any]:
    """A query for somebody."""
    answer = client.post("api/queries", json={"annotator": annotator, **more})
    assert answer.status_code == 200, answer.text
    return answer.json()


def answer_to(query: dict[str, Any], annotator: str, **more: Any) -> dict[str, Any]:
    """What the page sends when somebody has ranked its videos."""
    return {
        "ranking_id": uuid.uuid4().hex,
        "query_id": query["query_id"],
        "annotator": annotator,
        "verdict": "ranked",
        "ranks": [2, 1, 3],
        "response_s": 1.5,
        **more,
    }


def refused(answer: httpx.Response, status: int, code: str) -> str:
    """Check that an answer is a refusal in the documented form; return its message."""
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    return answer.json()["message"]
