"""The viewer's server: results to this machine alone, nothing else to nobody."""

import http.client
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.results.folder import write_slope_map
from heliogauge.slopes.map import SlopeMap
from heliogauge.view.server.opened import NotServedError, Opened, open_place
from heliogauge.view.server.serving import Viewer
from heliogauge.view.server.site import Site
from tests.heliogauge.view.served_results import Asker, serve, slope_map, write_result


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results beside a file that is nobody's business."""
    above = tmp_path_factory.mktemp("above")
    (above / "secret.csv").write_text("secret")
    folder = above / "results"
    write_result(folder / "before", "<b>Mirror</b> 7", slope_map(), 2e-3)
    write_result(folder / "season" / "after", "Mirror 7 again", slope_map(1e-3, seed=2), 1e-3)
    (folder / "before" / "report.html").write_text("<script>alert(1)</script>")
    (folder / "before" / "page.html").write_text("<script>alert(1)</script>")
    (folder / "before" / "points.csv").write_text("id,x_m\n1,2\n")
    (folder / "before" / ".hidden.csv").write_text("hidden")
    (folder / "before" / "leads_out.csv").symlink_to(above / "secret.csv")
    (folder / "leads_out").symlink_to(above)
    return folder


@pytest.fixture(scope="module")
def asker(results: Path) -> Iterator[Asker]:
    yield from serve(results)


def test_only_this_machine_can_connect(results: Path) -> None:
    viewer = Viewer(Site([open_place(results)]))
    assert viewer.server_address[0] == "127.0.0.1"
    assert len(re.fullmatch(r"http://127\.0\.0\.1:\d+/(.+)/", viewer.address)[1]) >= 32
    other = Viewer(Site([open_place(results)]))
    assert other.token != viewer.token
    with pytest.raises(InputError, match="--port"):
        Viewer(Site([open_place(results)]), viewer.server_port)
    viewer.server_close()
    other.server_close()


def test_the_first_page_leads_to_the_table_of_results(asker: Asker) -> None:
    status, _, headers = asker.ask(asker.base)
    assert (status, headers["Location"]) == (302, f"{asker.base}1/")
    status, body = asker.page("1/")
    assert status == 200
    assert 'href="before/report.html">&lt;b&gt;Mirror&lt;/b&gt; 7</a>' in body
    assert 'href="season/after/report.html">Mirror 7 again</a>' in body
    assert "2.000 ± 0.010 mrad" in body
    assert "1 doubt" in body
    assert "90.00 %" in body
    assert 'class="cell print"' in body
    assert "<b>Mirror" not in body
    assert "http" not in re.sub(r"http://www.w3.org\S*", "", body)


@pytest.mark.parametrize("token", ["", "x", "wrong" * 8, "%00"])
def test_without_the_word_nothing_is_said(asker: Asker, token: str) -> None:
    status, body, _ = asker.ask(f"/{token}/1/before/points.csv")
    assert status == 403
    assert "id" not in body.split()


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "evil.example:{port}"},
        {"Host": "127.0.0.1:{port}.evil.example"},
    ],
)
def test_other_names_of_this_machine_are_refused(asker: Asker, headers: Mapping[str, str]) -> None:
    """A page whose host name is made to lead here must not read results."""
    sent = {name: value.format(port=asker.port) for name, value in headers.items()}
    assert asker.ask(f"{asker.base}1/before/points.csv", headers=sent)[0] == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_its_own_names_are_served(asker: Asker, host: str) -> None:
    status, body, headers = asker.ask(f"{asker.base}1/before/points.csv", headers={"Host": f"{host}:{asker.port}"})
    assert (status, body) == (200, "id,x_m\n1,2\n")
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert "'none'" in headers["Content-Security-Policy"]


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE", "PROPFIND"])
def test_only_reading_is_served(asker: Asker, method: str) -> None:
    status, _, headers = asker.ask(f"{asker.base}1/before/points.csv", method)
    assert (status, headers["Allow"]) == (405, "GET, HEAD")


@pytest.mark.parametrize(
    "address",
    [
        "1/../secret.csv",
        "1/%2e%2e/secret.csv",
        "1/before/../../secret.csv",
        "1/before/..%2f..%2fsecret.csv",
        "1/%252e%252e/secret.csv",
        "1/..%5csecret.csv",
        "1//etc/passwd",
        "1/%2fetc%2fpasswd",
        "1/before/leads_out.csv",
        "1/leads_out/secret.csv",
        "1/before/.hidden.csv",
        "1/before/page.html",
        "1/before/points.csv%00",
        "2/",
        "0/before/points.csv",
        "3",
        "difference?first=1/../&second=1/before/",
    ],
)
def test_nothing_else_is_served(asker: Asker, address: str) -> None:
    status, body = asker.page(address)
    assert status == 404
    assert "secret\n" not in body
    assert "alert" not in body
    assert "root:x" not in body


