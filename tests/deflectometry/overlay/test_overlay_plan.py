"""Plans of overlays: what is promised is what drawn photos then give, and what will not be seen is named."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_synth.reflections import ReflectionScene, write_overlay
from deflectometry.overlay.keys import load_overlay_plan
from deflectometry.overlay.planning.plan import FACETS_FILE, PlannedOverlay
from deflectometry.planning.pipeline.alternatives import ALTERNATIVES_FILE, try_changes
from deflectometry.planning.prospect import Change
from deflectometry.planning.sigma_prospect import SigmaProspect
from heliogauge.doubts import Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.measurement.writer import write_measurement
from heliogauge.results.folder import read_table_csv
from heliogauge.running import cli
from heliogauge.running.progress import SilentProgress

SMALL = ReflectionScene(
    columns=2, rows=2, focal_px=3500.0, width_px=300, height_px=300, wave_sigma_rad=0.0, tilt_sigma_rad=0.3e-3
)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("overlay_plan") / "drawn"
    write_overlay(folder, replace(SMALL, subpixels=2), 1)
    return folder


def planned(drawn: Path, folder: Path, change: Callable[[dict[str, Any]], None] = lambda content: None) -> Path:
    """Write a measurement.toml alone, with other content."""
    folder.mkdir()
    content = tomllib.loads((drawn / "measurement.toml").read_text())
    content["plan"] = {"contrast_dn": SMALL.bright_dn - SMALL.dark_dn, "difference_of_photos_mrad": 0.0}
    change(content)
    write_measurement(folder, content)
    return folder


def prospect(folder: Path) -> SigmaProspect:
    return PlannedOverlay(load_overlay_plan(folder)).prospect()


def one_facet(content: dict[str, Any]) -> None:
    content["mirror"]["facet"] = content["mirror"]["facet"][:1]


def test_a_survey_makes_sure_how_the_heliostat_points(drawn: Path, tmp_path: Path) -> None:
    """All turns alike are as good as source and cameras: 3 mm each at 40 m; canting does not feel it."""
    found = prospect(planned(drawn, tmp_path / "p")).sigmas()
    # The source's place moves all turns alike by half of its angle; three cameras average.
    expected = 0.003 / (2 * 40) * np.sqrt(1 + 1 / 3)
    assert found["mean_turn_x_rad"] == pytest.approx(expected, rel=0.05)
    assert found["canting_x_rms_rad"] < 0.1 * expected


def test_facets_without_image_are_named_with_the_reason(drawn: Path, tmp_path: Path) -> None:
    def turned(content: dict[str, Any]) -> None:
        content["mirror"]["facet"][1]["rotation_vector_rad"] = [0.0, 0.05, 0.0]

    found = prospect(planned(drawn, tmp_path / "p", turned))
    (doubt,) = [one for one in found.doubts if one.code == "plan_leaves_facets_unknown"]
    assert "1 of 4 facets will stay unknown: facet 12: it looks" in doubt.text
    assert found.shares["shown_share"] == 0.75
    assert found.facets["12"]["sigma_canting_x_rad"] is None
    assert found.facets["11"]["sigma_canting_x_rad"] is not None


def test_losing_facets_is_no_gain(drawn: Path, tmp_path: Path) -> None:
    """Against the mean of two facets canting is surer than against that of four: by 1.22, and nothing is better."""

    def turned(content: dict[str, Any]) -> None:
        for facet in content["mirror"]["facet"][:2]:
            facet["rotation_vector_rad"] = [0.0, 0.05, 0.0]

    more, fewer = (
        PlannedOverlay(load_overlay_plan(planned(drawn, tmp_path / name, change)))
        for name, change in (("more", lambda content: None), ("fewer", turned))
    )
    (lost,) = try_changes([Change("", "", "", "", fewer)], more.prospect(), SilentProgress())
    assert lost.beside["shown_share"] == 0.5
    assert lost.best_gain == 0.0
    (same,) = try_changes([Change("", "", "", "", more)], more.prospect(), SilentProgress())
    assert same.best_gain == pytest.approx(1.0)


def test_one_photo_will_find_no_waves(drawn: Path, tmp_path: Path) -> None:
    def one_photo(content: dict[str, Any]) -> None:
        content["photo"] = content["photo"][:1]
        content["plan"]["difference_of_photos_mrad"] = 0.05

    found = {one.code for one in prospect(planned(drawn, tmp_path / "p", one_photo)).doubts}
    assert "plan_cannot_find_waves" in found
    assert "waves_unknown" not in found
    assert "plan_cannot_find_waves" not in {one.code for one in prospect(planned(drawn, tmp_path / "q")).doubts}


def test_no_image_of_the_source_is_refused(drawn: Path, tmp_path: Path) -> None:
    def away(content: dict[str, Any]) -> None:
        content["source"]["center_m"] = [5.0, 0.0, 40.0]

    with pytest.raises(EstimationError, match=r"no facet will show the source's edge.*looks 5\.\d m past the source"):
        prospect(planned(drawn, tmp_path / "away", away))

    def wide(content: dict[str, Any]) -> None:
        content["source"] |= {"width_m": 9.0, "height_m": 9.0}

    with pytest.raises(EstimationError, match=r"facet 11: the source fills it"):
        prospect(planned(drawn, tmp_path / "wide", wide))


def test_waves_that_nobody_states_are_said(drawn: Path, tmp_path: Path) -> None:
    def forget(content: dict[str, Any]) -> None:
        del content["plan"]["difference_of_photos_mrad"]
        one_facet(content)

    found = prospect(planned(drawn, tmp_path / "p", forget))
    (doubt,) = (one for one in found.doubts if one.code == "plan_without_facet_waves")
    assert doubt.severity is Severity.DOUBT
    assert found.not_determined["canting_x_rms_rad"] == "a single facet has no canting against others"
    assert found.sigmas()["mean_turn_x_rad"] > 0


def test_bad_input_is_one_sentence(drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def forget(content: dict[str, Any]) -> None:
        del content["photo"][1]["place_m"]

    folder = planned(drawn, tmp_path / "p", forget)
    with pytest.raises(InputError, match=r"photo photo_2\.png: place_m is missing"):
        prospect(folder)
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(folder), "-o", str(tmp_path / "out"), "--no-report", "-q"])
    assert ended.value.code == 2
    assert not (tmp_path / "out").exists()
    assert "place_m is missing" in " ".join(capsys.readouterr().err.split())

    def near(content: dict[str, Any]) -> None:
        content["camera"] |= {"focal_x_px": 90_000.0, "focal_y_px": 90_000.0}

    with pytest.raises(EstimationError, match=r"facet 11: it looks .*, and only a part of it is in the image"):
        prospect(planned(drawn, tmp_path / "near", near))


@pytest.mark.slow
def test_the_command_says_what_would_better_it(drawn: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def few(content: dict[str, Any]) -> None:
        content["mirror"]["facet"] = content["mirror"]["facet"][:2]
        content["plan"]["difference_of_photos_mrad"] = 0.05

    out = tmp_path / "out"
    with pytest.raises(SystemExit) as ended:
        cli.main(["deflectometry", "plan", str(planned(drawn, tmp_path / "p", few)), "-o", str(out)])
    assert ended.value.code == 0
    assert "heliostat as a whole in x" in capsys.readouterr().out
    table = read_table_csv(out / ALTERNATIVES_FILE, ("key", "gain_canting_x_rms_rad", "gain_mean_turn_x_rad"))
    canting, mean = (
        dict(zip(table["key"], [float(one or "nan") for one in table[key]], strict=True))
        for key in ("gain_canting_x_rms_rad", "gain_mean_turn_x_rad")
    )
    # Waves rule: of four photos in place of three.
    assert canting["photo"] == pytest.approx(np.sqrt(4 / 3), rel=0.03)
    assert mean["source.sigma_center_mm"] > 1.3
    assert "how far one may be turned before it cuts off an image" in (out / "report.html").read_text()
    assert read_table_csv(out / FACETS_FILE, ("facet",))["facet"] == ["11", "12"]
