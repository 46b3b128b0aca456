"""`plan` takes a measurement or its results, whichever instrument it is of."""

import json
import shutil
from pathlib import Path

import pytest

from heliogauge.errors import InputError
from heliogauge.instruments import instruments
from heliogauge.results.folder import Summary, hash_files, read_summary, write_summary
from heliogauge.results.measured_folder import measured_folder, seen_from
from heliogauge.running import cli
from heliogauge.running.either_folder import measurement_of, planned_from

#: What makes the measurement of each instrument that plans, and what its plan is asked for besides.
PLANNED = {
    "beam": (("--suns", "3"), ("--most", "2")),
    "camera": ((), ("--photos", "1")),
    "deflectometry": ((), ()),
    "heliostat": ((), ()),
    "observer": ((), ()),
    "photogrammetry": ((), ()),
}
#: Those whose plan needs the measurement; the others have what they need in the results.
OF_MEASUREMENT = ("beam", "deflectometry", "observer")


def command(*words: object) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(word) for word in words])
    return int(ended.value.code or 0)


def test_all_instruments_that_plan_are_here() -> None:
    found = {one.name for one in instruments() if "plan" in cli.group_of(one).commands}
    assert found == PLANNED.keys()


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANNED)
def test_a_plan_takes_a_measurement_and_its_results(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = tmp_path / "folder", tmp_path / "out"
    made, asked = PLANNED[name]
    assert command(name, "synth", folder, *made, "--seed", 3, "-q") == 0
    assert command("measure", folder, "-o", out, "--no-report", "-q") == 0
    before = sorted(path.name for path in out.iterdir())
    for number, given in enumerate((folder, out)):
        capsys.readouterr()
        assert command(name, "plan", given, "-o", tmp_path / f"plan{number}", *asked) == 0
        is_led = given == out and name in OF_MEASUREMENT
        assert (f"measured from {folder}\n" in capsys.readouterr().err) == is_led
    assert sorted(path.name for path in out.iterdir()) == before
    if (tmp_path / "plan1" / "summary.json").is_file():
        # A plan is made again from what it was made from.
        assert command(name, "plan", tmp_path / "plan1", "-o", tmp_path / "again", *asked, "-q") == 0


def summary(folder: Path, kind: str, measured: Path | None, files: tuple[str, ...] = ()) -> Path:
    folder.mkdir(parents=True)
    origin = "" if measured is None else seen_from(measured, folder)
    hashes = {} if measured is None else hash_files([measured / name for name in files], measured)
    content = Summary(kind, "one", {"facets_count": 1}, input_sha256=hashes, measured_from=origin)
    write_summary(folder / "summary.json", content)
    return folder


def measurement(folder: Path, photo: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "measurement.toml").write_text("")
    (folder / "photo.png").write_text(photo)
    return folder


def test_results_find_what_they_were_measured_from_when_both_are_moved(tmp_path: Path) -> None:
    (tmp_path / "there" / "facet").mkdir(parents=True)
    (tmp_path / "there" / "facet" / "measurement.toml").write_text("")
    out = summary(tmp_path / "there" / "results" / "facet", "deflectometry", tmp_path / "there" / "facet")
    plan = summary(tmp_path / "there" / "plan", "deflectometry-plan", out)
    assert planned_from(plan) == out
    shutil.move(tmp_path / "there", tmp_path / "here")
    for given in ("facet", "results/facet", "plan"):
        assert measurement_of(tmp_path / "here" / given) == tmp_path / "here" / "facet"
    shutil.rmtree(tmp_path / "here" / "facet")
    with pytest.raises(Exception, match=r"were measured from .*here/facet, which is not there"):
        measured_folder(tmp_path / "here" / "results" / "facet")


@pytest.mark.parametrize("kind", ["deflectometry", "deflectometry-plan"])
def test_results_beside_another_measurement_do_not_take_it_for_theirs(kind: str, tmp_path: Path) -> None:
    """Two facets under one measurement.toml: what differs is a photo."""
    sites = [measurement(tmp_path / name / "facet", name) for name in ("here", "there")]
    out = summary(tmp_path / "here" / "out", kind, sites[0], ("measurement.toml", "photo.png"))
    assert measured_folder(out) == sites[0]
    other = shutil.copytree(out, tmp_path / "there" / "out")
    message = r"there/out: .*there/facet, whose photo\.png is another .*give the measurement folder itself"
    with pytest.raises(InputError, match=message):
        measured_folder(other)
    (sites[1] / "photo.png").write_text("here")
    assert measured_folder(other) == sites[1]


def test_results_beside_a_folder_without_their_files_do_not_take_it_for_theirs(tmp_path: Path) -> None:
    site = measurement(tmp_path / "facet", "photo")
    out = summary(tmp_path / "out", "deflectometry", site, ("photo.png",))
    (site / "photo.png").unlink()
    with pytest.raises(InputError, match=r"facet, which holds none of the files .*give the measurement folder itself"):
        measured_folder(out)


@pytest.mark.parametrize("said", ["/", "//server/share", "\\\\server\\share\\m", "C:\\m", "c:m"])
def test_results_of_a_stranger_lead_to_no_place_of_their_choice(said: str, tmp_path: Path) -> None:
    write_summary(tmp_path / "summary.json", Summary("deflectometry", "one", {"facets_count": 1}, measured_from=said))
    with pytest.raises(InputError, match=r"an absolute path .*give the measurement folder itself"):
        measured_folder(tmp_path)


def test_names_of_a_stranger_are_not_read_elsewhere(tmp_path: Path) -> None:
    site = measurement(tmp_path / "facet", "photo")
    out = summary(tmp_path / "out", "deflectometry", site, ("photo.png",))
    content = json.loads((out / "summary.json").read_text())
    content["input_sha256"] |= {"../out/summary.json": "0" * 64, str(out / "summary.json"): "0" * 64}
    (out / "summary.json").write_text(json.dumps(content))
    assert measured_folder(out) == site


def test_results_of_earlier_versions_are_read(tmp_path: Path) -> None:
    out = summary(tmp_path / "out", "deflectometry", None)
    content = json.loads((out / "summary.json").read_text())
    del content["measured_from"]
    (out / "summary.json").write_text(json.dumps(content))
    assert read_summary(out).measured_from == ""
    with pytest.raises(Exception, match="do not say what they were made from; give the measurement folder"):
        measurement_of(out)


@pytest.mark.parametrize("words", [("check",), ("beam", "measure"), ("photogrammetry", "measure")])
def test_no_message_advises_to_write_into_results(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = summary(tmp_path / "out", "beam", tmp_path)
    more = () if words == ("check",) else ("-o", tmp_path / "new")
    assert command(*words, out, *more) == 2
    said = capsys.readouterr().err
    assert "results, not a measurement; give the folder that was measured" in said
    assert "init" not in said


@pytest.mark.parametrize("name", ["camera", "heliostat"])
def test_a_measurement_of_another_kind_is_not_evaluated_first(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "beams"
    folder.mkdir()
    (folder / "measurement.toml").write_text('kind = "beam"\n')
    assert command(name, "plan", folder, "-o", tmp_path / "plan") == 2
    said = capsys.readouterr().err
    assert f'{folder}: a measurement of the kind "beam"; one of "{name}", or its results, is needed' in said
    assert not (tmp_path / "plan").exists()


@pytest.mark.parametrize("words", [("report",), ("view", "--no-browser")])
def test_a_measurement_in_place_of_results_is_sent_to_its_evaluation(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "measurement.toml").write_text('kind = "beam"\n')
    assert command(*words, tmp_path) == 2
    assert capsys.readouterr().err == (
        f"heliogauge: {tmp_path}: a measurement, not results; evaluate it first with "
        f"`heliogauge measure {tmp_path} -o OUT`, in Python with `hg.measure`\n"
    )


def test_results_without_a_report_say_where_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = summary(tmp_path / "plan", "beam-plan", None)
    (out / "plan.csv").touch()
    assert command("report", out) == 2
    assert capsys.readouterr().err == (
        f"heliogauge: {out}: results of the kind 'beam-plan' have no report; all of them is in plan.csv, summary.json\n"
    )
