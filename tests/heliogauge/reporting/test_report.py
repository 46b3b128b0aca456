"""The report: one self-contained page that says what the files say, warnings first."""

import math
import re
from dataclasses import replace
from pathlib import Path

import nbformat
import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.instruments import instruments, read_resource
from heliogauge.reporting import page
from heliogauge.reporting.build import build_report
from heliogauge.reporting.notebook import read_notebook
from heliogauge.reporting.uncertainty import uncertainty_shares
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import (
    PhotoPose,
    Summary,
    write_cameras_json,
    write_pixels,
    write_slope_map,
    write_summary,
    write_table_csv,
)
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes
from heliogauge.slopes.statistics import statistics
from heliogauge.view.arrays import PAGE
from heliogauge.view.tables import TableColumn, TableView
from tests.kernel import read, run_in_jupyter

FOCAL_M = 10.0
WARNING = Doubt("measured_share_low", "2.0 % of the mirror was not measured <saturated>")


def make_map() -> SlopeMap:
    """A paraboloid with noise, a wave, a hole and common modes of three sources."""
    rng = np.random.default_rng(1)
    x_m, y_m = np.linspace(-0.6, 0.6, 90), np.linspace(-0.4, 0.4, 60)
    x, y = np.meshgrid(x_m, y_m)
    flags = np.where(np.hypot(x - 0.2, y) < 0.08, np.uint32(SampleFlag.SATURATED), np.uint32(0))
    sigma = np.full(x.shape, 2e-5)
    design = (x / (2 * FOCAL_M), y / (2 * FOCAL_M))
    errors = (4e-4 * np.sin(6 * x), np.zeros(x.shape))
    slopes = [np.where(flags, np.nan, d + e + rng.normal(0, sigma)) for d, e in zip(design, errors, strict=True)]
    common = CommonModes(("mirror pose", "mirror pose", "camera"), rng.normal(0, 2e-5, (3, 2, 3)), np.zeros(2), 0.6)
    height = (x**2 + y**2) / (4 * FOCAL_M) - 4e-4 / 6 * np.cos(6 * x)
    return SlopeMap(
        x_m,
        y_m,
        *slopes,
        *design,
        sigma,
        sigma,
        1.0,
        common,
        height,
        flags,
        np.ones(x.shape, bool),
        "paraboloid, f = 10 m",
        "facet",
        "nothing",
    )


def make_summary(slope_map: SlopeMap) -> Summary:
    result = statistics(slope_map)
    return Summary(
        kind="deflectometry",
        name="Facet 7 & friends",
        numbers={
            "sdx_rad": result.sdx_rad,
            "sigma_sdx_rad": result.sigma_sdx_rad,
            "measured_share": slope_map.measured_share,
            "focal_length_x_m": None,
        },
        texts={"mounting orientation": "hanging, face down"},
        doubts=(WARNING,),
        durations_s={"read images": 0.4, "slopes": 0.3},
        input_sha256={"fringe_00.png": "ab" * 32},
        not_determined={"focal_length_x_m": "left out here"},
        geometry_m={
            "camera": [0.4, 0.3, 9.6],
            "camera_axis": [-0.4, -0.3, -9.6],
            "screen": [[-2, -1, 8], [2, -1, 8.5], [2, 1.5, 9]],
            "mirror": [[-0.6, -0.4, 0], [0.6, -0.4, 0], [0.6, 0.4, 0]],
        },
    )