def test_a_report_that_lies_there_is_never_handed_out(asker: Asker) -> None:
    """It may come from anyone, and its scripts could read all results."""
    assert "alert(1)" not in asker.page("1/before/report.html")[1]


def test_a_result_with_a_link_out_of_it_is_refused(asker: Asker) -> None:
    status, body = asker.page("1/before/")
    assert status == 422
    assert "leads_out.csv" in body


def test_a_link_to_itself_is_named(tmp_path: Path) -> None:
    write_result(tmp_path / "one", "Mirror", slope_map(), 1e-3)
    (tmp_path / "one" / "loop.csv").symlink_to("loop.csv")
    with pytest.raises(InputError, match=r"loop.csv: cannot be read .*remove it"):
        Site([open_place(tmp_path / "one")]).answer("1/", {})


def test_a_map_keeps_all_its_nodes_beside_the_page(tmp_path: Path) -> None:
    one = slope_map(nodes=450)
    write_slope_map(tmp_path / "slope_map.nc", {"": one})
    (tmp_path / "other.csv").write_text("1")
    for asker in serve(tmp_path / "slope_map.nc"):
        status, body = asker.page("1/")
        assert status == 200
        spec = json.loads(re.search(r'<script type="application/json">(.*?)</script>', body, re.DOTALL)[1])
        assert spec["nodes"] == [450, 450]
        assert len(spec["x"]) == 450
        place = spec["layers"][0]["values"]["place"]
        address = spec["arrays"][place]["url"]
        connection = http.client.HTTPConnection("127.0.0.1", asker.port, timeout=60)
        connection.request("GET", address)
        values = np.frombuffer(connection.getresponse().read(), "<f4").reshape(spec["arrays"][place]["shape"])
        connection.close()
        np.testing.assert_allclose(values[one.valid], one.slope_error_x[one.valid], rtol=1e-6)
        assert np.isnan(values[~one.valid]).all()
        assert asker.ask(f"{address}9")[0] == 404
        assert asker.page("1/other.csv")[0] == 404
        # The page that is open belongs to files that are no longer there.
        write_slope_map(tmp_path / "slope_map.nc", {"": slope_map(nodes=451)})
        assert asker.ask(address)[0] == 404
        assert "451" in asker.page("1/")[1]


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
def test_a_folder_shows_no_result_that_a_link_leads_to(tmp_path: Path) -> None:
    write_result(tmp_path / "outside", "nobody's business", None)
    write_result(tmp_path / "in" / "a", "own", None)
    (tmp_path / "in" / "b").mkdir()
    (tmp_path / "in" / "b" / "summary.json").symlink_to(tmp_path / "outside" / "summary.json")
    for asker in serve(tmp_path / "in"):
        body = asker.page("1/")[1]
        assert "own" in body
        assert "nobody" not in body


def test_a_difference_of_numbers_alone_is_made_anew_when_they_change(tmp_path: Path) -> None:
    for name, sdx_rad in (("a", 1e-3), ("b", 2e-3)):
        write_result(tmp_path / name, name, None, sdx_rad)
    for asker in serve(tmp_path):
        assert "2.000 \u00b1 0.010 mrad" in asker.page("difference?first=1/a/&second=1/b/")[1]
        shutil.rmtree(tmp_path / "b")
        write_result(tmp_path / "b", "b", None, 3e-3)
        assert "3.000 \u00b1 0.010 mrad" in asker.page("difference?first=1/a/&second=1/b/")[1]


