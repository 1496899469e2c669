"""The HTTP interface of the page, on the real nodes: what an attacker sends, or a broken client."""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable
from hypothesis.strategies import SearchStrategy
from schemathesis import GenerationMode
from schemathesis.specs.openapi.checks import positive_data_acceptance
from web_system import WebSystem, answer_to, ask, make_videos, refused, web_system

from rapl_ros.web.guard import BODY_LIMIT

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

TOKEN_REFUSED = 401


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
    operations = [
        operation.ok()
        for operation in schemathesis.openapi.from_dict(document).get_all_operations()
    ]
    assert len(operations) == sum(len(methods) for methods in document["paths"].values())
    assert {operation.path for operation in operations} == set(document["paths"])
    for operation in operations:
        # What is right sets other nodes to work: once each, in test_web_api.
        sets_to_work = operation.path in ("/api/align", "/api/encoder")
        right = () if sets_to_work else (GenerationMode.POSITIVE,)
        for mode in (*right, GenerationMode.NEGATIVE):
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