def write_results(folder: Path) -> SlopeMap:
    slope_map = make_map()
    write_slope_map(folder / "slope_map.nc", {"": slope_map})
    write_summary(folder / "summary.json", make_summary(slope_map))
    write_pixels(folder / "pixels.nc", {"modulation_dn": np.full((30, 40), 80.0), "u": np.full((30, 40), 0.5)})
    pose = PhotoPose("camera", RigidTransform.from_rotation_vector([3.1, 0, 0], [0, 0, 9.6]), np.eye(6) * 1e-8, 0.07)
    write_cameras_json(folder / "cameras.json", {"camera": Camera(40, 30, 90, 90, 19.5, 14.5)}, {"mirror": pose})
    columns = {name: [1.0, 2.0, 5.0] for name in ("x_px", "y_px", "residual_x_px", "residual_y_px")}
    write_table_csv(folder / "outline.csv", columns)
    return slope_map


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of results with its report."""
    folder = tmp_path_factory.mktemp("results")
    write_results(folder)
    build_report(folder)
    return folder


@pytest.fixture(scope="module")
def text(folder: Path) -> str:
    """The page without the bytes of its images."""
    whole = (folder / "report.html").read_text(encoding="utf-8")
    whole = re.sub(r"<script.*?</script>", "", whole, flags=re.DOTALL)
    return re.sub(r"data:image/svg\+xml,[^\"]+", "IMAGE", whole)


@pytest.mark.slow
def test_the_page_loads_nothing_from_elsewhere(text: str) -> None:
    # An empty icon: browsers would ask a server for one.
    text = text.replace('<link rel="icon" href="data:,">', "")
    assert not re.search(r"""(?:src|href)=["']?(?:https?:)?//|//cdn|<link|@import|url\((?!data:|#)""", text)
    assert "default-src 'none'" in text
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert sources
    assert all(source == "IMAGE" or source.startswith("#") for source in sources)


@pytest.mark.slow
def test_the_page_has_many_figures_and_no_code(text: str) -> None:
    assert text.count('src="IMAGE"') >= 12
    for image in re.findall(r"<img [^>]*>", text):
        assert re.search(r'alt="[^"]{8,}"', image)
    assert "import " not in re.sub(r"<[^>]*>", "", text)
    assert "Traceback" not in text
    assert "not traced" not in text


@pytest.mark.slow
def test_doubts_come_before_every_figure(text: str) -> None:
    assert text.index("2.0 % of the mirror was not measured &lt;saturated&gt;") < text.index("IMAGE")


@pytest.mark.slow
def test_the_page_says_what_the_files_say(text: str) -> None:
    result = statistics(make_map())
    shown = page.number_text(result.sdx_rad, result.sigma_sdx_rad, "rad")
    assert " \u00b1 " in shown
    for words in (
        shown,
        "Facet 7 &amp; friends",
        "not determined: left out here",
        "paraboloid, f = 10 m",
        "hanging, face down",
        "read images",
        "fringe_00.png",
        "ab" * 32,
        "at least one frame saturated",
        "200000 rays",
        "0.070 px",
    ):
        assert words in text, words


@pytest.mark.slow
def test_every_section_is_linked(text: str) -> None:
    links = re.findall(r'<a href="#([a-z0-9-]+)">([^<]+)</a>', text.partition("<main>")[0])
    assert len(links) >= 8
    assert len({mark for mark, _ in links}) == len(links)
    for mark, words in links:
        assert f'<h2 id="{mark}">{words}</h2>' in text


@pytest.mark.slow
def test_the_notebook_is_kept_with_its_outputs_and_nothing_else_is_left(folder: Path) -> None:
    notebook = read(folder / "report.ipynb")
    silent = [cell for cell in notebook.cells if cell.cell_type == "code" and not cell.outputs]
    # The cell that says where the results are, and the table of facets of a mirror without facets shows nothing.
    assert silent[0].metadata.tags == ["folder"]
    assert len(silent) == 1
    own = {"report.html", "report.ipynb"}
    results = {"summary.json", "slope_map.nc", "pixels.nc", "cameras.json", "outline.csv"}
    assert {path.name for path in folder.iterdir()} == own | results


@pytest.mark.slow
def test_the_notebook_runs_as_it_is_in_jupyter(folder: Path, repository: Path) -> None:
    kept = read(folder / "report.ipynb")
    again = run_in_jupyter(read(folder / "report.ipynb"), folder, repository)
    for before, after in zip(kept.cells, again.cells, strict=True):
        assert [one.data.get("text/html") for one in before.get("outputs", ())] == [
            one.data.get("text/html") for one in after.get("outputs", ())
        ]


