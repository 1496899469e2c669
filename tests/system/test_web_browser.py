"""A person's whole job in a real browser: rank, tie, drag, undo, reload; nothing else is stored."""

import json
import os
import platform
import statistics
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from web_browser import VIDEOS, Person, ranks_of
from web_system import WebSystem, make_videos, web_system

QUERIES = 25
FIGURES_VARIABLE = "RAPL_PAGE_FIGURES"
"""Names a file for the measured times, as experiments/preferences/results/page_latency.json is."""

pytestmark = [pytest.mark.browser, pytest.mark.timeout(240)]


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
    if FIGURES_VARIABLE in os.environ:
        write_figures(Path(os.environ[FIGURES_VARIABLE]), figures)


def write_figures(path: Path, figures: dict[str, list[float]]) -> None:
    """Keep the measured times with what they were measured on."""
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True).stdout
    record = {
        "script": f"{FIGURES_VARIABLE}=FILE pytest {Path(__file__).name} -m browser",
        "what": {
            "submit-to-next": "from the press that saves to the next videos on the screen",
            "query-to-playing": "from the receipt of a query that was waited for to its videos",
            "shown-to-playing": "from the moment a query is shown to its videos on the screen",
        },
        "on the screen": "second animation frame after the first pictures were drawn",
        "commit": commit.strip(),
        "machine": f"{os.cpu_count()} x {platform.processor() or platform.machine()}",
        "load_average_1_min": round(os.getloadavg()[0], 1),
        "milliseconds": {
            name: {
                "n": len(times),
                "median": round(statistics.median(times)),
                "most": round(max(times)),
                "each": [round(time) for time in times],
            }
            for name, times in sorted(figures.items())
        },
    }
    path.write_text(json.dumps(record, indent=1) + "\n")


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
    tab_to(page, "Video 2: no place yet")
    page.keyboard.press("Enter")
    assert "2" in page.inner_text("#said")
    for video in (0, 2):
        tab_to(page, f"place-{video}")
        page.keyboard.press("Space")  # best, as the other one
        page.keyboard.press("ArrowRight")
    before = page.get_attribute("body", "data-query")
    assert page.inner_text("#hint") == "From the best: 2, then 1 and 3 equal."
    tab_to(page, "save")
    page.keyboard.press("Enter")
    page.wait_for_function("(q) => document.body.dataset.query !== q", arg=before)
    with system.store() as store:
        assert [row.ranks for row in store.all("Ben")] == [(2, 1, 2)]


def tab_to(page: Any, wanted: str) -> None:
    """Press Tab until the control of that label, name or id has the focus."""
    for _ in range(60):
        page.keyboard.press("Tab")
        if wanted in page.evaluate(
            "(({ ariaLabel, name, id }) => [ariaLabel, name, id])(document.activeElement)"
        ):
            return
    raise AssertionError(f"{wanted} is not to be reached by Tab")


def test_the_videos_stay_in_step_and_can_be_scrubbed_and_sped_up(page: Any) -> None:
    Person(page, "Carla").introduce()
    page.eval_on_selector(
        "#scrub", "(scrub) => { scrub.value = 500; scrub.dispatchEvent(new Event('input')); }"
    )
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
