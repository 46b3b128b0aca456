"""Reports in Chromium: picture on the first screen, sideways scrolling on a phone, pages on paper, errors.

Run ``python benchmarks/report_pages.py FOLDER... [--pictures DIR]``: results, or folders of results (each result within
is looked at). Needs Playwright and a Chromium; ``--pictures`` keeps what was seen: screen, dark, phone and paper.
"""

import argparse
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright

DESKTOP = {"width": 1400, "height": 900}
PHONE = {"width": 390, "height": 844}
# A4 without the margins that the style sheet asks for, at 96 px an inch.
SHEET = {"width": 703, "height": 1020}
SHEETS = 4
PAGES = ("report.html", "why.html", "*/report.html", "*/why.html")
ASKED_SHARE = 0.6
_SHEET = re.compile(rb"/Type /Page\b(?!s)")
COLUMNS = ("picture", "phone [px]", "cut there", "sheets", "cut there", "errors", "MB", "ready [s]")
ASKED = (f">= {ASKED_SHARE:.0%}", f"<= {PHONE['width']}", "0", f"<= {SHEETS}", "0", "0", "", "")

# Share of the largest part of a map, scene, chart or photo that is inside the first screen.
PICTURE_SHARE = """() => {
  let share = 0;
  for (const one of document.querySelectorAll("main canvas, main svg, main img")) {
    const box = one.getBoundingClientRect();
    if (box.width < 200 || box.height < 120 || !one.checkVisibility({ visibilityProperty: true })) continue;
    const wide = Math.min(box.right, innerWidth) - Math.max(box.left, 0);
    const high = Math.min(box.bottom, innerHeight) - Math.max(box.top, 0);
    share = Math.max(share, Math.max(wide, 0) * Math.max(high, 0) / (box.width * box.height));
  }
  return share;
}"""

# Words that are wider than their box and hidden there, or stick out of the page where nothing scrolls.
CUT = """(width) => {
  const found = [];
  for (const one of document.querySelectorAll("main *")) {
    if (!one.checkVisibility() || one.closest(".view-hidden, svg, .katex")) continue;
    const style = getComputedStyle(one);
    const words = [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    if (!words || style.position === "absolute" || style.clipPath !== "none") continue;
    if (style.overflowX === "hidden" && one.scrollWidth > one.clientWidth + 1) found.push(one.textContent.trim());
    let scrolls = false;
    for (let up = one; up; up = up.parentElement) {
      scrolls ||= ["auto", "scroll"].includes(getComputedStyle(up).overflowX) && width < 600;
    }
    if (!scrolls && one.getBoundingClientRect().right > width + 1) found.push(one.textContent.trim());
  }
  return found;
}"""


def pages_in(folders: list[Path]) -> list[Path]:
    """Return every report in the folders, one level below, and what failed runs leave."""
    found = []
    for folder in folders:
        found += [path for pattern in PAGES for path in sorted(folder.glob(pattern))]
    return found


class Looker:
    """Opens one report in the ways that people do, and keeps what it saw."""

    def __init__(self, browser: Browser, report: Path, pictures: Path, name: str):
        self._browser = browser
        self._report = report
        self._pictures = pictures
        self._name = name
        self.errors: list[str] = []

    def values(self) -> tuple[tuple[str, ...], list[str]]:
        """Return what the columns say, and the words that are cut."""
        start = time.perf_counter()
        page = self._open(DESKTOP)
        ready_s = time.perf_counter() - start
        share = page.evaluate(PICTURE_SHARE)
        page.screenshot(path=self._picture("desktop.png"))
        page.screenshot(path=self._picture("whole.png"), full_page=True)
        page.close()
        page = self._open(DESKTOP, color_scheme="dark")
        page.screenshot(path=self._picture("dark.png"), full_page=True)
        page.close()
        page = self._open(PHONE)
        width = page.evaluate("document.documentElement.scrollWidth")
        cut_on_phone = page.evaluate(CUT, PHONE["width"])
        page.screenshot(path=self._picture("phone.png"), full_page=True)
        page.close()
        page = self._open(SHEET)
        paper = page.pdf(prefer_css_page_size=True, print_background=True, path=self._picture("paper.pdf"))
        page.emulate_media(media="print")
        cut_on_paper = page.evaluate(CUT, SHEET["width"])
        page.close()
        values = (
            f"{share:.0%}",
            f"{width}",
            f"{len(cut_on_phone)}",
            f"{len(_SHEET.findall(paper))}",
            f"{len(cut_on_paper)}",
            f"{len(self.errors)}",
            f"{self._report.stat().st_size / 1e6:.1f}",
            f"{ready_s:.1f}",
        )
        cut = [("phone", text) for text in cut_on_phone] + [("paper", text) for text in cut_on_paper]
        return values, [f"{where}: {text[:60]}" for where, text in cut]

    def _open(self, size: dict[str, int], **options) -> Page:
        page = self._browser.new_page(viewport=size, **options)
        page.on("console", lambda message: message.type == "error" and self.errors.append(message.text))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.goto(self._report.as_uri())
        # Views are drawn when they come into sight.
        height = page.evaluate("document.documentElement.scrollHeight")
        for top in range(0, height, size["height"]):
            page.evaluate(f"window.scrollTo(0, {top})")
            page.wait_for_timeout(30)
        page.evaluate("window.scrollTo(0, 0)")
        page.wait_for_timeout(250)
        return page

    def _picture(self, what: str) -> Path:
        return self._pictures / f"{self._name}-{what}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="results, or folders of results")
    parser.add_argument("--pictures", type=Path, help="keep the screens and sheets here")
    options = parser.parse_args()
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        sys.exit("no Chromium on this machine (as root: apt-get install chromium)")
    pages = pages_in(options.folders)
    width = max(len(page.parent.name) for page in pages) + 2
    print(f"{'':{width}}" + "".join(f"{column:>12}" for column in COLUMNS))
    print(f"{'asked':{width}}" + "".join(f"{asked:>12}" for asked in ASKED))
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        pictures = options.pictures or Path(scratch)
        pictures.mkdir(parents=True, exist_ok=True)
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        for path in pages:
            name = path.parent.name
            looker = Looker(browser, path.resolve(), pictures, name)
            values, cut = looker.values()
            print(f"{name:{width}}" + "".join(f"{value:>12}" for value in values), flush=True)
            for line in [*cut, *looker.errors]:
                print(f"{'':{width}}  {line}")
        browser.close()


if __name__ == "__main__":
    main()
