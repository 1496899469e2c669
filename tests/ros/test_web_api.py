"""The HTTP interface of the page, on the real nodes: what a person does, and what an attacker."""

import contextlib
import json
import shutil
import socket
import time
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable
from hypothesis.strategies import SearchStrategy
from ros_harness import NodeProcess
from schemathesis import GenerationMode
from schemathesis.specs.openapi.checks import positive_data_acceptance
from web_system import WebSystem, make_videos, web_system

from rapl_core.types import Ranking
from rapl_ros.web.guard import BODY_LIMIT

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

TOKEN_REFUSED = 401


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebSystem]:
    folder = tmp_path_factory.mktemp("run")
    make_videos(folder, 30, frames=5, size=32)
    with web_system(folder, preference_rankings_wanted=10) as running:
        yield running


@pytest.fixture
def client(system: WebSystem) -> Iterator[httpx.Client]:
    with system.client() as made:
        yield made


def ask(client: httpx.Client, annotator: str, **more: Any) -> dict[str, Any]:
    answer = client.post("api/queries", json={"annotator": annotator, **more})
    assert answer.status_code == 200, answer.text
    return answer.json()


def answer_to(query: dict[str, Any], annotator: str, **more: Any) -> dict[str, Any]:
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


# What a person does


def test_an_answer_is_stored_as_shown_and_nothing_tells_which_video_is_which(
    client: httpx.Client, system: WebSystem
) -> None:
    asked = client.post("api/queries", json={"annotator": "Zoë O’Neil"})
    assert "secret" not in asked.text
    query = asked.json()
    for video in query["videos"]:
        sheet = client.get(video["url"])
        assert sheet.headers["content-type"] == "image/webp"
        assert "immutable" in sheet.headers["cache-control"]
    stored = client.post("api/rankings", json=answer_to(query, "Zoë O’Neil"))
    assert stored.status_code == 200 and stored.json()["standing"]["wanted"] == 10
    with system.store() as store:
        (ranking,) = store.all("Zoë O’Neil")
    assert ranking.ranks == (2, 1, 3) and ranking.source == "web"
    assert ranking.created_ns - ranking.shown_ns == 1_500_000_000
    people = client.get("api/progress").json()["annotators"]
    assert [one["ranked"] for one in people if one["annotator"] == "Zoë O’Neil"] == [1]


def test_a_reload_gives_back_what_was_begun_and_a_page_that_fetches_ahead_gets_another(
    client: httpx.Client,
) -> None:
    first = ask(client, "reload")
    ahead = ask(client, "reload", held=[first["query_id"]])
    assert ahead["query_id"] != first["query_id"]
    assert ask(client, "reload") == first | {"expires_in_s": pytest.approx(600, abs=60)}


def test_two_pages_of_one_name_get_different_queries_and_undo_their_own_answers(
    client: httpx.Client, system: WebSystem
) -> None:
    one, other = ask(client, "twin", page="one"), ask(client, "twin", page="other")
    assert one["query_id"] != other["query_id"]
    assert ask(client, "twin", page="one")["query_id"] == one["query_id"], "after a reload"
    first, second = answer_to(one, "twin"), answer_to(other, "twin")
    for body in (first, second):
        assert client.post("api/rankings", json=body).is_success
    ask(client, "twin", page="other")
    undo = {"annotator": "twin", "page": "one", "withdrawal_id": uuid.uuid4().hex}
    undone = client.post("api/undo", json=undo | {"ranking_id": first["ranking_id"]})
    assert undone.json()["query"]["query_id"] == one["query_id"]
    fresh = undo | {"page": "third", "withdrawal_id": uuid.uuid4().hex}
    refused(client.post("api/undo", json=fresh), 409, "nothing_to_undo")
    with system.store() as store:
        assert [row.ranking_id for row in store.effective("twin")] == [second["ranking_id"]]


def test_an_undo_touches_nothing_that_was_not_asked_here(
    client: httpx.Client, system: WebSystem
) -> None:
    videos = ("secret-000", "secret-001", "secret-002")
    with system.store() as store:
        for number in range(2):
            made = Ranking(
                uuid.uuid4().hex, "bystander", videos, (1, 2, 3), query_id=f"far{number}"
            )
            store.add_imported(made)
        for _ in range(2):
            body = {"annotator": "bystander", "withdrawal_id": uuid.uuid4().hex}
            refused(client.post("api/undo", json=body), 409, "nothing_to_undo")
        assert len(store.effective("bystander")) == 2


