"""Photograph the first screen of a report for README: ``python docs/images/render_report.py``.

The measurement is README's drawn one. Its first numbers stand in the picture's file as text, so that a test sees when
the program says others.
"""

import os
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo
from playwright.sync_api import sync_playwright

import heliogauge as hg

OUT = Path(__file__).with_name("report.png")
#: What the browser needs where it runs as root, and so that it asks nobody for anything.
OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run"]


def main() -> None:
    """Draw, measure and photograph."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        result = hg.measure(hg.synth("deflectometry", folder / "drawn-facet"), folder / "drawn-result")
        result.report()
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(
                executable_path=shutil.which("chromium") or os.environ["CHROMIUM"], args=OPTIONS
            )
            page = browser.new_page(viewport={"width": 1400, "height": 900})
            page.goto((folder / "drawn-result" / "report.html").as_uri())
            page.wait_for_timeout(2000)
            page.screenshot(path=OUT)
            browser.close()
        text = PngInfo()
        text.add_text("numbers", "\n".join(repr(result).splitlines()[1:5]))
        with Image.open(OUT) as picture:
            picture.convert("RGB").save(OUT, pnginfo=text, optimize=True)


if __name__ == "__main__":
    main()
