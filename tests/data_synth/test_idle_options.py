"""Options that a preset has no use for are refused; none is passed over."""

import csv

import pytest
from typer.testing import CliRunner

from data_synth.heliostats.presets import HeliostatChoice, heliostat_scene
from heliogauge.errors import InputError
from heliogauge.running import cli


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["heliostat", "--preset", "tests", "--heliostats", "2"], "--heliostats"),
        (["heliostat", "--preset", "tests", "--fault", "drift"], "--fault"),
        (["heliostat", "--preset", "drone", "--wind-mrad", "0.2"], "--wind-mrad"),
        (["heliostat", "--preset", "images", "--spot-sigma-mm", "3"], "--spot-sigma-mm"),
        (["heliostat", "--preset", "images-lens", "--outliers", "0.1"], "--outliers"),
        *(
            (["deflectometry", "--preset", preset, "--noise-dn", "2"], "--noise-dn")
            for preset in ("tower", "laser-scan", "line-sweep", "gazing", "gazing-close", "stars")
        ),
        (["deflectometry", "--preset", "overlay", "--poses", "2"], "--poses"),
        (["deflectometry", "--preset", "screen-dots", "--gamma", "2"], "--gamma"),
        (["deflectometry", "--preset", "screen-rims", "--steps", "8"], "--steps"),
        (["deflectometry", "--preset", "surface-scan", "--dots", "light"], "--dots"),
        (["deflectometry", "--dots", "light", "--periods", "0.9,3.9"], "--periods"),
        (["deflectometry", "--dots", "light", "--width-error-percent", "1"], "--width-error-percent"),
        (["photogrammetry", "--sigma-px", "0.1"], "--sigma-px"),
        (["photogrammetry", "--points-only", "--blur-px", "1"], "--blur-px"),
        (["photogrammetry", "--preset", "retro", "--light-on-dark"], "--light-on-dark"),
        (["photogrammetry", "--preset", "markers", "--cross", "0.2"], "--cross"),
        (["observer", "--tilt-mrad", "1"], "--tilt-mrad"),
        (["observer", "--preset", "far", "--dictionary", "circles"], "--dictionary"),
        (["observer", "--preset", "absorber", "--photos", "4"], "--photos"),
        (["observer", "--preset", "displaced", "--shaped"], "--shaped"),
    ],
)
def test_an_option_without_effect_is_refused(tmp_path, capsys, arguments, option):
    instrument, *rest = arguments
    with pytest.raises(SystemExit) as stop:
        cli.main([instrument, "synth", str(tmp_path / "m"), *rest])
    assert stop.value.code == 2
    assert f"has no use for {option}; leave it out" in capsys.readouterr().err
    assert not (tmp_path / "m").exists()


def test_twenty_heliostats_are_seen_by_a_drone_and_the_first_is_the_published_one(tmp_path):
    answer = CliRunner().invoke(
        cli.app, ["heliostat", "synth", str(tmp_path / "m"), "--preset", "drone", "--heliostats", "20", "-q"]
    )
    assert answer.exit_code == 0, answer.output
    with (tmp_path / "m" / "observations.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len({row["heliostat"] for row in rows}) == 20
    assert len(rows) == 20 * 60
    alone, several = (heliostat_scene("drone", HeliostatChoice(4, count)) for count in (None, 20))
    assert alone.units[0].true.values == several.units[0].true.values
    assert len({tuple(unit.true.position_m) for unit in several.units}) == 20


def test_what_a_scene_cannot_have_is_refused():
    with pytest.raises(InputError, match="heliostats=3: preset 'stellenbosch' is the one that was published"):
        heliostat_scene("stellenbosch", HeliostatChoice(0, 3))
    for fault in ("drift", "backlash", "local-time", "duplicates"):
        with pytest.raises(InputError, match="preset 'drone' does not show it"):
            heliostat_scene("drone").with_faults((fault,))
    with pytest.raises(InputError, match="preset 'images' does not show it"):
        heliostat_scene("images").with_faults(("outliers",))
    assert heliostat_scene("drone").with_faults(("moved",)).units[0].faults == ("moved",)