def test_a_correction_names_the_answer_that_it_replaces(
    client: httpx.Client, system: WebSystem
) -> None:
    query = ask(client, "second thoughts")
    first = answer_to(query, "second thoughts")
    assert client.post("api/rankings", json=first).is_success
    better = answer_to(query, "second thoughts", ranks=[1, 2, 3], replaces=first["ranking_id"])
    assert client.post("api/rankings", json=better).is_success
    with system.store() as store:
        assert [row.ranks for row in store.effective("second thoughts")] == [(1, 2, 3)]
        assert store.count("second thoughts") == 2


def test_one_annotators_progress_is_only_the_own_row_however_it_is_capitalised(
    client: httpx.Client,
) -> None:
    assert client.post("api/rankings", json=answer_to(ask(client, "Käthe"), "Käthe")).is_success
    own = client.get("api/progress", params={"annotator": "kÄTHE"}).json()
    assert [row["annotator"] for row in own["annotators"]] == ["Käthe"]
    assert own["question"] == "Which do you like best?"
    refused(client.get("api/progress", params={"annotator": "<b>"}), 422, "bad_request")


def test_an_answer_sent_again_is_stored_once(client: httpx.Client, system: WebSystem) -> None:
    body = answer_to(ask(client, "again"), "again")
    for response_s in (1.5, 9.0):  # the page may have waited before it tried again
        assert client.post("api/rankings", json=body | {"response_s": response_s}).is_success
    with system.store() as store:
        assert store.count("again") == 1


def test_undo_shows_the_videos_again_in_the_same_order_and_keeps_both_rows(
    client: httpx.Client, system: WebSystem
) -> None:
    query = ask(client, "undo")
    assert client.post("api/rankings", json=answer_to(query, "undo")).is_success
    body = {"annotator": "undo", "withdrawal_id": uuid.uuid4().hex}
    undone = client.post("api/undo", json=body).json()
    assert undone["ranks"] == [2, 1, 3] and undone["verdict"] == "ranked"
    assert undone["query"]["videos"] == query["videos"]
    assert client.post(
        "api/rankings", json=answer_to(undone["query"], "undo", ranks=[1, 1, 3])
    ).is_success
    with system.store() as store:
        assert [row.verdict for row in store.all("undo")] == ["ranked", "withdrawn", "ranked"]
        assert [row.ranks for row in store.effective("undo")] == [(1, 1, 3)]
    other = {"annotator": "nobody yet", "withdrawal_id": uuid.uuid4().hex}
    refused(client.post("api/undo", json=other), 409, "nothing_to_undo")


def test_the_live_page_says_how_the_nodes_are(client: httpx.Client) -> None:
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        nodes = {node["name"]: node for node in client.get("api/live").json()["nodes"]}
        if nodes["preference"]["health"] == "ok":
            break
        time.sleep(0.2)
    assert nodes["preference"]["status"] == "active"
    assert nodes["simulator"]["health"] == "absent"
    refused(client.get("api/camera.jpg"), 404, "no_picture")


def test_an_encoder_cannot_be_swapped_where_no_node_embeds(
    client: httpx.Client,
) -> None:
    refused(client.post("api/encoder", json={"encoder": "imagenet"}), 503, "no_encoder")
    assert client.get("api/live").json()["swap"]["state"] == "idle"


def test_an_alignment_is_one_at_a_time_and_its_end_is_told_even_when_its_node_dies(
    tmp_path: Path,
) -> None:
    make_videos(tmp_path, 4, frames=3, size=16)
    with web_system(tmp_path) as system, system.client() as client:
        assert client.post("api/align", json={}).status_code == 202
        refused(client.post("api/align", json={}), 409, "busy")
        system.preference.kill()
        assert outcome(client, "align") == {
            "state": "failed", "share": None, "message": "preference is gone."
        }  # fmt: skip
        system.preference.restart()
        system.until_ready()
        assert client.post("api/align", json={}).status_code == 202
        job = outcome(client, "align")
        assert job["state"] == "failed" and "ranking" in job["message"], "none were given"


@pytest.mark.slow
def test_swap_puts_an_encoder_to_work_or_says_why_not(
    client: httpx.Client, system: WebSystem
) -> None:
    encoder = NodeProcess(
        "rapl_ros.encoder_node", system.folder / "encoder.log", run_folder=system.folder
    )
    try:
        end = time.monotonic() + 60.0
        while (answer := client.post("api/encoder", json={"encoder": "oven"})).is_error:
            assert refused(answer, 503, "no_encoder") and time.monotonic() < end
            time.sleep(0.3)
        refusal = outcome(client, "swap")
        assert refusal["state"] == "failed" and "imagenet" in refusal["message"]
        assert client.post("api/encoder", json={"encoder": "imagenet"}).status_code == 202
        assert outcome(client, "swap") == {
            "state": "done", "share": None, "message": "imagenet is at work."
        }  # fmt: skip
        assert client.get("api/live").json()["encoder"]["name"] == "imagenet"
    finally:
        encoder.stop()


