"""Run a package's report notebook on a folder of results and write one self-contained HTML file.

The notebook is package data of the instrument that measured (`heliogauge.instruments`); it runs in a kernel of this
very Python, so no kernel needs to be installed for it, and only the numbers in the folder enter it.
"""

import asyncio
import atexit
import html
import os
import re
import sys
import sysconfig
import tempfile
import threading
from collections.abc import Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import nbformat
from jupyter_client.kernelspec import KernelSpec
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from heliogauge.errors import InputError
from heliogauge.instruments import instruments, read_resource
from heliogauge.reporting.style import STYLE
from heliogauge.results.folder import Summary, read_summary
from heliogauge.running.environment import environment

REPORT_HTML = "report.html"
REPORT_NOTEBOOK = "report.ipynb"

# A loaded machine needs seconds to start a kernel; a cell of the report takes less than a second.
_START_S = 120
_CELL_S = 600


def build_report(folder: Path) -> Path:
    """Write ``report.html``, and ``report.ipynb`` as it was run, from the results in a folder.

    InputError: No results in the folder, results of a kind without a report, a file of results that is missing or
        damaged, or the folder cannot be written to.
    """
    folder = folder.resolve()
    summary = read_summary(folder / "summary.json")
    notebook = _execute(_notebook_of(summary, folder), folder)
    page = _page(summary, _body(notebook))
    try:
        _replace(folder / REPORT_NOTEBOOK, nbformat.writes(notebook))
        _replace(folder / REPORT_HTML, page)
    except OSError as error:
        raise InputError(f"{folder}: the report cannot be written ({error.strerror or error})") from error
    return folder / REPORT_HTML


def _notebook_of(summary: Summary, folder: Path) -> Any:
    reports = {kind: file for one in instruments() for kind, file in one.reports.items()}
    if summary.kind not in reports:
        kinds = ", ".join(reports)
        raise InputError(f"{folder / 'summary.json'}: no report for the kind {summary.kind!r} (there are: {kinds})")
    return nbformat.reads(read_resource(reports[summary.kind]), as_version=4)


class _OwnPython(AsyncKernelManager):
    """Starts a kernel of this Python, whatever kernel specifications are installed.

    Sockets in a private folder instead of network ports, where the system has them: nobody else can listen.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        place = os.path.join(os.environ["JUPYTER_RUNTIME_DIR"], "kernel")
        self.connection_file = f"{place}.json"
        # A socket's path ends at 107 characters.
        if os.name == "posix" and len(place) < 90:
            self.transport = "ipc"
            self.ip = place

    @property
    def kernel_spec(self) -> KernelSpec:
        """How to start the kernel: this interpreter, no history file."""
        command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        quiet = ["--HistoryManager.enabled=False", "--log-level=40"]
        return KernelSpec(argv=[*command, *quiet], display_name="Python", language="python")


def _execute(notebook: Any, folder: Path) -> Any:
    with _private_jupyter():
        client = NotebookClient(
            notebook,
            kernel_manager_class=_OwnPython,
            timeout=_CELL_S,
            startup_timeout=_START_S,
            resources={"metadata": {"path": str(folder)}},
            # Times of each cell would make two reports of the same results differ.
            record_timing=False,
            # The kernel has nothing to say goodbye for.
            shutdown_kernel="immediate",
        )
        try:
            return _InterruptibleRun(client).result()
        except CellExecutionError as error:
            if error.ename == InputError.__name__:
                raise InputError(f"{folder}: no report can be made: {error.evalue}") from None
            raise


class _InterruptibleRun:
    """Executes a notebook in a thread of its own, so that Ctrl-C and a termination signal reach the caller.

    In the main thread nbclient takes over both signals and ends with a traceback of its own when one comes. Here the
    caller waits; what interrupts it cancels the run and stops the kernel, which would live on in its own session.
    """

    def __init__(self, client: NotebookClient) -> None:
        self._client = client
        self._outcome: Future[Any] = Future()
        self._started = threading.Event()
        self._interrupted = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    def result(self) -> Any:
        """Return the executed notebook, or raise what its execution raised."""
        threading.Thread(target=self._work, name="report").start()
        try:
            return self._outcome.result()
        except BaseException:
            # An interruption comes here while the thread still works; its own errors come here when it has ended.
            self._started.wait()
            if self._loop is not None and not self._outcome.done():
                self._loop.call_soon_threadsafe(self._interrupted.set)
                wait([self._outcome])
            raise

    def _work(self) -> None:
        try:
            notebook = asyncio.run(self._run())
        except BaseException as error:
            self._started.set()
            self._outcome.set_exception(error)
        else:
            self._outcome.set_result(notebook)

    async def _run(self) -> Any:
        self._loop = asyncio.get_running_loop()
        self._started.set()
        running = asyncio.ensure_future(self._client.async_execute())
        stopping = asyncio.ensure_future(self._interrupted.wait())
        await asyncio.wait({running, stopping}, return_when=asyncio.FIRST_COMPLETED)
        if not running.done():
            running.cancel()
            await asyncio.wait({running})
            manager = self._client.km
            if manager is not None and manager.has_kernel:
                await manager.shutdown_kernel(now=True)
        stopping.cancel()
        # nbclient cleans up once more when the process ends; there is nothing left then.
        atexit.unregister(self._client._cleanup_kernel)
        return running.result()


@contextmanager
def _private_jupyter() -> Iterator[None]:
    """Keep the kernel's files out of the user's home, and let it import the same heliogauge as this process."""
    source = str(Path(__file__).resolve().parents[1])
    with tempfile.TemporaryDirectory(prefix="heliogauge-report-") as scratch:
        changes = {"IPYTHONDIR": scratch, "JUPYTER_RUNTIME_DIR": scratch, "JUPYTER_PREFER_ENV_PATH": "1"}
        if source not in (sysconfig.get_path("purelib"), sysconfig.get_path("platlib")):
            changes["PYTHONPATH"] = os.pathsep.join(filter(None, (source, os.environ.get("PYTHONPATH"))))
        with environment(changes):
            yield


def _body(notebook: Any) -> str:
    from nbconvert.exporters import HTMLExporter

    exporter = HTMLExporter(
        template_name="basic",
        exclude_input=True,
        exclude_input_prompt=True,
        exclude_output_prompt=True,
        exclude_anchor_links=True,
    )
    body, _ = exporter.from_notebook_node(notebook)
    return str(body)


def _page(summary: Summary, body: str) -> str:
    titles: list[str] = []

    def number(match: re.Match[str]) -> str:
        titles.append(re.sub(r"<.*?>", "", match[1]))
        return f'<h2 id="part-{len(titles)}">{match[1]}</h2>'

    body = re.sub(r"<h2[^>]*>(.*?)</h2>", number, body, flags=re.DOTALL)
    links = "".join(f'<a href="#part-{part}">{text}</a>' for part, text in enumerate(titles, start=1))
    title = html.escape(f"{summary.name} - {summary.kind} report")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title>\n<style>\n{STYLE}</style></head>\n"
        f"<body><nav>{links}</nav><main>\n{body}\n</main></body></html>\n"
    )


def _replace(path: Path, text: str) -> None:
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
