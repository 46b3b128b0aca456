"""A real browser, and pages of views that it opens from a file without network."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from heliogauge.view.assets import page_assets

# Names under which Debian, Fedora, Arch and Google install it.
CHROMIUMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]
HEAD = '<meta charset="utf-8"><title>t</title><meta name="viewport" content="width=device-width">'
DESKTOP = {"width": 1400, "height": 900}


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """Chromium of the system."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed (make .make/dev)")
    path = next(filter(None, map(shutil.which, CHROMIUMS)), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(CHROMIUMS)} is installed (as root: apt-get install chromium)")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        yield browser
        browser.close()


@dataclass(frozen=True)
class Opener:
    """Opens pages offline; remembers what the page asked of the network and complained about."""

    browser: Any
    folder: Path
    complaints: list[str]
    contexts: list[Any]

    def body(self, body: str, **context: Any) -> Any:
        """Open a page that holds the body, with the assets of its views."""
        head = HEAD + page_assets(body)
        path = self.folder / "page.html"
        path.write_text(f'<!DOCTYPE html><html lang="en"><head>{head}</head><body>{body}</body></html>', "utf-8")
        return self.file(path, **context)

    def file(self, path: Path, **context: Any) -> Any:
        """Open a file."""
        made = self.browser.new_context(**{"viewport": DESKTOP, "offline": True, **context})
        self.contexts.append(made)
        page = made.new_page()
        page.on("console", lambda message: message.type == "error" and self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self._asked(request.url, path))
        page.goto(path.as_uri())
        return page

    def _asked(self, url: str, path: Path) -> None:
        if not url.startswith(("data:", "blob:", path.as_uri())):
            self.complaints.append(f"asked for {url}")


@pytest.fixture
def open_page(chromium: Any, tmp_path: Path) -> Iterator[Opener]:
    """Open a page from a file, offline; fails the test on a console error or a request."""
    opener = Opener(chromium, tmp_path, [], [])
    yield opener
    for context in opener.contexts:
        context.close()
    assert opener.complaints == []
