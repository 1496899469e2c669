"""A person at the page in a real browser."""

from typing import Any

from web_system import colour_of

VIDEOS = 40


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
