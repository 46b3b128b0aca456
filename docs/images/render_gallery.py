"""Photograph the first screens of reports for gallery and front page: ``python docs/images/render_gallery.py FOLDER``.

Draws and measures one synthetic measurement of each instrument in FOLDER (a few minutes; what is there is kept), opens
the reports in the system's Chromium through Playwright, and writes docs/images/gallery_NAME.png.
"""

import shutil
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from playwright.sync_api import sync_playwright

import heliogauge as hg

IMAGES = Path(__file__).parent
#: Picture, instrument, what of the result is shown.
SCREENS = (
    ("deflectometry", "deflectometry", ""),
    ("photogrammetry", "photogrammetry", ""),
    ("camera", "camera", ""),
    ("observer", "observer", ""),
    ("field", "heliostat", ""),
    ("heliostat", "heliostat", "H01"),
)
SIZE = {"width": 1400, "height": 900}
OPTIONS = ["--no-sandbox", "--disable-gpu"]


def report_of(folder: Path, instrument: str, part: str) -> Path:
    """Measure a synthetic folder, once, and return its report."""
    out = folder / f"{instrument}-result"
    if not out.exists():
        hg.measure(hg.synth(instrument, folder / instrument, force=True), out)
    result = hg.open(out / part if part else out)
    return result.report()


def write_smaller(path: Path, png: bytes) -> None:
    """Write a picture with the few colours it has: half the bytes."""
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def photograph(page: Any, report: Path) -> bytes:
    """Return the first screen of a report."""
    page.goto(report.resolve().as_uri())
    page.wait_for_timeout(2500)
    png: bytes = page.screenshot()
    return png


def main(folder: Path) -> None:
    """Draw all pictures."""
    browser_path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=browser_path, args=OPTIONS)
        page = browser.new_page(viewport=SIZE)
        for name, instrument, part in SCREENS:
            write_smaller(IMAGES / f"gallery_{name}.png", photograph(page, report_of(folder, instrument, part)))
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
