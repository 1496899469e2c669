"""A person's whole job in a real browser: rank, tie, drag, undo, reload; nothing else is stored."""

import json
import shutil
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from web_system import WebSystem, colour_of, make_videos, web_system

sync_api = pytest.importorskip("playwright.sync_api")

VIDEOS = 40
QUERIES = 25
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebSystem]:
    folder = tmp_path_factory.mktemp("run")
    make_videos(folder, VIDEOS)
    with web_system(folder, preference_rankings_wanted=30, preference_lease_s=600.0) as running:
        yield running


@pytest.fixture
def page(browser: Any, system: WebSystem) -> Iterator[Any]:
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    opened = context.new_page()
    faults: list[str] = []
    opened.on("pageerror", lambda error: faults.append(str(error)))
    opened.on(
        "console",
        lambda message: faults.append(message.text) if "Content Security" in message.text else None,
    )
    opened.goto(system.address)
    yield opened
    context.close()
    assert not faults


class Person:
    """Ranks as a person does, and keeps what the store must hold."""

    def __init__(self, page: Any, name: str) -> None:
        self.page, self.name = page, name
        self.rows: list[tuple[str, tuple[str, ...], tuple[int, ...]]] = []
        """Verdict, videos as shown, ranks: in the order given, undone ones included."""

    def introduce(self) -> None:
        self.page.fill("#name", self.name)
        self.page.press("#name", "Enter")
        self.page.wait_for_selector("#help[open]")
        self.page.press("body", "Escape")
        self.page.wait_for_selector("body[data-query]")

    def shown(self) -> tuple[str, ...]:
        """Which videos are on the screen, told by the pixels of their corners."""
        pixels = self.page.evaluate(
            "[...document.querySelectorAll('.card canvas')].map((canvas) => "
            "[...canvas.getContext('2d').getImageData(3, 3, 1, 1).data.slice(0, 3)])"
        )
        known = {colour_of(number): f"secret-{number:03d}" for number in range(VIDEOS)}
        return tuple(known[tuple(pixel)] for pixel in pixels)

    def query(self) -> str:
        return self.page.get_attribute("body", "data-query")

    def saves(self, verdict: str, ranks: tuple[int, ...], press: str) -> None:
        """Press ``press``, expect the next query, note the row."""
        before, shown = self.query(), self.shown()
        if press.startswith("#"):
            self.page.click(press)
        else:
            self.page.keyboard.press(press)
        self.page.wait_for_function("(q) => document.body.dataset.query !== q", arg=before)
        self.rows.append((verdict, shown, ranks))

    def by_keys(self, order: list[int], press: str = "Enter") -> None:
        for video in order[:-1]:  # the last one is left over
            self.page.keyboard.press(str(video + 1))
        self.saves("ranked", ranks_of(order), press)

    def by_clicks(self, order: list[int]) -> None:
        for video in order:
            self.page.click(f".card:nth-child({video + 1}) .video")
        self.saves("ranked", ranks_of(order), "#save")

    def by_places(self, ranks: tuple[int, ...]) -> None:
        for video, rank in enumerate(ranks):
            self.page.check(f"input[name=place-{video}][value='{rank}']", force=True)
        self.saves("ranked", ranks, "#save")

    def by_drags(self, ranks: tuple[int, ...]) -> None:
        mouse = self.page.mouse
        for video, rank in enumerate(ranks):
            box = self.page.locator(f".card:nth-child({video + 1}) .video").bounding_box()
            mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
            mouse.down()
            mouse.move(box["x"] + box["width"] / 2 + 30, box["y"] + box["height"] / 2 + 30)
            place = self.page.locator(f".tray > div:nth-child({rank})").bounding_box()
            mouse.move(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2, steps=3)
            mouse.up()
        self.saves("ranked", ranks, "#save")


def ranks_of(order: list[int]) -> tuple[int, ...]:
    """Ranks by position of an order from best to worst."""
    return tuple(order.index(video) + 1 for video in range(len(order)))


def report(page: Any, figures: dict[str, list[float]]) -> None:
    """Take the page's own measures, which a reload forgets."""
    for name, duration in page.evaluate(
        "performance.getEntriesByType('measure').map(({name, duration}) => [name, duration])"
    ):
        figures.setdefault(name, []).append(duration)