def test_the_difference_is_the_tilt_between_two_results(tmp_path: Path) -> None:
    """RMS from the tilt that was put in; the joint sigma is sqrt(2) of one."""
    write_result(tmp_path / "before", "before", slope_map(), 2e-3)
    write_result(tmp_path / "after", "after", slope_map(1e-3, seed=2), 1e-3)
    for asker in serve(tmp_path / "before", tmp_path / "after"):
        target = asker.ask(asker.base)[2]["Location"]
        status, body, _ = asker.ask(target)
        assert status == 200
        assert re.search(r"RMS difference of dz/dx.{0,120}alone: 0\.02828 mrad; mean (1\.00|0\.999)", body)
        assert re.search(r"<td>(1\.00\d?|1|0\.999\d?) mrad</td>", body)
        assert "-1.000 ± 0.014 mrad" in body
        assert '"name":"Difference of dz/dx"' in body
        assert '"name":"Joint sigma of dz/dx"' in body
        # All of it is there on paper.
        assert body.count('class="cell print"') > 4
        assert 'class="cell"' not in body
        assert f'href="{asker.base}1/"' in body
        assert f'href="{asker.base}2/"' in body


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (replace(slope_map(), frame="trough"), "different frames.*facet.*trough"),
        (replace(slope_map(), design="paraboloid of focal length 10 m"), "different designs.*flat.*paraboloid"),
        (replace(slope_map(), flags=np.full((40, 40), int(SampleFlag.SATURATED))), "no node"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_serving(tmp_path: Path, other: SlopeMap, words: str) -> None:
    write_result(tmp_path / "a", "a", slope_map())
    write_result(tmp_path / "b", "b", other)
    with pytest.raises(InputError, match=words):
        Site([open_place(tmp_path / "a"), open_place(tmp_path / "b")]).check()


def test_a_finer_map_is_compared_on_the_coarser_grid(tmp_path: Path) -> None:
    write_result(tmp_path / "a", "a", slope_map(nodes=79))
    write_result(tmp_path / "b", "b", slope_map(1e-3, nodes=40, seed=2))
    for asker in serve(tmp_path / "a", tmp_path / "b"):
        body = asker.page("difference?first=1/&second=2/")[1]
        assert '"nodes":[40,40]' in body


def test_what_can_be_opened(tmp_path: Path, results: Path) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        open_place(tmp_path / "absent")
    (tmp_path / "photo.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"slope_map\.nc is needed"):
        open_place(tmp_path / "photo.jpg")
    with pytest.raises(InputError, match="no results"):
        Site([open_place(tmp_path)]).check()
    assert open_place(results / "before" / "summary.json") == Opened(results / "before")
    with pytest.raises(InputError, match="3 paths"):
        Site([open_place(results)] * 3)


def test_an_opened_link_is_the_folder_it_leads_to(tmp_path: Path, results: Path) -> None:
    (tmp_path / "link").symlink_to(results)
    opened = open_place(tmp_path / "link")
    assert opened.find("before/points.csv").is_file()
    with pytest.raises(NotServedError, match="link"):
        opened.find("leads_out")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_until_it_is_stopped(results: Path, number: signal.Signals) -> None:
    # A test run started in the background hands down an ignored SIGINT.
    begin = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{begin}; from heliogauge.running.cli import main; main()", "view", str(results)]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [*command, "--no-browser"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        address = urlsplit(process.stdout.readline().strip())
        connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=60)
        connection.request("GET", f"{address.path}1/before/points.csv")
        answer = connection.getresponse().read()
        connection.close()
        process.send_signal(number)
        try:
            _, errors = process.communicate(timeout=30)
        finally:
            process.kill()
    assert answer == b"id,x_m\n1,2\n"
    assert "Traceback" not in errors
    assert process.returncode == {signal.SIGINT: 0, signal.SIGTERM: 143}[number]


#: A browser that keeps what others could see of it, and then looks at the page that it was told to open.
_BROWSER = """#!{python}
import json, os, re, stat, sys, urllib.request
from pathlib import Path
from urllib.parse import unquote, urlsplit

seen = {{"arguments": sys.argv[1:]}}
place = Path(unquote(urlsplit(sys.argv[1]).path))
if place.is_file():
    address = re.search('url=(http[^"]*)"', place.read_text(encoding="utf-8"))[1]
    seen |= {{
        "page": str(place),
        "modes": [stat.S_IMODE(one.stat().st_mode) for one in (place, place.parent)],
        "address": address,
    }}
Path({out!r}).with_suffix(".part").write_text(json.dumps(seen), encoding="utf-8")
os.replace(Path({out!r}).with_suffix(".part"), {out!r})
"""


@pytest.mark.skipif(os.name == "nt", reason="programs and their modes are others there")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_word_is_not_among_the_arguments_of_the_browser(
    tmp_path: Path, results: Path, number: signal.Signals
) -> None:
    """Every user of a machine reads the arguments of its processes."""
    browser, out = tmp_path / "browser", tmp_path / "seen.json"
    browser.write_text(_BROWSER.format(python=sys.executable, out=str(out)), encoding="utf-8")
    browser.chmod(0o700)
    begin = "import os, signal; os.umask(0); signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{begin}; from heliogauge.running.cli import main; main()", "view", str(results)]
    environment = os.environ | {"PYTHONUNBUFFERED": "1", "BROWSER": f"{browser} %s", "TMPDIR": str(tmp_path)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        address = process.stdout.readline().strip()
        try:
            end = time.monotonic() + 60
            while not out.is_file() and time.monotonic() < end:
                time.sleep(0.05)
            seen = json.loads(out.read_text(encoding="utf-8"))
            parts = urlsplit(seen["address"])
            connection = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=60)
            connection.request("GET", f"{parts.path}1/before/points.csv")
            answer = connection.getresponse().read()
            connection.close()
            process.send_signal(number)
            output, errors = process.communicate(timeout=30)
        finally:
            process.kill()
    word = urlsplit(address).path.strip("/")
    assert len(word) >= 32
    assert word not in " ".join(seen["arguments"])
    assert seen["address"] == address
    assert answer == b"id,x_m\n1,2\n"
    assert "paste the address" in output
    assert seen["modes"] == [0o600, 0o700]
    assert not Path(seen["page"]).parent.exists()
    assert "Traceback" not in errors