@pytest.mark.slow
def test_damaged_results_are_named(tmp_path: Path) -> None:
    write_results(tmp_path)
    (tmp_path / "slope_map.nc").unlink()
    with pytest.raises(InputError, match=r"slope_map\.nc"):
        build_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_folders_without_a_report_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"summary\.json"):
        build_report(tmp_path)
    write_summary(tmp_path / "summary.json", replace(make_summary(make_map()), kind="astrology"))
    with pytest.raises(InputError, match="astrology"):
        build_report(tmp_path)


@pytest.mark.parametrize("file", [file for one in instruments() for file in one.reports.values()])
def test_the_notebook_in_the_package_is_clean_and_short(file: str) -> None:
    notebook = nbformat.reads(read_resource(file), as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        assert len(cell.source.splitlines()) <= 14
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


@pytest.mark.parametrize("file", [file for one in instruments() for file in one.reports.values()])
def test_every_report_has_the_doubts_that_its_verdict_leads_to(file: str) -> None:
    cells = nbformat.reads(read_resource(file), as_version=4).cells
    (title,) = [number for number, cell in enumerate(cells) if cell.source.startswith("## Doubts")]
    assert re.fullmatch(r"(page|report)\.doubts(_box|_of)?\((\w+)\)", cells[title + 1].source)


def test_sections_without_content_are_left_out(tmp_path: Path) -> None:
    cells = [
        nbformat.v4.new_markdown_cell("## Kept"),
        nbformat.v4.new_code_cell("from heliogauge.reporting.html import Html as Shown; NOTHING = Shown(''); NOTHING"),
        nbformat.v4.new_markdown_cell("Of a table that is not there."),
        nbformat.v4.new_code_cell("NOTHING"),
        nbformat.v4.new_markdown_cell("Of a table that is there."),
        nbformat.v4.new_code_cell("Shown('<p>table</p>')"),
        nbformat.v4.new_markdown_cell("## Empty\n\nSaid of nothing."),
        nbformat.v4.new_code_cell("NOTHING"),
        nbformat.v4.new_code_cell("Shown('<h2>Own heading</h2><p>part</p>')"),
        nbformat.v4.new_markdown_cell("## Empty too"),
        nbformat.v4.new_code_cell("NOTHING"),
        nbformat.v4.new_markdown_cell("## Words\n\nA glossary."),
    ]
    notebook = read_notebook(nbformat.writes(nbformat.v4.new_notebook(cells=cells)))
    notebook.run(tmp_path, PAGE)
    shown = " ".join(re.sub(r"<[^>]*>", " ", one.html).strip() for one in notebook.shown)
    words = "Kept Of a table that is there. table Own heading part Words A glossary."
    assert " ".join(shown.split()) == words


def test_words_between_backticks_are_code(tmp_path: Path) -> None:
    doubt = Doubt("canting", "open; `beam plan <x>` says which")
    summary = replace(make_summary(make_map()), doubts=(doubt,))
    write_summary(tmp_path / "summary.json", summary)
    assert "<code>beam plan &lt;x&gt;</code> says" in page.doubts_of(tmp_path).text
    short = replace(summary, doubts=(Doubt("canting", "see `beam plan`"),))
    assert "see <code>beam plan</code></a>" in page.verdict_box(verdict_of(short)).text
    assert "<td>see <code>beam plan</code></td>" in page.table(("",), [["see `beam plan`"]]).text


def test_every_link_of_a_verdict_leads_to_a_place_among_the_doubts(tmp_path: Path) -> None:
    note = Doubt("small", "the result is as good as its camera", severity=Severity.NOTE)
    summary = replace(make_summary(make_map()), doubts=(WARNING, note))
    write_summary(tmp_path / "summary.json", summary)
    links = set(re.findall(r'href="#([^"]+)"', page.verdict_box(verdict_of(summary)).text))
    shown = page.doubts_of(tmp_path).text
    assert links == {"doubt-1", "all-doubts"}
    assert links < set(re.findall(r'id="([^"]+)"', shown))
    assert "as good as its camera" in shown


@pytest.mark.parametrize(
    ("value", "sigma", "unit", "name", "expected"),
    [
        (1.23456e-3, 1.2e-6, "rad", "sdx", "1.2346 \u00b1 0.0012 mrad"),
        (9.9876, 0.34, "m", "focal_length_x", "9.99 \u00b1 0.34 m"),
        (9.9876, 12.0, "m", "focal_length_x", "10 \u00b1 12 m"),
        (0.0123, None, "m", "miss", "12.3 mm"),
        (0.07, 0.0, "px", "residual", "0.07 px"),
        (0.98765, None, "", "measured_share", "98.77 %"),
        (16, None, "", "frames_count", "16"),
        (-2.5e-3, math.nan, "rad", "mean_x", "-2.5 mrad"),
    ],
)
def test_numbers_are_printed_to_the_digits_of_their_sigma(
    value: float, sigma: float | None, unit: str, name: str, expected: str
) -> None:
    assert page.number_text(value, sigma, unit, name) == expected


def test_no_warnings_are_said_too(tmp_path: Path) -> None:
    write_results(tmp_path)
    results = page.open_results(tmp_path)
    assert '<li class="doubt" id="doubt-1">' in page.doubts_box(results).text
    calm = replace(results, summary=replace(results.summary, doubts=()))
    assert "nothing" not in page.doubts_box(results).text
    assert "No check found anything" in page.doubts_box(calm).text


def test_shares_of_the_uncertainty_add_up() -> None:
    slope_map = make_map()
    shares = uncertainty_shares(slope_map)
    assert list(shares) == ["random noise", "mirror pose", "camera"]
    for axis, sigma in enumerate(slope_map.sigma_slope()):
        total = np.sqrt(np.mean(sigma[slope_map.valid] ** 2))
        assert math.hypot(*(share[axis] for share in shares.values())) == pytest.approx(total, rel=1e-12)
    assert list(uncertainty_shares(replace(slope_map, common=no_common_modes()))) == ["random noise"]


def test_the_table_of_removals_says_what_was_removed_before_once() -> None:
    before = "mean tilt, by turning the frame"
    text = page.statistics_table(replace(make_map(), removed=before)).text
    assert text.count(before) == 1
    assert text.count("<tr>") == 5


def test_what_the_nodes_do_not_determine_is_said_in_its_row() -> None:
    whole = make_map()
    flags = np.where(np.arange(whole.flags.shape[0])[:, None] == 30, whole.flags, np.uint32(SampleFlag.SATURATED))
    line = replace(
        whole, flags=flags, **{name: np.where(flags, np.nan, getattr(whole, name)) for name in ("slope_x", "slope_y")}
    )
    text = page.statistics_table(line).text
    assert text.count("<tr>") == 5
    assert "lie on a line" in text


@pytest.mark.parametrize(("count", "kind"), [(7, "table"), (8, "table wide")])
def test_tables_too_wide_for_a_printed_line_are_printed_smaller(count: int, kind: str) -> None:
    column = TableColumn("theta_r [mrad]", ["0.12 \u00b1 0.02", "-0.12 \u00b1 0.02"], [0.12, -0.12])
    # Twelve characters and 1.5 of space: seven columns take 94.5 and eight 108, where 106 have room.
    assert TableView("panels", (column,) * count)._repr_html_().startswith(f'<div class="{kind}">')
    sentence = TableColumn("effect", ["x" * 300, ""])
    assert TableView("effects", (column, sentence))._repr_html_().startswith('<div class="table">')


def test_tables_escape_what_they_show() -> None:
    assert "<b>" not in page.table(("a",), [("<b>",)]).text
