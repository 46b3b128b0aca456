"""How quickly a map of a million nodes answers in Chromium: pointer to value, first picture, zoom, removal, page size.

A page as the viewer serves it (every node) and as a report holds it (thinned). Needs Playwright and a Chromium.
"""

import shutil
import statistics
import sys
import tempfile
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from _measure import row, title  # noqa: E402
from playwright.sync_api import Page, sync_playwright  # noqa: E402

from heliogauge.flags import SampleFlag  # noqa: E402
from heliogauge.slopes.map import SlopeMap, no_common_modes  # noqa: E402
from heliogauge.view.arrays import PAGE, ServedStore  # noqa: E402
from heliogauge.view.assets import page_assets  # noqa: E402
from heliogauge.view.maps import slope_map_view  # noqa: E402

NODES = 1000
MOVES = 60
ASKED_MS = 50

# From the pointer's event to the value in the page (change), and to the next frame that shows it (frame).
POINTER_MS = """async (moves) => {
  const figure = document.querySelector(".view-figure");
  const readout = document.querySelector(".view-readout");
  const box = figure.getBoundingClientRect();
  const frame = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const found = [];
  for (let index = 0; index < moves; index++) {
    await frame();
    const before = readout.textContent;
    const at = { clientX: box.left + box.width * (0.2 + 0.4 * index / moves), clientY: box.top + 120 + 3 * index };
    const start = performance.now();
    figure.dispatchEvent(new PointerEvent("pointermove", { ...at, bubbles: true, pointerType: "mouse" }));
    if (readout.textContent === before) throw new Error("no new value");
    const changed = performance.now();
    await frame();
    found.push([changed - start, performance.now() - start]);
  }
  return found;
}"""

ZOOM_MS = """async () => {
  const figure = document.querySelector(".view-figure");
  figure.focus();
  const frame = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  const found = [];
  for (let index = 0; index < 12; index++) {
    await frame();
    const start = performance.now();
    figure.dispatchEvent(new KeyboardEvent("keydown", { key: index % 2 ? "-" : "+", bubbles: true }));
    await frame();
    found.push(performance.now() - start);
  }
  return found;
}"""

REMOVAL_MS = """async () => {
  const note = [...document.querySelectorAll(".view-note")].find((one) => one.textContent.includes("In view"));
  const before = note.textContent;
  const what = { childList: true, characterData: true, subtree: true };
  const changed = new Promise((done) => new MutationObserver(done).observe(note, what));
  const start = performance.now();
  document.querySelector(".view-figure").dispatchEvent(new KeyboardEvent("keydown", { key: "r", bubbles: true }));
  await changed;
  return performance.now() - start;
}"""


class Handler(BaseHTTPRequestHandler):
    """Gives out the page and the arrays of a store."""

    def __init__(self, page: bytes, store: ServedStore, *args):
        self._page, self._store = page, store
        super().__init__(*args)

    def do_GET(self) -> None:
        """Answer with the page, or with the array of a number."""
        number = self.path.removeprefix("/data/")
        self.send_response(200)
        content = self._store.contents[int(number)][0] if number.isdigit() else self._page
        self.send_header("Content-Type", "application/octet-stream" if number.isdigit() else "text/html; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *args) -> None:
        """Say nothing."""


def large_map() -> SlopeMap:
    axis = np.linspace(-1.5, 1.5, NODES)
    x, y = np.meshgrid(axis, axis)
    rng = np.random.default_rng(0)
    slopes = [one / 20 * 1.01 + 5e-4 * np.sin(5 * x) * np.cos(4 * y) + rng.normal(0, 3e-5, x.shape) for one in (x, y)]
    hole = (x - 0.5) ** 2 + y**2 < 0.02
    return SlopeMap(
        x_m=axis,
        y_m=axis,
        slope_x=np.where(hole, np.nan, slopes[0]),
        slope_y=np.where(hole, np.nan, slopes[1]),
        design_slope_x=x / 20,
        design_slope_y=y / 20,
        sigma_random_x=np.full(x.shape, 3e-5),
        sigma_random_y=np.full(x.shape, 3e-5),
        noise_correlation=1.0,
        common=no_common_modes(),
        height_m=(x**2 + y**2) / 40,
        flags=np.where(hole, int(SampleFlag.OFF_SCREEN), 0).astype(np.uint32),
        aperture=np.ones(x.shape, dtype=bool),
        design="paraboloid, f = 10 m",
        frame="mirror",
        removed="nothing",
    )


def document(body: str) -> bytes:
    head = f'<meta charset="utf-8"><title>map</title>{page_assets(body)}'
    return f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{body}</body></html>'.encode()


def measure(page: Page, address: str, size: int) -> None:
    page.goto(address, wait_until="commit")
    page.wait_for_selector(".view.alive")
    page.wait_for_function("document.querySelector('.view-note').textContent.length > 0")
    first_ms = page.evaluate(
        "performance.getEntriesByType('mark').find((one) => one.name === 'first picture').startTime"
    )
    moves = page.evaluate(POINTER_MS, MOVES)
    changes, frames = (sorted(one[at] for one in moves) for at in (0, 1))
    row("page and its arrays [MB]", f"{size / 1e6:.2f}")
    row("opening to first picture [ms]", f"{first_ms:.0f}")
    row("pointer to value in the page, median [ms]", f"{statistics.median(changes):.2f}", f"< {ASKED_MS}")
    row("pointer to value in the page, slowest of 60 [ms]", f"{changes[-1]:.2f}", f"< {ASKED_MS}")
    row("pointer to the frame that shows it, median [ms]", f"{statistics.median(frames):.1f}", f"< {ASKED_MS}")
    row("zoom to the frame that shows it, median [ms]", f"{statistics.median(page.evaluate(ZOOM_MS)):.0f}")
    row("tilt removed, RMS beside [ms]", f"{page.evaluate(REMOVAL_MS):.0f}")


def main() -> None:
    path = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if path is None:
        print("no Chromium on this machine (as root: apt-get install chromium)")
        return
    view = slope_map_view(large_map(), "a million nodes")
    store = ServedStore("data/")
    served = document(view.page_html(store))
    report = document(view.page_html(PAGE))
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, served, store))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        title(f"Map of {NODES} x {NODES} nodes, as the viewer serves it: every node", ("measured", "asked"))
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        measure(
            page, f"http://127.0.0.1:{server.server_port}/", len(served) + sum(len(one[0]) for one in store.contents)
        )
        title("The same map in a report: thinned, one file", ("measured", "asked"))
        file = Path(scratch) / "report.html"
        file.write_bytes(report)
        measure(page, file.as_uri(), len(report))
        browser.close()
    server.shutdown()


if __name__ == "__main__":
    main()
