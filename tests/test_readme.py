"""The front page: short, and every command on it runs as it stands there."""

import json
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from PIL import Image

README = Path(__file__).parents[1] / "README.md"


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", README.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def run(command: str, folder: Path) -> str:
    """Run a line of the front page with this very installation; what serves pages is stopped when it has begun."""
    scripts = sysconfig.get_path("scripts")
    surroundings = os.environ | {"PATH": os.pathsep.join((scripts, os.environ["PATH"])), "COLUMNS": "400"}
    words = command.replace("heliogauge", f"{sys.executable} -m heliogauge", 1)
    if command.startswith("heliogauge view"):
        words = f"exec {words} --no-browser"
        with subprocess.Popen(
            words, shell=True, cwd=folder, env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as served:
            assert served.stdout is not None
            said = served.stdout.readline()
            # Not SIGINT: a test run started in the background hands down an ignored one.
            served.terminate()
        assert "http://127.0.0.1:" in said
        return said
    done = subprocess.run(
        words, check=False, shell=True, cwd=folder, env=surroundings, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, f"{command}: {done.stderr}"
    return done.stderr + done.stdout


def test_it_is_one_page() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_its_links_lead_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README.read_text(encoding="utf-8"))
    missing = [link for link in links if "://" not in link and not (README.parent / link).exists()]
    assert len(links) > 15
    assert not missing


def test_make_has_the_two_commands() -> None:
    makefile = (README.parent / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make (\w+)", README.read_text(encoding="utf-8"), re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the first commands of the page ran: they need no data."""
    folder = tmp_path_factory.mktemp("readme")
    for command in blocks("sh")[0].splitlines():
        run(command, folder)
    return folder


def test_the_real_measurement_has_at_most_one_warning() -> None:
    """The listing itself is compared with what the program says by the test of pages."""
    (listing,) = blocks("console")
    measured = listing[listing.rindex("$ ") :]
    assert "--sigmas laboratory" in listing
    assert len(re.findall(r"^(?:warning|serious):", measured, re.MULTILINE)) <= 1


@pytest.mark.slow
def test_its_drawn_measurement_needs_no_data(drawn: Path) -> None:
    assert (drawn / "drawn-result" / "report.html").is_file()


@pytest.mark.slow
def test_its_picture_shows_the_numbers_of_today(drawn: Path) -> None:
    """To draw it anew: python docs/images/render_report.py."""
    with Image.open(README.parent / "docs" / "images" / "report.png") as picture:
        printed = dict(line.strip().split(" = ") for line in picture.text["numbers"].splitlines())
    numbers = json.loads((drawn / "drawn-result" / "summary.json").read_text())["numbers"]
    assert len(printed) == 4
    for name, text in printed.items():
        value, sigma = map(float, text.split(" +- "))
        assert numbers[name] == pytest.approx(value, rel=1e-3)
        assert numbers[f"sigma_{name}"] == pytest.approx(sigma, rel=0.1)