def outcome(client: httpx.Client, job: str) -> dict[str, Any]:
    """What became of what a button has begun."""
    end = time.monotonic() + 150.0
    while (view := client.get("api/live").json()[job])["state"] == "running":
        assert time.monotonic() < end, view
        time.sleep(0.3)
    return view


# What an attacker does


@pytest.mark.parametrize(
    "name",
    ["<script>alert(1)</script>", '" onload="x', "a\nb", "‮evil", "../../etc", "", " ", "x" * 65,
     "a&b", "rm -rf;", "\x00", "a\u200bb"],
)  # fmt: skip
def test_names_that_are_no_names_are_refused(client: httpx.Client, name: str) -> None:
    message = refused(client.post("api/queries", json={"annotator": name}), 422, "bad_request")
    assert "annotator" in message


def test_replayed_and_stolen_leases_are_refused_and_not_stored(
    client: httpx.Client, system: WebSystem
) -> None:
    query = ask(client, "lease")
    assert client.post("api/rankings", json=answer_to(query, "lease")).is_success
    replay = client.post("api/rankings", json=answer_to(query, "lease", ranks=[1, 2, 3]))
    assert "answered" in refused(replay, 409, "refused")
    stolen = client.post("api/rankings", json=answer_to(ask(client, "lease"), "thief"))
    refused(stolen, 409, "unknown_query")
    unknown = client.post("api/rankings", json=answer_to({"query_id": "0" * 32}, "lease"))
    refused(unknown, 409, "unknown_query")
    with system.store() as store:
        assert [row.ranks for row in store.all("lease")] == [(2, 1, 3)]
        assert store.count("thief") == 0


def test_an_id_may_not_be_used_for_another_answer(client: httpx.Client) -> None:
    body = answer_to(ask(client, "reuse"), "reuse")
    assert client.post("api/rankings", json=body).is_success
    refused(client.post("api/rankings", json=body | {"ranks": [1, 2, 3]}), 409, "used_id")


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"ranks": [1, 2]}, "bad_ranks"),
        ({"ranks": []}, "bad_ranks"),
        ({"ranks": [3, 3, 3]}, "bad_ranking"),
        ({"ranks": [1, 2, 9]}, "bad_ranking"),
        ({"ranks": [1, 2, 1e9]}, "bad_request"),
        ({"ranks": ["1", "2", "3"]}, "bad_request"),
        ({"verdict": "skipped"}, "bad_ranks"),
        ({"verdict": "withdrawn", "ranks": []}, "bad_request"),
        ({"response_s": -1}, "bad_request"),
        ({"ranking_id": "a" * 99}, "bad_request"),
        ({"ranking_id": "../../../x"}, "bad_request"),
        ({"created_ns": 5}, "bad_request"),
    ],
)
def test_answers_that_cannot_be_right_are_refused(
    client: httpx.Client, change: dict[str, Any], code: str
) -> None:
    body = answer_to(ask(client, "wrong"), "wrong") | change
    refused(client.post("api/rankings", json=body), 422, code)


