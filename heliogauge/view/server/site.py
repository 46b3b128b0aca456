"""Which page answers which address."""

import hashlib
import html
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote

from heliogauge.errors import InputError
from heliogauge.reporting.build import REPORT_HTML, REPORT_NOTEBOOK
from heliogauge.reporting.notebook import ShownCell
from heliogauge.reporting.page_frame import page_frame
from heliogauge.results.folder import SUMMARY_FILE, read_summary, what_instead
from heliogauge.results.opened import SLOPE_MAP_FILE
from heliogauge.view.arrays import ServedStore
from heliogauge.view.server.difference import Side, check_sides, difference_page
from heliogauge.view.server.opened import (
    MEDIA_TYPES,
    SHOWN_TYPES,
    NotServedError,
    Opened,
    folders_of_results,
    is_result,
)
from heliogauge.view.server.pages import folder_page, map_page, result_page

HTML = "text/html; charset=utf-8"
# Pages kept with the numbers beside them: one of a million nodes holds 50 MB.
_MOST_PAGES = 8


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What goes back to the browser.

    body: All bytes, or the file that holds them.
    """

    body: bytes | Path
    media_type: str
    status: HTTPStatus = HTTPStatus.OK
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_text(cls, text: str, status: HTTPStatus, headers: Mapping[str, str] | None = None) -> "Answer":
        """Make an answer of one line."""
        return cls(text.encode() + b"\n", "text/plain; charset=utf-8", status, headers or {})


@dataclass(frozen=True, slots=True, eq=False)
class _Page:
    """A page with the numbers beside it.

    stamp: Stands for names, times and sizes of the files that it was made from.
    """

    body: bytes
    contents: Sequence[tuple[bytes, str]]
    stamp: str


class Site:
    """All pages of what was opened.

    opened: One place, or two to be compared.
    InputError: Another number of places.
    """

    def __init__(self, opened: Sequence[Opened]) -> None:
        if len(opened) not in (1, 2):
            raise InputError(f"{len(opened)} paths: one is looked at, or two are compared")
        #: What stands before every address.
        self.base = "/"
        self._opened = {str(number): one for number, one in enumerate(opened, start=1)}
        self._pages: dict[str, _Page] = {}
        # Figures are drawn in one thread at a time.
        self._making = threading.Lock()

    def check(self) -> None:
        """Check that there is something to show, without making a page.

        InputError: There are no results, or two that cannot be compared.
        """
        for one in self._opened.values():
            if not one.only and not is_result(one.root) and next(folders_of_results(one.root), None) is None:
                raise InputError(f"{one.root}: {what_instead(one.root, ', nor in the folders below')}")
        if len(self._opened) == 2:
            check_sides(self._side("1/"), self._side("2/"))

    def answer(self, address: str, query: Mapping[str, str]) -> Answer:
        """Answer one request.

        address: What follows the secret word, decoded.
        query: What follows the question mark.
        NotServedError, InputError: It cannot be answered; the text says why.
        """
        if not address:
            return self._moved("1/" if len(self._opened) == 1 else "difference?first=1/&second=2/")
        if address == "difference":
            return self._difference(query)
        opened, inside = self._split(address)
        if opened.only and not inside:
            file = opened.find(opened.only)
            return self._kept(address, query, [file], lambda store: map_page(file, store))
        folder, _, name = inside.rpartition("/")
        # The report that lies there is as it was written once, by whomever; here it is made from the numbers.
        place = opened.find(folder if name == REPORT_HTML else inside)
        if not place.is_dir():
            return _file(place)
        if name not in ("", REPORT_HTML):
            # Addresses in a page are relative to its folder.
            return self._moved(f"{address}/")
        up = () if place == opened.root else ((f"\u2191 {place.parent.name}", "../"),)
        here = address[: len(address) - len(name)]
        if not is_result(place):
            return Answer(folder_page(place, up, here).encode(), HTML)
        opened.refuse_links(place)
        files = sorted(one for one in place.iterdir() if one.name not in (REPORT_HTML, REPORT_NOTEBOOK))
        return self._kept(address, query, files, lambda store: result_page(place, up, here, store))

    def _split(self, address: str) -> tuple[Opened, str]:
        number, slash, inside = address.partition("/")
        if number not in self._opened or not slash:
            raise NotServedError("there is no such page")
        return self._opened[number], inside

    def _moved(self, address: str) -> Answer:
        where = {"Location": self.base + quote(address, safe="/?=&")}
        return Answer.of_text("see there", HTTPStatus.FOUND, where)

    def _side(self, address: str) -> Side:
        """Return one of two results that are compared."""
        opened, inside = self._split(address)
        if opened.only:
            file = opened.find(opened.only)
            return Side(f"{file.parent.name}/{file.name}", self.base + quote(address), None, file, (file,))
        place = opened.find(inside.removesuffix(REPORT_HTML))
        if not place.is_dir() or not is_result(place):
            raise InputError(f"{place}: no results, so there is nothing to compare")
        opened.refuse_links(place)
        summary, file = read_summary(place), place / SLOPE_MAP_FILE
        slopes = file if file.is_file() else None
        files = (place / SUMMARY_FILE, *([slopes] if slopes else ()))
        return Side(f"{summary.name} ({place.name})", self.base + quote(address), summary, slopes, files)

    def _difference(self, query: Mapping[str, str]) -> Answer:
        sides = self._side(query.get("first", "")), self._side(query.get("second", ""))
        files = [file for side in sides for file in side.files]
        key = f"difference?first={quote(query['first'])}&second={quote(query['second'])}"
        return self._kept(key, query, files, lambda store: difference_page(*sides, store))

    def _kept(
        self, key: str, query: Mapping[str, str], files: Sequence[Path], make: Callable[[ServedStore], str]
    ) -> Answer:
        """Return a page, or one of the parts beside it; made anew when its files have changed."""
        stamp = _stamp(files)
        if query.get("of", stamp) != stamp:
            raise NotServedError("the results have changed since the page was made; load it again")
        page = self._pages.get(key)
        if page is None or page.stamp != stamp:
            with self._making:
                page = self._pages.get(key)
                if page is None or page.stamp != stamp:
                    page = self._pages[key] = self._make(key, stamp, make)
        if "part" not in query:
            return Answer(page.body, HTML)
        part = query["part"]
        if not part.isascii() or not part.isdigit() or int(part) >= len(page.contents):
            raise NotServedError("there is no such part of the page")
        return Answer(*page.contents[int(part)])

    def _make(self, key: str, stamp: str, make: Callable[[ServedStore], str]) -> _Page:
        address = key if "?" in key else quote(key)
        store = ServedStore(f"{self.base}{address}{'&' if '?' in key else '?'}of={stamp}&part=")
        body = make(store).encode()
        while len(self._pages) >= _MOST_PAGES:
            del self._pages[next(iter(self._pages))]
        return _Page(body, store.contents, stamp)


def message_page(title: str, text: str, status: HTTPStatus) -> Answer:
    """Return a page that says why there is no other."""
    words = f'<h1>{html.escape(title)}</h1><p>{html.escape(text)}</p><p><a href="./">Back</a></p>'
    return Answer(page_frame(title, [ShownCell(words, printed=True)]).encode(), HTML, status)


def _file(place: Path) -> Answer:
    kind = MEDIA_TYPES.get(place.suffix.lower())
    if kind is None or not place.is_file():
        raise NotServedError(f"{place.name}: only files of results are served: {', '.join(MEDIA_TYPES)}")
    shown = kind.startswith(SHOWN_TYPES)
    name = quote(place.name)
    headers = {} if shown else {"Content-Disposition": f"attachment; filename*=UTF-8''{name}"}
    return Answer(place, kind, headers=headers)


def _stamp(files: Sequence[Path]) -> str:
    """Return a short word that changes with names, times and sizes of files."""
    try:
        marks = [(str(file), (state := file.stat()).st_mtime_ns, state.st_size) for file in files]
    except OSError as error:
        # A link to nothing or to itself, or a file that is being replaced.
        raise InputError(f"{error.filename}: cannot be read ({error.strerror}); remove it, or put it back") from error
    return hashlib.sha256(repr(marks).encode()).hexdigest()[:16]