def test_a_person_ranks_25_queries_and_the_store_holds_exactly_those(
    page: Any, system: WebSystem, capsys: pytest.CaptureFixture[str]
) -> None:
    person = Person(page, "Anna")
    person.introduce()
    figures: dict[str, list[float]] = {}
    orders = [[0, 1, 2], [2, 0, 1], [1, 2, 0], [2, 1, 0]]
    undone = -1
    while len(person.rows) < QUERIES + 2:  # one is taken back and given anew
        turn = len(person.rows)
        order = orders[turn % 4]
        if turn in (4, 15):
            report(page, figures)
            before = (person.query(), person.shown())
            page.reload()
            page.wait_for_selector("body[data-query]")
            assert (person.query(), person.shown()) == before
        if turn == 9:
            shown, ranks = person.rows[-1][1:]
            waiting = person.query()
            page.keyboard.press("u")
            page.wait_for_function("(q) => document.body.dataset.query !== q", arg=waiting)
            assert person.shown() == shown
            checked = page.eval_on_selector_all(
                ".places input:checked", "(inputs) => inputs.map((input) => Number(input.value))"
            )
            assert tuple(checked) == ranks
            undone = turn - 1
            person.rows.append(("withdrawn", shown, ()))
            person.by_places((1, 1, 3))
            page.wait_for_function("(q) => document.body.dataset.query === q", arg=waiting)
        elif turn == 12:
            person.saves("skipped", (), "s")
        elif turn == 13:
            person.saves("undecided", (), "#undecided")
        elif turn == 14:
            page.keyboard.press("e")
            person.saves("ranked", (1, 1, 1), "Enter")
        elif turn == 16:  # the first two tie
            for key in "1t2":
                page.keyboard.press(key)
            person.saves("ranked", (1, 1, 3), "Enter")
        elif turn % 3 == 0:
            person.by_keys(order)
        elif turn % 3 == 1:
            person.by_clicks(order)
        else:
            person.by_drags((2, 1, 2) if turn == 20 else ranks_of(order))
    report(page, figures)

    with system.store() as store:
        stored = store.all("Anna")
        effective = store.effective("Anna")
    assert [row.verdict for row in stored] == [verdict for verdict, _, _ in person.rows]
    for row, (_, shown, ranks) in zip(stored, person.rows, strict=True):
        assert row.episode_ids == shown
        assert row.ranks == ranks
    taken_back = stored[undone + 1]
    assert taken_back.replaces == stored[undone].ranking_id
    assert len(effective) == QUERIES
    assert {row.ranking_id for row in stored} - {row.ranking_id for row in effective} == {
        stored[undone].ranking_id, taken_back.ranking_id
    }  # fmt: skip
    assert {row.source for row in effective} == {"web"}
    with capsys.disabled():
        show_figures(figures)


def show_figures(figures: dict[str, list[float]]) -> None:
    """Print the measured times: figures, not claims, for the machine may be busy."""
    for name, durations in sorted(figures.items()):
        ordered = sorted(durations)
        worst = ordered[min(len(ordered) - 1, round(0.95 * len(ordered)))]
        print(
            f"{name}: n {len(ordered)}, median {statistics.median(ordered):.0f} ms, "
            f"95 % {worst:.0f} ms, most {ordered[-1]:.0f} ms"
        )


def test_a_bad_name_is_refused_with_the_reason_and_nothing_runs(page: Any) -> None:
    page.fill("#name", "<img src=x onerror=alert(1)>")
    page.press("#name", "Enter")
    page.wait_for_function("() => document.getElementById('name-error').textContent.length > 0")
    assert "letters, digits" in page.inner_text("#name-error")
    assert page.get_attribute("body", "data-query") is None


def test_the_order_is_made_as_documented(page: Any) -> None:
    results = page.evaluate(
        """async () => {
          const { Ranking } = await import("/static/js/ranking.js");
          const outcome = (keys, count = 3) => {
            const ranking = new Ranking(count);
            for (const key of keys) key === "t" ? ranking.tie() : ranking.pick(Number(key) - 1);
            return ranking.complete ? ranking.ranks() : ranking.places;
          };
          return ["21", "213", "1t32", "12t", "11", "1t2", "212", "t12"].map((k) => outcome(k))
            .concat([outcome("3142", 4), outcome("1t24t", 4)]);
        }"""
    )
    assert results == [
        [2, 1, 3], [2, 1, 3], [1, 3, 1], [1, 2, 2], [None, None, None], [1, 1, 3],
        [2, None, 3], [1, 2, 3], [2, 4, 1, 3], [1, 1, 3, 3],
    ]  # fmt: skip