@pytest.mark.parametrize(
    "path",
    ["api/videos/secret-000.webp", "api/videos/..%2f..%2fconfig.yaml.webp", "api/videos/.webp",
     "api/videos/%2e%2e/%2e%2e/rankings.sqlite", "static/..%2f..%2fweb_node.py",
     "static/%2e%2e/app.py", "static/....//app.py", "static//etc/passwd",
     "api/videos/" + "0" * 32 + ".webp"],
)  # fmt: skip
def test_paths_lead_to_nothing_but_what_is_served(system: WebSystem, path: str) -> None:
    # By hand: clients tidy such paths up before they send them.
    host, _, port = system.address.removeprefix("http://").rstrip("/").partition(":")
    with socket.create_connection((host, int(port)), timeout=10) as wire:
        wire.sendall(f"GET /{path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        text = b"".join(iter(lambda: wire.recv(65536), b"")).decode(errors="replace")
    status = int(text.split()[1])
    assert status in (404, 405, 422), text[:200]
    assert "import " not in text and "root:" not in text and "SQLite" not in text


@pytest.mark.parametrize(
    ("headers", "status", "code"),
    [
        ({"Origin": "https://evil.example"}, 403, "wrong_origin"),
        ({"Origin": "null"}, 403, "wrong_origin"),
        ({"Origin": "http://127.0.0.1:1"}, 403, "wrong_origin"),
        ({"Sec-Fetch-Site": "cross-site"}, 403, "wrong_origin"),
        ({"Sec-Fetch-Site": "same-site"}, 403, "wrong_origin"),
        ({"Host": "evil.example"}, 403, "wrong_host"),
        ({"Host": "evil.example:80", "Origin": "http://evil.example:80"}, 403, "wrong_host"),
        ({"Host": "192.168.1.7"}, 403, "wrong_host"),
        ({"Host": ""}, 403, "wrong_host"),
        ({"Content-Type": "text/plain"}, 415, "not_json"),
        ({"Content-Type": "application/x-www-form-urlencoded"}, 415, "not_json"),
    ],
)
def test_other_origins_and_rebound_names_cannot_post_and_it_is_logged(
    client: httpx.Client, system: WebSystem, headers: dict[str, str], status: int, code: str
) -> None:
    before = system.web.text().count(f"refused ({code})")
    body = json.dumps({"annotator": "victim"})
    kind = {"Content-Type": "application/json"}
    refused(client.post("api/queries", content=body, headers=kind | headers), status, code)
    end = time.monotonic() + 10.0
    while system.web.text().count(f"refused ({code})") == before:
        assert time.monotonic() < end, "the refusal is not in the log"
        time.sleep(0.05)
    with system.store() as store:
        assert not store.open_queries("victim")


def test_a_page_of_the_same_origin_may_post_and_a_link_may_lead_here(client: httpx.Client) -> None:
    host = httpx.URL(client.base_url).netloc.decode()
    headers = {"Origin": f"http://{host}", "Sec-Fetch-Site": "same-origin"}
    body = {"annotator": "friend"}
    assert client.post("api/queries", json=body, headers=headers).is_success
    assert client.get("", headers={"Sec-Fetch-Site": "cross-site"}).is_success
    assert client.options("api/queries", headers={"Origin": "https://evil.example"}).is_error


def test_oversized_bodies_are_refused_whether_they_tell_their_size_or_not(
    client: httpx.Client,
) -> None:
    headers = {"Content-Type": "application/json"}
    large = b'{"annotator": "' + b"x" * BODY_LIMIT + b'"}'

    def pieces() -> Iterator[bytes]:
        for start in range(0, len(large), 1000):
            yield large[start : start + 1000]

    refused(client.post("api/queries", content=large, headers=headers), 413, "too_large")
    with contextlib.suppress(httpx.WriteError):  # the server may hang up first
        refused(client.post("api/queries", content=pieces(), headers=headers), 413, "too_large")
    assert client.get("api/progress").is_success


@pytest.mark.parametrize(
    "text",
    ["{", "", "null", "[]", '{"annotator": 5}', '{"annotator": "a", "annotator2": "b"}', "\xff",
     '{"annotator": "\\ud800"}', "[" * 9000],
)  # fmt: skip
def test_broken_json_is_refused(client: httpx.Client, text: str) -> None:
    headers = {"Content-Type": "application/json"}
    answer = client.post("api/queries", content=text.encode("latin-1"), headers=headers)
    refused(answer, 422, "bad_request")


def test_pages_forbid_foreign_scripts_and_frames(client: httpx.Client) -> None:
    for path in ("", "live", "static/js/rank.js", "api/progress"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert "script-src 'self'" in policy and "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in headers
    for page in ("rank.html", "live.html"):
        text = client.get(f"static/{page}").text
        assert "<script>" not in text and "style=" not in text and " onclick" not in text


def test_a_video_that_cannot_be_read_is_passed_over_and_stops_nobody(tmp_path: Path) -> None:
    make_videos(tmp_path, 12, frames=3, size=16)
    with web_system(tmp_path, question="Which?") as system, system.client() as client:
        assert client.get("api/progress").json()["question"] == "Which?"
        shown = ask(client, "ada")
        with system.store() as store:
            gone, damaged, _ = store.query(shown["query_id"]).episode_ids
        shutil.rmtree(tmp_path / "episodes" / gone)
        other = ask(client, "ada")
        assert other["query_id"] != shown["query_id"], "a reload gets other videos"
        with system.store() as store:
            assert gone not in store.query(other["query_id"]).episode_ids
            (bag,) = (tmp_path / "episodes" / damaged).glob("*.mcap")
            bag.write_bytes(b"damaged")
        refused(client.get(shown["videos"][1]["url"]), 503, "video_missing")
        end = time.monotonic() + 20.0
        while damaged not in system.preference.text() or gone not in system.preference.text():
            assert time.monotonic() < end, system.preference.text()
            time.sleep(0.1)
        for number in range(20):
            query = ask(client, f"ada{number}")
            assert all(client.get(video["url"]).is_success for video in query["videos"])


def test_behind_a_proxy_every_request_needs_the_token(tmp_path: Path) -> None:
    make_videos(tmp_path, 4, frames=3, size=16)
    with web_system(tmp_path, allowed_hosts="['rank.example.org']") as system:
        proxied = {"Host": "rank.example.org", "Origin": "https://rank.example.org"}
        answer = httpx.post(f"{system.address}api/align", json={}, headers=proxied)
        refused(answer, TOKEN_REFUSED, "token_needed")
        assert system.token and ask(system.client(**proxied), "ada")["videos"]


def test_beyond_this_machine_every_request_needs_the_token(tmp_path: Path) -> None:
    make_videos(tmp_path, 4, frames=3, size=16)
    with web_system(tmp_path, host="0.0.0.0") as system:
        assert system.token in system.web.text(), "it is printed"
        assert (tmp_path / "web_token").stat().st_mode & 0o077 == 0
        port = httpx.URL(system.address).port
        with httpx.Client(base_url=f"http://127.0.0.1:{port}/") as stranger:
            assert stranger.get("").is_success, "the page itself tells nothing"
            body = {"annotator": "eve"}
            for header in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Bearer é"},
                           {"Authorization": f"Basic {system.token}"}):  # fmt: skip
                encoded = {k: v.encode() for k, v in header.items()}
                answer = stranger.post("api/queries", json=body, headers=encoded)
                refused(answer, TOKEN_REFUSED, "token_needed")
            for path in ("api/progress", "api/live", "api/camera.jpg", "api/openapi.json"):
                refused(stranger.get(path), TOKEN_REFUSED, "token_needed")
            right = {"Authorization": f"Bearer {system.token}"}
            assert stranger.post("api/queries", json=body, headers=right).is_success
            for path in ("api/progress", "api/progress?xannotator=a", "api/progress?annotator=",
                         "api/live", "api/camera.jpg"):  # fmt: skip
                refused(stranger.get(path, headers=right), 403, "operators_only")
            refused(stranger.post("api/align", json={}, headers=right), 403, "operators_only")
            assert stranger.get("api/progress?annotator=eve", headers=right).is_success
            operator = (tmp_path / "web_operator_token").read_text().strip()
            assert f"live#token={operator}" in system.web.text(), "it is printed"
            steering = {"Authorization": f"Bearer {operator}"}
            assert stranger.get("api/progress", headers=steering).is_success
            assert stranger.get("api/live", headers=steering).is_success
            assert stranger.post("api/queries", json=body, headers=steering).is_success
            rebound = right | {"Host": "evil.example"}
            refused(stranger.post("api/queries", json=body, headers=rebound), 403, "wrong_host")
        assert token_after_restart(system) == system.token


def token_after_restart(system: WebSystem) -> str:
    system.web.stop()
    assert not (system.folder / "web_address").exists()
    system.web.restart()
    return WebSystem(system.folder, system.preference, system.web).token


def test_whatever_the_schema_allows_or_not_is_answered_as_the_schema_says(
    system: WebSystem,
) -> None:
    with system.client() as client:
        document = client.get("api/openapi.json").json()
    # Not the two that set other nodes to work; they are called once, elsewhere.
    for path in ("/api/align", "/api/encoder"):
        document["paths"].pop(path)
    operations = [
        operation.ok()
        for operation in schemathesis.openapi.from_dict(document).get_all_operations()
    ]
    assert len(operations) == sum(len(methods) for methods in document["paths"].values())
    for operation in operations:
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            with contextlib.suppress(Unsatisfiable):  # nothing about a bare GET can be wrong
                fire(operation.as_strategy(generation_mode=mode), system.address)
    with system.client() as client:
        assert client.get("api/progress").is_success


def fire(cases: SearchStrategy[schemathesis.Case], address: str) -> None:
    """Send cases; each answer must be one that the schema documents, and never a fault."""

    @given(cases)
    @settings(
        max_examples=15,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    def check(case: schemathesis.Case) -> None:
        # What the schema allows may still be refused: an unknown query, a name that is none.
        case.call_and_validate(
            base_url=address.rstrip("/"),
            excluded_checks=[positive_data_acceptance],
            timeout=20,
        )

    check()
