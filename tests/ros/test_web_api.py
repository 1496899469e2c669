"""The HTTP interface of the page, on the real nodes: what a person does with it."""

import shutil
import time
import uuid
from pathlib import Path
from typing import Any

import httpx
import pytest
from ros_harness import NodeProcess
from web_system import WebSystem, answer_to, ask, make_videos, refused, web_system

from rapl_core.types import Ranking

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


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


def test_a_video_that_cannot_be_read_is_passed_over_and_stops_nobody(tmp_path: Path) -> None:
    names = make_videos(tmp_path, 12, frames=3, size=16)
    with web_system(tmp_path, question="Which?") as system, system.client() as client:
        assert client.get("api/progress").json()["question"] == "Which?"
        shown = ask(client, "ada")
        with system.store() as store:
            seen = store.query(shown["query_id"]).episode_ids
        gone = seen[0]
        damaged = next(name for name in names if name not in seen)  # no sheet is made of it yet
        shutil.rmtree(tmp_path / "episodes" / gone)
        (bag,) = (tmp_path / "episodes" / damaged).glob("*.mcap")
        bag.write_bytes(b"damaged")
        other = ask(client, "ada")
        assert other["query_id"] != shown["query_id"], "a reload gets other videos"
        for number in range(50):
            query = ask(client, f"eve{number}")
            with system.store() as store:
                order = store.query(query["query_id"]).episode_ids
            assert gone not in order
            if damaged in order:
                break
        refused(client.get(query["videos"][order.index(damaged)]["url"]), 503, "video_missing")
        end = time.monotonic() + 20.0
        while damaged not in system.preference.text() or gone not in system.preference.text():
            assert time.monotonic() < end, system.preference.text()
            time.sleep(0.1)
        for number in range(20):
            query = ask(client, f"ada{number}")
            assert all(client.get(video["url"]).is_success for video in query["videos"])


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


def test_a_restarted_page_says_that_there_are_enough_with_the_answer_that_makes_it_so(
    tmp_path: Path,
) -> None:
    make_videos(tmp_path, 5, frames=3, size=16)
    with web_system(tmp_path, preference_rankings_wanted=2) as system:
        with system.client() as client:
            first = client.post("api/rankings", json=answer_to(ask(client, "ada"), "ada"))
            assert first.json()["standing"] == {"given": 1, "wanted": 2, "needed": 1}
        system.web.stop()
        system.web.restart()
        with WebSystem(tmp_path, system.preference, system.web).client() as client:
            last = client.post("api/rankings", json=answer_to(ask(client, "ada"), "ada"))
            assert last.json()["standing"] == {"given": 2, "wanted": 2, "needed": 0}
