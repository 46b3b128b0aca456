"""What a heliostat doubts its field says too, counts and links; so do a batch, and a data sheet of its tests."""

import pytest

import heliogauge as hg
from calibration.heliostat.diagnosis.findings import Diagnosis, Finding
from calibration.heliostat.files.store_diagnosis import changed_row
from calibration.heliostat.files.store_field import DOUBTS, field_row
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options, run
from data_synth.heliostats.dataset import HeliostatOptions, write_heliostat_dataset
from data_synth.heliostats.presets import HeliostatChoice, heliostat_scene
from heliogauge.doubts import Doubt, Severity, doubts_of_parts
from heliogauge.results.folder import read_table_csv


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return four heliostats without a fault; their later suns lie beyond the earlier ones."""
    place = tmp_path_factory.mktemp("children") / "field"
    write_heliostat_dataset(place, heliostat_scene("small", HeliostatChoice(3)), HeliostatOptions(3))
    return place


@pytest.fixture(scope="module")
def field(folder, tmp_path_factory):
    """Return the results of the field."""
    out = tmp_path_factory.mktemp("children") / "out"
    run_into(load_heliostat(folder), out, Options(thorough=False, jobs=1), report=True)
    return out


def test_a_field_says_what_its_heliostats_doubt(field):
    children = {name: hg.open(field / name).doubts for name in ("H01", "H02", "H03", "H04")}
    doubted = [name for name, doubts in children.items() if doubts]
    assert 0 < len(doubted) < 4
    result = hg.open(field)
    assert {one.code for one in result.doubts} == {one.code for doubts in children.values() for one in doubts}
    assert all(name in " ".join(one.text for one in result.doubts) for name in doubted)
    assert result.summary["heliostat_doubts_count"] == sum(map(len, children.values()))
    assert result.summary["without_doubt_count"] == 4 - len(doubted)


def test_its_page_is_not_sound_and_links_them(field):
    page = (field / "report.html").read_text()
    table = read_table_csv(field / "field.csv", ("heliostat", "warnings_count"))
    doubted = [name for name, count in zip(table["heliostat"], table["warnings_count"], strict=True) if int(count)]
    assert "<strong>Doubtful" in page
    assert f"{4 - len(doubted)} of 4 heliostats without fault or doubt" in page
    # From its name, and from the number of its doubts.
    assert all(page.count(f'href="{name}/report.html"') >= 2 for name in doubted)
    assert DOUBTS not in table


def test_a_batch_counts_the_doubts_of_a_field(folder, tmp_path):
    result = hg.measure_many([folder], tmp_path / "batch", jobs=1, report=False, thorough=False)
    assert int(result.tables["index"]["doubts_count"][0]) > 0
    assert [one.code for one in result.doubts] == ["measurements_doubtful"]


def test_a_diagnosis_that_others_change_changes_the_doubts_of_the_row(folder):
    (one, *_) = run(load_heliostat(folder), Options(thorough=False, jobs=1)).heliostats
    old = Diagnosis((Finding("sag", "fault", "It sags.", {}),), (), 0.01)
    new = Diagnosis((Finding("sag", "doubt", "It may sag.", {}),), (), 0.01)
    rest = Doubt("photos_few", "few photos")
    row = field_row(one) | {DOUBTS: [], "status": "faulty", "reason": "; ".join([old.doubts[0].text, rest.text])}
    row[DOUBTS] = [{"code": code, "text": "", "numbers": {}, "severity": "doubt"} for code in ("sag", "photos_few")]
    changed = changed_row(row, old, new)
    assert [one["code"] for one in changed[DOUBTS]] == ["sag", "photos_few"]
    assert "It may sag" in changed[DOUBTS][0]["text"]
    assert changed["warnings_count"] == 2


@pytest.mark.parametrize("turn", [1, -1])
def test_a_part_with_several_doubts_of_a_code_says_the_gravest(turn):
    both = [Doubt("photos_few", "3 photos only"), Doubt("photos_few", "1 photo only", severity=Severity.SERIOUS)]
    (found,) = doubts_of_parts({"A": both[::turn], "B": both[:1]}, "heliostats")
    assert found.severity is Severity.SERIOUS
    assert found.text == "2 of 2 heliostats, photos few (A, B): 1 photo only"


def test_parts_with_one_doubt_make_one_doubt_of_the_gravest_kind():
    grave = Doubt("photos_few", "1 photo only", severity=Severity.SERIOUS)
    parts = {
        "A": [Doubt("photos_few", "3 photos only")],
        "B": [grave],
        "C": [],
        "D": [Doubt("x", "n", {}, Severity.NOTE)],
    }
    (found,) = doubts_of_parts(parts, "heliostats")
    assert (found.code, found.severity) == ("photos_few", Severity.SERIOUS)
    assert found.text == "2 of 4 heliostats, photos few (A, B): 1 photo only"
    assert found.numbers == {"parts_count": 2}
