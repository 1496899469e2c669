"""Take the pictures of both pages for docs/images from a page that is running.

    ./run_all.sh franka_group --quick --web --keep-running
    python experiments/web_page/pictures.py http://127.0.0.1:8765/

Wide (1280) and as on a telephone (390), light and dark; needs a Chromium. Nothing is ranked.
"""

import argparse
import io
import json
import shutil
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Browser, sync_playwright

ROOT = Path(__file__).parents[2]
SCREENS = {"wide": (1280, 800, 1, False), "phone": (390, 844, 2, True)}
PAGES = {"rank": ("", "body[data-query]"), "live": ("live", "#nodes li:nth-child(9)")}
LOOK_MS = 3500
"""For the videos to get going, or for the charts to be drawn."""
COLOURS = 160
PHONE_WIDTH = 585


def save(png: bytes, path: Path, width: int | None) -> None:
    """Write a picture with few colours, narrowed to ``width`` pixels."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    if width is not None:
        height = round(picture.height * width / picture.width)
        picture = picture.resize((width, height), Image.Resampling.LANCZOS)
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def take(browser: Browser, address: str, name: str, folder: Path, screen: str) -> None:
    """Take one page on one screen, light and dark."""
    width, height, ratio, touch = SCREENS[screen]
    path, selector = PAGES[name]
    context: Any = browser.new_context(
        viewport={"width": width, "height": height},
        device_scale_factor=ratio,
        has_touch=touch,
        is_mobile=touch,
    )
    known = json.dumps(json.dumps({"name": "Anna", "helped": True}))
    context.add_init_script(f"localStorage.setItem('rapl', {known})")
    page = context.new_page()
    page.goto(f"{address}{path}", timeout=120_000)
    page.wait_for_selector(selector, timeout=120_000)
    page.wait_for_timeout(LOOK_MS)
    if name == "rank":
        for key in "21":
            page.keyboard.press(key)
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(1200)
        png = page.screenshot(full_page=name == "live", timeout=120_000)
        narrowed = PHONE_WIDTH if touch else None
        save(png, folder / f"{name}-{screen}-{scheme}.png", narrowed)
    context.close()


def main() -> None:
    """Take all eight."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address", help="of the page, as it was printed; ends with a slash")
    parser.add_argument("--pages", nargs="+", choices=sorted(PAGES), default=sorted(PAGES))
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    arguments = parser.parse_args()
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        parser.exit(2, "needs chromium or google-chrome\n")
    arguments.out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for name in arguments.pages:
            for screen in SCREENS:
                take(browser, arguments.address, name, arguments.out, screen)
        browser.close()


if __name__ == "__main__":
    main()
