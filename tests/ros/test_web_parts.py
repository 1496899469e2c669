"""Parts of the page that need neither browser nor graph: sheets, hosts, ports, the live board."""

import asyncio
import contextlib
import io
import math
import re
import socket
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from web_system import make_frames, make_videos

from rapl_core.episodes import EpisodeStore
from rapl_core.errors import UnknownNameError
from rapl_ros.console import Console
from rapl_ros.progress import StageProgress
from rapl_ros.run_all import tell_page
from rapl_ros.run_config import WEB_ADDRESS_FILE
from rapl_ros.web import connections
from rapl_ros.web.guard import HostRule
from rapl_ros.web.live import LiveBoard, RewardView
from rapl_ros.web.server import AddressError, ServerThread, address_of, listen, token_of
from rapl_ros.web.sprites import LONGEST_SIDE, SheetCache, SheetLayout, layout_of, make_sheet
from rapl_ros.wire import LearnerMetrics

ROOT = Path(__file__).parents[2]


def cut(sheet: bytes, layout: SheetLayout) -> np.ndarray:
    """The frames in a sheet, as the page cuts them: (F, H, W, 3)."""
    with Image.open(io.BytesIO(sheet)) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    assert max(pixels.shape[:2]) <= LONGEST_SIDE
    frames = []
    for number in range(layout.frames):
        y, x = (number // layout.columns) * layout.height, (number % layout.columns) * layout.width
        frames.append(pixels[y : y + layout.height, x : x + layout.width])
    return np.stack(frames)


def test_a_sheet_has_every_pixel_of_every_frame_and_the_time_between_them(tmp_path: Path) -> None:
    (episode_id,) = make_videos(tmp_path, 1, frames=31)
    store = EpisodeStore(tmp_path / "episodes")
    cache = SheetCache(store)
    layout = cache.layout(episode_id)
    assert (layout.frames, layout.stride) == (31, 1)
    assert layout.period_s == pytest.approx(0.08)
    assert np.array_equal(cut(cache.sheet(episode_id), layout), store.frames(episode_id))
    assert cache.sheet(episode_id) is cache.sheet(episode_id), "made once"
    with pytest.raises(UnknownNameError):
        cache.sheet("elsewhere")


@settings(max_examples=60, deadline=None)
@given(steps=st.integers(0, 20_000), width=st.integers(1, 5000), height=st.integers(1, 5000))
def test_any_video_fits_into_a_sheet_that_every_device_takes(
    tmp_path_factory: pytest.TempPathFactory, steps: int, width: int, height: int
) -> None:
    summary = type("Summary", (), {
        "steps": steps, "image_width": width, "image_height": height, "first_stamp_ns": 0,
        "last_stamp_ns": steps * 40_000_000,
    })  # fmt: skip
    layout = layout_of(summary)
    assert layout.columns * layout.width <= LONGEST_SIDE
    assert layout.rows * layout.height <= LONGEST_SIDE
    assert layout.frames * layout.stride >= steps + 1 > (layout.frames - 1) * layout.stride
    if steps:
        assert layout.period_s == pytest.approx(0.04 * layout.stride)


def test_large_frames_shrink_and_keep_their_shape() -> None:
    frames = np.stack([np.asarray(Image.fromarray(f).resize((640, 480)))
                       for f in make_frames(3, 60, 112)])  # fmt: skip
    layout = SheetLayout(60, 1, 8, 320, 240, 0.1)
    shown = cut(make_sheet(frames, layout), layout)
    assert shown.shape == (60, 240, 320, 3)
    assert abs(shown.astype(int).mean() - frames.astype(int).mean()) < 3


@pytest.mark.parametrize(
    ("host", "name", "allowed"),
    [
        ("127.0.0.1", "127.0.0.1:8765", True),
        ("127.0.0.1", "localhost", True),
        ("127.0.0.1", "LOCALHOST:9000", True),
        ("127.0.0.1", "[::1]:8765", True),
        ("127.0.0.1", "10.0.0.5:8765", False),
        ("127.0.0.1", "localhost.evil.example", False),
        ("127.0.0.1", "127.0.0.1.nip.io", False),
        ("127.0.0.1", "evil@127.0.0.1", False),
        ("127.0.0.1", "127.0.0.1:8765 ", False),
        ("127.0.0.1", "", False),
        ("0.0.0.0", "10.0.0.5:8765", True),
        ("0.0.0.0", socket.gethostname(), True),
        ("0.0.0.0", "evil.example", False),
        ("0.0.0.0", "proxy.example", True),
    ],
)
def test_only_names_that_cannot_be_an_attackers_are_answered(
    host: str, name: str, allowed: bool
) -> None:
    assert HostRule(host, ["proxy.example"] if "." in name else []).allows(name) is allowed


def test_a_port_that_is_taken_is_passed_over_and_a_foreign_address_is_named() -> None:
    with listen("127.0.0.1", 0) as first:
        port = first.getsockname()[1]
        with listen("127.0.0.1", port) as second:
            assert port < second.getsockname()[1] <= port + 20
            assert address_of(second) == f"http://127.0.0.1:{second.getsockname()[1]}/"
    with pytest.raises(AddressError, match=r"203\.0\.113\.1"):
        listen("203.0.113.1", 0)
    with pytest.raises(AddressError, match="nowhere.invalid"):
        listen("nowhere.invalid", 0)


async def tiny_app(scope: Any, receive: Any, send: Any) -> None:
    await send(
        {"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]}
    )
    await send({"type": "http.response.body", "body": b"ok"})


@pytest.fixture
def port() -> Iterator[int]:
    listener = listen("127.0.0.1", 0)
    server = ServerThread(tiny_app, listener)
    yield listener.getsockname()[1]
    server.close()


def is_answered(port: int) -> bool:
    return httpx.get(f"http://127.0.0.1:{port}/", timeout=10).text == "ok"


def test_idle_connections_shut_nobody_out_and_are_closed(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "HEAD_PATIENCE_S", 1.0)
    with ExitStack() as stack:
        idle = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(300)
        ]
        idle[0].sendall(b"GET / HTTP/1.1\r\nHost: ")  # half a head
        assert is_answered(port)
        for wire in (idle[0], idle[-1]):
            wire.settimeout(10)
            assert wire.recv(100) == b"", "closed, for no request came"


def test_one_address_elsewhere_cannot_take_all_connections(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "is_here", lambda address: False)
    monkeypatch.setattr(connections, "ADDRESS_CONNECTIONS", 5)
    with ExitStack() as stack:
        for _ in range(5):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        with pytest.raises(httpx.HTTPError):
            is_answered(port)
    end = time.monotonic() + 10
    while True:  # what is closed counts no more
        with contextlib.suppress(httpx.HTTPError):
            assert is_answered(port)
            break
        assert time.monotonic() < end


def test_small_answers_are_sent_at_once() -> None:
    async def delays() -> int:
        made: asyncio.Queue[int] = asyncio.Queue()

        def note(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            wire = writer.get_extra_info("socket")
            made.put_nowait(wire.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        with listen("127.0.0.1", 0) as listener:
            async with await asyncio.start_server(note, sock=listener):
                await asyncio.open_connection(*listener.getsockname()[:2])
                return await made.get()

    assert asyncio.run(delays()) != 0


def test_the_token_is_made_once_and_for_its_owner_alone(tmp_path: Path) -> None:
    token = token_of(tmp_path)
    assert len(token) >= 43 and token_of(tmp_path) == token
    assert (tmp_path / "web_token").stat().st_mode & 0o077 == 0
    (tmp_path / "web_token").write_text("")
    assert len(token_of(tmp_path)) >= 43 and token_of(tmp_path) != token


def metrics(steps: int) -> LearnerMetrics:
    nan = math.nan
    return LearnerMetrics(steps, 1, 2, 0, 0, 30.0, -1.0, nan, nan, nan, nan, nan)


def test_the_board_keeps_the_newest_and_knows_no_nan(tmp_path: Path) -> None:
    board = LiveBoard(tmp_path, "franka_group", ["learner", "web"])
    for steps in range(0, 5000, 5):
        board.add_metrics(metrics(steps))
    for number in range(100):
        reward = RewardView(episode_id=f"e{number}", purpose="train", valid=True, reason="",
                            total=float(number), version="v")  # fmt: skip
        board.add_reward(reward)
    board.add_reward(reward.model_copy(update={"total": 7.0}))
    board.add_reward(reward.model_copy(update={"episode_id": "d", "purpose": "demonstrate"}))
    board.add_progress(StageProgress("rank", 2, 6, "running", 3, 9, "rankings", 0.1, math.nan))
    (tmp_path / "encoders" / "rapl-0123").mkdir(parents=True)
    (tmp_path / "encoders" / "rapl-0123" / "card.json").write_text("{}")
    (tmp_path / "policies").mkdir()
    (tmp_path / "policies" / "curve.json").write_text(
        '{"points": [{"steps": 10, "success_rate": NaN, "reward_mean": -2.0}]}'
    )
    view = board.view()
    assert len(view.metrics) <= 400 and view.metrics[-1].steps == 4995
    assert [point.steps for point in view.metrics] == sorted(p.steps for p in view.metrics)
    assert view.metrics[-1].success_rate is None and view.stages[0].remaining_s is None
    assert [view.rewards[0].total, view.rewards[-1].total] == [40.0, 7.0]
    assert view.evaluations[0].success_rate is None and view.evaluations[0].reward_mean == -2.0
    assert view.encoders == ["rapl-0123", "imagenet"]
    assert "NaN" not in view.model_dump_json()
    board.add_metrics(metrics(5))
    assert [point.steps for point in board.view().metrics] == [5], "another training"


def test_the_board_says_in_which_stage_the_run_is_and_when_it_is_over(tmp_path: Path) -> None:
    board = LiveBoard(tmp_path, "franka_group", [])
    said = [board.stage]
    for stage, index, status in (
        ("rank", 2, "done"), ("train", 4, "running"), ("rank", 2, "running"), ("train", 4, "done"),
        ("report", 6, "running"), ("report", 6, "failed"), ("report", 6, "done"),
    ):  # fmt: skip
        board.add_progress(StageProgress(stage, index, 6, status, 3, 9, "", 0.1, math.nan))
        said.append(board.stage)
    assert said == ["", "rank", "train", "train", "train", "report", "report", "over"]


def test_a_conductor_that_has_done_its_work_is_not_missed(tmp_path: Path) -> None:
    board = LiveBoard(tmp_path, "franka_group", ["learner", "conductor"], "conductor")
    for state in board.nodes.values():
        state.seen = True
    seen = []
    for status in ("running", "done"):
        board.add_progress(StageProgress("report", 6, 6, status, 1, 1, "", 0.1, math.nan))
        seen.append([(node.health, node.status) for node in board.view().nodes])
    gone, done = ("gone", "gone"), ("absent", "done")
    assert seen == [[gone, gone], [gone, done]]


def test_the_page_is_told_again_when_it_has_moved(tmp_path: Path) -> None:
    said = io.StringIO()
    request: Any = SimpleNamespace(web_host="0.0.0.0", folder=tmp_path)
    file = tmp_path / WEB_ADDRESS_FILE
    told = tell_page(request, "", Console(said))
    for addresses in ("http://a:1/\nhttp://10.0.0.5:1/\n", "", "http://a:2/\n", "http://a:2/\n"):
        file.write_text(addresses)
        told = tell_page(request, told, Console(said))
    assert said.getvalue().split("\n")[:2] == [
        "The page is at http://a:1/ or http://10.0.0.5:1/",
        "The page is at http://a:2/",
    ]
    assert said.getvalue().count("The page") == 2


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_what_must_be_read_and_seen_stands_out(scheme: str) -> None:
    """WCAG 2.2, 1.4.3 and 1.4.11: text 4.5:1, what tells a control or its state 3:1."""
    css = (ROOT / "rapl_ros/rapl_ros/web/static/css/base.css").read_text()
    start = css.index(":root {" if scheme == "light" else ':root[data-theme="dark"] {')
    colours = dict(re.findall(r"--([\w-]+): (#\w{6});", css[start : css.index("}", start)]))
    for ink, paper, least in (
        ("ink-soft", "bg", 4.5), ("ink-soft", "surface", 4.5), ("ink-soft", "sunk", 4.5),
        ("on-accent", "accent", 4.5), ("on-accent-mid", "accent-mid", 4.5),
        ("surface", "ink-faint", 4.5), ("error", "surface", 4.5), ("error", "bg", 4.5),
        ("accent", "bg", 3), ("ring-mid", "bg", 3), ("ink-faint", "bg", 3),
        ("edge", "surface", 3),
    ):  # fmt: skip
        one, other = sorted((luminance(colours[ink]), luminance(colours[paper])))
        assert (other + 0.05) / (one + 0.05) >= least, f"{ink} on {paper}"


def luminance(colour: str) -> float:
    """Relative luminance of #rrggbb."""
    values = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def test_the_page_loads_no_torch() -> None:
    program = "import sys, rapl_ros.web_node; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0


def test_an_installed_package_has_the_front_end(tmp_path: Path) -> None:
    source = ROOT / "rapl_ros"
    copied = tmp_path / "rapl_ros"
    subprocess.run(["cp", "-r", str(source), str(copied)], check=True)
    build = [sys.executable, "setup.py", "-q", "bdist_wheel", "--dist-dir", str(tmp_path / "dist")]
    done = subprocess.run(build, cwd=copied, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    static = source / "rapl_ros" / "web" / "static"
    wanted = {
        f"rapl_ros/web/static/{p.relative_to(static)}" for p in static.rglob("*") if p.is_file()
    }
    assert len(wanted) > 12
    assert wanted <= set(zipfile.ZipFile(wheel).namelist())
