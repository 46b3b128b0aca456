"""Pages handed out to this machine alone: bound to the loop-back address, behind a random word in the address."""

import hmac
import io
import os
import secrets
import shutil
import sys
import tempfile
import traceback
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import parse_qsl, unquote, urlsplit

from heliogauge.errors import InputError, MetrologyError
from heliogauge.files.regular import open_regular
from heliogauge.view.server.opened import NotServedError, open_place
from heliogauge.view.server.site import Answer, Site, message_page

HOST = "127.0.0.1"
#: What a page may load: itself, this server and nothing else; no page of another host may frame or read it.
HEADERS: dict[str, str] = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": (
        "default-src 'none'; img-src 'self' data: blob:; style-src 'unsafe-inline'; font-src data:; "
        "script-src 'unsafe-inline' blob:; worker-src blob:; connect-src 'self' data: blob:; "
        "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
}
_FORWARDING = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>heliogauge</title><meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={address}"></head>
<body><a href="{address}">Results</a></body></html>
"""
# A browser asks at once; who holds a connection open without asking is cut off.
_PATIENCE_S = 30.0


class Viewer(ThreadingHTTPServer):
    """A server of one site.

    site: What is looked at.
    port: Port on this machine; 0: a free one.
    InputError: The port is taken or not allowed.
    """

    daemon_threads = True
    # On Windows reusing an address would let another program listen at the same port.
    allow_reuse_address = os.name != "nt"

    def __init__(self, site: Site, port: int = 0) -> None:
        self.site = site
        self.token = secrets.token_urlsafe(24)
        site.base = f"/{self.token}/"
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"--port {port}: cannot be used ({reason}); leave it out for a free one") from error

    @property
    def address(self) -> str:
        """Where the first page is."""
        return f"http://{HOST}:{self.server_port}{self.site.base}"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of connections that the browser dropped; a bug shows its traceback."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            traceback.print_exc()


class _Handler(BaseHTTPRequestHandler):
    server: Viewer
    server_version, sys_version = "heliogauge", ""
    protocol_version = "HTTP/1.1"
    timeout = _PATIENCE_S

    def do_GET(self) -> None:
        self._send(self._answer())

    def do_HEAD(self) -> None:
        self._send(self._answer(), body=False)

    def _refuse_method(self) -> None:
        # What came with the request stays unread, so the connection ends.
        self.close_connection = True
        self._send(Answer.of_text("only GET is served", HTTPStatus.METHOD_NOT_ALLOWED, {"Allow": "GET, HEAD"}))

    def __getattr__(self, name: str) -> Any:
        # http.server looks for "do_" and the method; whatever is neither GET nor HEAD is refused in one way.
        if name.startswith("do_"):
            return self._refuse_method
        raise AttributeError(name)

    def _answer(self) -> Answer:
        if not self._is_asked_here():
            return Answer.of_text("this page is served to this machine alone", HTTPStatus.FORBIDDEN)
        parts = urlsplit(self.path)
        token, _, rest = parts.path.removeprefix("/").partition("/")
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.server.token.encode()):
            return Answer.of_text("the word in the address is wrong or missing", HTTPStatus.FORBIDDEN)
        try:
            # Decoded once: "%252e" stays "%2e" and is then no name of a file here.
            address = unquote(rest, errors="strict")
            return self.server.site.answer(address, dict(parse_qsl(parts.query)))
        except UnicodeDecodeError:
            return Answer.of_text("the address cannot be read", HTTPStatus.BAD_REQUEST)
        except NotServedError as error:
            return message_page("Not served", str(error), HTTPStatus.NOT_FOUND)
        except MetrologyError as error:
            return message_page("This cannot be shown", str(error), HTTPStatus.UNPROCESSABLE_ENTITY)
        except Exception:
            # The border of a request: a bug of one page leaves the others, and the terminal shows it.
            traceback.print_exc()
            words = "A bug of heliogauge: the terminal where it was started shows where."
            return message_page("This page could not be made", words, HTTPStatus.INTERNAL_SERVER_ERROR)

    def _is_asked_here(self) -> bool:
        """Whether the request names this machine: another page's host name that leads here is refused."""
        names = {f"{name}:{self.server.server_port}" for name in (HOST, "localhost")}
        hosts = self.headers.get_all("Host") or []
        return len(hosts) == 1 and hosts[0] in names and self.path.startswith("/") and not self.path.startswith("//")

    def _send(self, answer: Answer, *, body: bool = True) -> None:
        if isinstance(answer.body, bytes):
            self._send_from(answer, io.BytesIO(answer.body), len(answer.body), body=body)
            return
        try:
            with open_regular(answer.body) as file:
                self._send_from(answer, file, os.fstat(file.fileno()).st_size, body=body)
        except InputError as error:
            self._send(message_page("This cannot be shown", str(error), HTTPStatus.UNPROCESSABLE_ENTITY), body=body)

    def _send_from(self, answer: Answer, source: BinaryIO, size: int, *, body: bool) -> None:
        self.send_response(answer.status)
        for name, value in (HEADERS | dict(answer.headers)).items():
            self.send_header(name, value)
        self.send_header("Content-Type", answer.media_type)
        self.send_header("Content-Length", str(size))
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if body:
            shutil.copyfileobj(source, self.wfile)

    def log_message(self, *words: Any) -> None:
        """Keep the terminal quiet: addresses hold the secret word."""


@dataclass(frozen=True, slots=True)
class Looking:
    """How a viewer is started.

    port: Port on this machine; 0: a free one.
    browser: Whether the browser is opened.
    """

    port: int = 0
    browser: bool = True


def look_at(paths: Sequence[Path], how: Looking, say: Callable[[str], None]) -> None:
    """Serve pages of results until Ctrl-C.

    paths: A result, a folder of results or a slope map; two: both and their difference.
    say: Takes lines for the terminal.
    InputError: Nothing to look at, or the port is taken.
    """
    viewer = Viewer(Site([open_place(path) for path in paths]), how.port)
    try:
        viewer.site.check()
        say(viewer.address)
        say("served to this machine alone; Ctrl-C ends")
        with ExitStack() as stack:
            if how.browser:
                # One that is packed with a temporary folder of its own (snap, flatpak) does not find the page.
                say("where the browser shows no page, paste the address above into it")
                # Some systems start the browser within this call.
                webbrowser.open(stack.enter_context(_forwarding_page(viewer.address)).as_uri())
            viewer.serve_forever()
    except KeyboardInterrupt:
        say("ended")
    finally:
        viewer.server_close()


@contextmanager
def _forwarding_page(address: str) -> Iterator[Path]:
    """Write a page that leads to an address, for this user's eyes alone; it goes at the end.

    Every user of a machine reads the arguments of its processes, a browser's too: the secret word must not be among
    them.
    """
    # The folder is this user's alone (mode 700).
    with tempfile.TemporaryDirectory(prefix="heliogauge-view-", ignore_cleanup_errors=True) as folder:
        page = Path(folder, "open.html")
        page.touch(mode=0o600)
        page.write_text(_FORWARDING.format(address=address), encoding="utf-8")
        yield page