def test_it_works_by_keyboard_alone_and_says_what_it_does(page: Any, system: WebSystem) -> None:
    page.keyboard.type("Ben")
    page.keyboard.press("Enter")
    page.wait_for_selector("#help[open]")
    page.keyboard.press("Escape")
    page.wait_for_selector("body[data-query]")
    outline = page.locator("main").aria_snapshot()
    for words in (
        'button "Video 1: no place yet"',
        'group "Place of video 3"',
        'radio "Best"',
        'slider "Position in the videos"',
        'button "Pause"',
        'button "Can’t say"',
    ):
        assert words in outline, outline
    page.focus(".card:nth-child(2) .video")
    page.keyboard.press("Enter")
    assert "2" in page.inner_text("#said")
    page.keyboard.press("Tab")
    page.keyboard.press("Space")  # a place of the same video: Best stays
    for video in (0, 2):
        page.focus(f"input[name=place-{video}][value='{video + 1}']")
        page.keyboard.press("Space")
    before = page.get_attribute("body", "data-query")
    page.focus("#save")
    page.keyboard.press("Enter")
    page.wait_for_function("(q) => document.body.dataset.query !== q", arg=before)
    with system.store() as store:
        assert [row.ranks for row in store.all("Ben")] == [(1, 1, 3)]


def test_the_videos_stay_in_step_and_can_be_scrubbed_and_sped_up(page: Any) -> None:
    Person(page, "Carla").introduce()
    page.evaluate("document.getElementById('scrub').value = 500")
    page.dispatch_event("#scrub", "input")
    assert page.get_attribute("#play", "aria-label") == "Play"
    squares = page.evaluate(
        """[...document.querySelectorAll('.card canvas')].map((canvas) => {
          const row = canvas.getContext('2d').getImageData(0, 60, canvas.width, 1).data;
          return [...Array(canvas.width).keys()].findIndex((x) => row[4 * x] > 200);
        })"""
    )
    assert len(set(squares)) == 1 and 30 < squares[0] < 60
    page.keyboard.press("+")
    assert page.is_checked("[name=speed][value='2']")
    page.keyboard.press("Space")
    page.wait_for_function("() => document.getElementById('scrub').value > 700")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_both_pages_fit_a_telephone(browser: Any, system: WebSystem, scheme: str) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, color_scheme=scheme, has_touch=True, is_mobile=True
    )
    context.add_init_script(
        f"localStorage.setItem('rapl', {json.dumps(json.dumps({'name': 'Dora', 'helped': True}))})"
    )
    page = context.new_page()
    page.goto(system.address)
    page.wait_for_selector("body[data-query]")
    for selector in ("#save", "#undo", ".card:last-child .places"):
        box = page.locator(selector).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= 390
        assert box["y"] + box["height"] <= 844, f"{selector} is off the screen"
    page.tap(".card:nth-child(3) .video")
    assert page.is_checked("input[name=place-2][value='1']")
    page.goto(f"{system.address}live")
    page.wait_for_selector("#nodes li")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    context.close()


def test_without_the_token_the_page_asks_for_it(browser: Any, tmp_path: Path) -> None:
    make_videos(tmp_path, 4)
    with web_system(tmp_path, host="0.0.0.0") as guarded:
        port = guarded.address.rstrip("/").rpartition(":")[2]
        context = browser.new_context()
        page = context.new_page()
        page.goto(f"http://127.0.0.1:{port}/")
        page.fill("#name", "Eve")
        page.press("#name", "Enter")
        page.wait_for_selector("#locked[open]")
        page.goto(f"http://127.0.0.1:{port}/?again#token={guarded.token}")
        page.fill("#name", "Eve")
        page.press("#name", "Enter")
        page.wait_for_selector("#help[open]")
        assert guarded.token not in page.url
        context.close()
