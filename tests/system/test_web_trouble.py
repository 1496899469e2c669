"""The page when things go wrong: answers lost, pictures broken, keys pressed too soon."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from web_browser import VIDEOS
from web_system import WebSystem, make_videos, web_system

from rapl_core.types import Ranking

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]

WANTED = 60
WIDE = {"width": 1280, "height": 800}
PHONE = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebSystem]:
    folder = tmp_path_factory.mktemp("run")
    make_videos(folder, VIDEOS, frames=11, size=64)
    make_videos(folder, 8, frames=11, size=64, purpose="train")
    with web_system(folder, preference_rankings_wanted=WANTED) as running:
        yield running


@pytest.fixture
def visit(browser: Any, system: WebSystem) -> Iterator[Callable[..., Any]]:
    """Opens the page as somebody who was here before; without a name as a stranger."""
    contexts = []

    def opened(name: str = "", **options: Any) -> Any:
        contexts.append(browser.new_context(**({"viewport": WIDE} | options)))
        if name:
            known = json.dumps(json.dumps({"name": name, "helped": True}))
            contexts[-1].add_init_script(
                f"localStorage.getItem('rapl') || localStorage.setItem('rapl', {known})"
            )
        page = contexts[-1].new_page()
        page.set_default_timeout(60_000)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(system.address)
        if name:
            page.wait_for_selector("body[data-query]")
        return page

    faults: list[str] = []
    yield opened
    for context in contexts:
        context.close()
    assert not faults


def query(page: Any) -> str:
    return page.get_attribute("body", "data-query")


def until_next(page: Any, before: str) -> None:
    page.wait_for_function("(q) => document.body.dataset.query !== q", arg=before)


def rank(page: Any, keys: str = "12") -> None:
    before = query(page)
    for key in keys:
        page.keyboard.press(key)
    page.keyboard.press("Enter")
    until_next(page, before)


def lose_answer(page: Any, address: str) -> None:
    """The first request is served, and its answer lost."""
    lost = []

    def serve(route: Any) -> None:
        if lost:
            route.continue_()
        else:
            lost.append(route.fetch())
            route.abort()

    page.route(address, serve)


def test_an_undo_whose_answer_was_lost_takes_back_one_ranking_when_pressed_again(
    visit: Callable[..., Any], system: WebSystem
) -> None:
    page = visit("lost undo")
    for _ in range(3):
        rank(page)
    lose_answer(page, "**/api/undo")
    page.keyboard.press("u")
    page.wait_for_selector("#toast:not([hidden])")
    before = query(page)
    page.keyboard.press("u")
    until_next(page, before)
    assert page.inner_text("#toast") == "Your last answer is taken back."
    with system.store() as store:
        assert len(store.effective("lost undo")) == 2


def test_an_order_that_is_changed_after_its_answer_was_lost_corrects_it(
    visit: Callable[..., Any], system: WebSystem
) -> None:
    page = visit("lost answer")
    lose_answer(page, "**/api/rankings")
    for key in ("1", "2", "Enter"):
        page.keyboard.press(key)
    page.wait_for_selector("#toast:not([hidden])")
    for _ in range(2):  # the pick of 2, and what was left over, and then that of 1
        page.keyboard.press("Backspace")
    assert page.inner_text("#hint") == "Choose the videos from best to worst."
    rank(page, "21")
    with system.store() as store:
        assert [row.ranks for row in store.effective("lost answer")] == [(2, 1, 3)]
        assert [row.ranks for row in store.all("lost answer")] == [(1, 2, 3), (2, 1, 3)]


def test_broken_pictures_and_answers_cut_short_are_asked_for_again(
    visit: Callable[..., Any],
) -> None:
    page = visit("broken")
    page.wait_for_load_state("networkidle")  # one more is fetched ahead
    broken = {"status": 200, "content_type": "image/webp", "body": b"RIFFxxxx"}
    page.route("**/api/videos/*", lambda route: route.fulfill(**broken))
    rank(page)  # the one fetched ahead
    for key in ("1", "2", "Enter"):
        page.keyboard.press(key)
    page.wait_for_selector("main[data-state=empty]")
    assert "A video came broken" in page.inner_text("#empty-text")
    assert page.is_visible("#undo"), "the last answer can be taken back all the same"
    cut = {"status": 200, "content_type": "application/json", "body": '{"query_id": '}
    page.route("**/api/queries", lambda route: route.fulfill(**cut))
    page.unroute("**/api/videos/*")
    page.wait_for_function(
        "() => document.getElementById('empty-text').textContent.includes('cut short')"
    )
    page.unroute("**/api/queries")
    page.wait_for_selector("main[data-state=ready]")
    rank(page)


def test_a_strangers_first_visit_survives_escape_and_a_first_picture_that_fails(
    visit: Callable[..., Any],
) -> None:
    page = visit()
    assert page.inner_text("#empty-title") == "One moment"
    for _ in range(3):
        page.keyboard.press("Escape")
    page.wait_for_selector("#who[open]")
    failures = []

    def serve(route: Any) -> None:
        failures.append(route)
        if len(failures) <= 3:
            route.abort()
        else:
            route.continue_()

    page.route("**/api/videos/*", serve)
    page.fill("#name", "stranger")
    page.press("#name", "Enter")
    page.wait_for_selector("#help[open]")
    page.keyboard.press("Escape")
    page.wait_for_selector("body[data-query]")


def test_keys_during_saving_change_nothing_and_the_page_says_that_it_saves(
    visit: Callable[..., Any], system: WebSystem
) -> None:
    page = visit("hasty")
    held: list[Any] = []
    page.route("**/api/rankings", lambda route: held.append(route))
    before = query(page)
    for key in ("1", "2", "Enter", "3", "e", "Backspace", "s"):
        page.keyboard.press(key)
    page.click(".card:nth-child(3) .video")
    assert page.get_attribute("#main", "aria-busy") == "true"
    page.wait_for_function("() => document.getElementById('save').textContent.includes('Saving…')")
    assert page.inner_text("#hint") == "From the best: 1, then 2, then 3."
    (route,) = held
    route.continue_()
    until_next(page, before)
    assert page.inner_text("#hint") == "Choose the videos from best to worst."
    with system.store() as store:
        assert [row.ranks for row in store.all("hasty")] == [(1, 2, 3)]


def test_a_pause_holds_for_the_next_videos_and_who_wants_no_motion_begins_with_one(
    visit: Callable[..., Any],
) -> None:
    page = visit("still")
    page.keyboard.press("Space")
    rank(page)
    assert page.get_attribute("#play", "aria-label") == "Play"
    page.wait_for_timeout(300)
    assert page.input_value("#scrub") == "0"
    calm = visit("calm", reduced_motion="reduce")
    assert calm.get_attribute("#play", "aria-label") == "Play"
    assert calm.input_value("#scrub") == "0"


def test_a_second_tab_gets_other_videos_and_a_name_that_is_known_is_asked_about(
    visit: Callable[..., Any],
) -> None:
    page = visit("Tabea")
    rank(page)
    stranger = visit()
    stranger.fill("#name", "tabea")
    stranger.press("#name", "Enter")
    stranger.wait_for_selector("#known-text:visible")
    assert stranger.inner_text("#known-text") == "Tabea has ranked already. Is that you?"
    stranger.click("#known-yes")
    stranger.wait_for_selector("#help[open]")
    stranger.keyboard.press("Escape")
    stranger.wait_for_selector("body[data-query]")
    assert query(stranger) != query(page)
    assert stranger.inner_text("#person") == "Tabea"
    stranger.keyboard.press("u")
    stranger.wait_for_selector("#toast:not([hidden])")
    assert stranger.inner_text("#toast") == "There is nothing to take back."


def test_a_finger_scrolls_down_at_once_and_drags_after_a_long_press(
    visit: Callable[..., Any],
) -> None:
    page = visit("finger", **PHONE)
    touch = page.context.new_cdp_session(page)

    def drag(wait_ms: int) -> int:
        box = page.locator(".card:nth-child(1) .video").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        send(touch, "touchStart", x, y)
        page.wait_for_timeout(wait_ms)
        for step in range(1, 16):
            send(touch, "touchMove", x + step * 4, y + (790 - y) * step / 15)
            page.wait_for_timeout(20)
        send(touch, "touchEnd")
        page.wait_for_timeout(150)
        return page.locator(".places input:checked").count()

    assert drag(wait_ms=0) == 0
    assert drag(wait_ms=600) == 1


def send(touch: Any, kind: str, *point: float) -> None:
    points = [{"x": point[0], "y": point[1]}] if point else []
    touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def test_a_telephone_on_its_side_shows_everything_without_scrolling(
    visit: Callable[..., Any],
) -> None:
    page = visit("side", **PHONE | {"viewport": {"width": 740, "height": 360}})
    assert page.evaluate("document.documentElement.scrollHeight") <= 360
    for selector in ("#save", "#undo", ".card:last-child .places", "#scrub"):
        box = page.locator(selector).bounding_box()
        assert box["y"] >= 0 and box["y"] + box["height"] <= 360, selector
    assert page.locator(".card:first-child canvas").bounding_box()["height"] >= 90


def test_when_there_are_enough_the_page_says_so_and_fetches_no_more_ahead(
    visit: Callable[..., Any], system: WebSystem
) -> None:
    page = visit("enough")
    give_enough(system)
    rank(page)
    assert page.inner_text("#standing-more") == "· Enough for now, thank you."
    rank(page)  # what was fetched ahead before
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    rank(page)  # asked for when it is wanted
    page.wait_for_timeout(500)
    assert sum("api/queries" in url for url in asked) == 1


def test_when_more_is_wanted_videos_of_before_make_way_for_those_of_the_robot(
    visit: Callable[..., Any], system: WebSystem
) -> None:
    give_enough(system)
    idle, busy, late = (visit(name) for name in ("idle", "busy", "late"))
    for page in (idle, busy):
        page.wait_for_function(ENOUGH)
    busy.keyboard.press("1")  # begins an order that nobody may take away
    late.wait_for_load_state("networkidle")
    before = {page: query(page) for page in (idle, busy, late)}
    with system.store() as store:
        wanted = sum(row.verdict == "ranked" for row in store.effective()) + 20
    system.set_preference("strategy", "own")  # in this order, as the run does
    system.set_preference("rankings_wanted", wanted)
    until_next(idle, before[idle])
    assert shows_own_videos(idle, system)
    busy.wait_for_function("() => document.getElementById('standing-more').textContent[2] === '2'")
    assert query(busy) == before[busy] and busy.locator(".places input:checked").count() == 1
    rank(busy, "2")
    assert shows_own_videos(busy, system)
    idle.reload()
    idle.wait_for_selector("body[data-query]")
    assert shows_own_videos(idle, system), "nor does what was begun before come back"


ENOUGH = "() => document.getElementById('standing-more').textContent.includes('Enough')"


def give_enough(system: WebSystem) -> None:
    """As many rankings as are wanted, by others."""
    with system.store() as store:
        for number in range(WANTED):
            videos = (f"secret-{number % 20:03d}", "secret-030", "secret-031")
            store.add(Ranking(f"crowd-{number}", "crowd", videos, (1, 2, 3)))


def shows_own_videos(page: Any, system: WebSystem) -> bool:
    """Whether the robot's own videos are on the screen."""
    with system.store() as store:
        videos = store.query(query(page)).episode_ids
    return sum(video.startswith("train-") for video in videos) == 2
