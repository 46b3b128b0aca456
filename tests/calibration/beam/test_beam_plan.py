"""Plans of suns and frames for the canting: arithmetic, and what is promised against what comes out."""

import datetime
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.beam.keys import load_beams
from calibration.beam.pipeline import compare
from calibration.beam.planning import plan as plan_module
from calibration.beam.planning.plan import BeamPlan, BeamPlanOptions, promised_rad, run
from calibration.beam.planning.sun_choice import Trial, choose_suns
from data_synth.heliostats import BenchOptions, write_beam_dataset
from heliogauge.doubts import Doubt
from heliogauge.errors import InputError


def information(*canting: float) -> np.ndarray:
    """What a sun tells of two facets: x and y of their one mode, then curvature and scatter."""
    return np.diag([*canting, 1.0, 1.0])


def test_frames_average_noise_alone() -> None:
    trial = Trial(variance=4.0, noise=3.0, facets=2)
    told = information(100.0, 100.0)
    # One mode of two facets has the sigma 1/10; each facet has 1/sqrt(2) of it.
    assert trial.sigma_rad(told) == pytest.approx(2 * 0.1 / np.sqrt(2))
    assert trial.sigma_rad(told, 3) == pytest.approx(np.sqrt(2) * 0.1 / np.sqrt(2))
    frames = trial.frames_for(told, 0.08)
    assert frames is not None
    assert trial.sigma_rad(told, frames) <= 0.08 < trial.sigma_rad(told, frames - 1)
    # What the model lacks stays: 0.0707 with any number of frames.
    assert trial.frames_for(told, 0.07) is None
    assert not np.isfinite(trial.sigma_rad(information(100.0, 0.0)))


def test_the_sun_that_tells_most_comes_first() -> None:
    suns = [information(50.0, 1.0), information(1.0, 60.0), information(40.0, 40.0)]
    chosen = choose_suns(suns, 2, 3)
    assert [one.number for one in chosen] == [2, 1, 0]
    assert chosen[-1].information == pytest.approx(sum(suns))
    with pytest.raises(InputError, match="suns"):
        choose_suns([], 2, 3)


def test_a_plan_of_suns_that_tell_nothing_is_written_with_the_reason(tmp_path: Path) -> None:
    """One sun that sees of two modes of the canting only their sum."""
    seen = np.array([[1.0, 1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 0.0, 0.0]])
    suns = choose_suns([seen.T @ seen + np.diag([0.0, 0.0, 0.0, 0.0, 1.0, 1.0])], 3, 1)
    after = SimpleNamespace(sigma_canting_rad=np.full((3, 2), 1e-4))
    trial: Any = SimpleNamespace(after=after, photos=("first",))
    times, angles = ("2026-03-21T12:00Z",), np.zeros((1, 2))
    worth = Trial(4.0, 3.0, 3)
    plan = BeamPlan(
        trial=trial, worth=worth, suns=tuple(suns), times=times, angles_rad=angles, wanted_rad=1e-4, name="one"
    )
    plan.write(tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    names = {"suns_count", "frames_count", "least_planned_sigma_canting_rad"}
    assert summary["not_determined"] == dict.fromkeys(names, "1 sun does not tell the canting of 3 facets apart")


def test_a_sun_that_cannot_be_used_is_written_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A mirror that no sun in the west lights, and a day of the polar night."""
    trial: Any = SimpleNamespace(
        after=SimpleNamespace(sigma_canting_rad=np.full((2, 2), 1e-4), is_canting_told=True),
        photos=("first",),
        mirror=SimpleNamespace(facets=("left", "right")),
        stand=None,
        name="one",
        doubts=(Doubt("canting_not_determined", "overlap; more suns far apart (`beam plan` says which)"),),
        why_canting_is_open=lambda: "overlap",
        input_sha256={},
    )

    def told(_trial: Any, _after: Any, to_sun: np.ndarray) -> np.ndarray:
        if to_sun[0] < 0:
            raise InputError("the sun stands behind the mirror")
        return information(50.0, 40.0)

    monkeypatch.setattr(compare, "run", lambda *_: trial)
    monkeypatch.setattr(plan_module, "trial_of", lambda *_: Trial(4.0, 3.0, 2))
    monkeypatch.setattr(plan_module, "_told", told)
    measurement: Any = SimpleNamespace(
        folder=tmp_path,
        model=SimpleNamespace(site=SimpleNamespace(latitude_deg=70.0, longitude_deg=20.0, altitude_m=0.0)),
    )
    days = tuple(datetime.date(2026, month, 21) for month in (6, 12))
    plan = run(measurement, BeamPlanOptions(days=days))
    assert plan.left_out["2026-12-21"] == "the sun stays below 10 degrees"
    assert len(plan.suns) + len(plan.left_out) == 10
    assert set(plan.left_out.values()) == {"the sun stays below 10 degrees", "the sun stands behind the mirror"}
    words = {one.code: one.text for one in plan.doubts}
    assert words.keys() >= {"canting_not_determined", "suns_left_out"}
    # A plan does not send its reader to itself.
    assert words["canting_not_determined"] == "the trial alone does not determine the canting of 2 facets: overlap"
    (tmp_path / "plan").mkdir()
    plan.write(tmp_path / "plan")
    assert "behind the mirror" in (tmp_path / "plan" / "left_out.csv").read_text()
    with pytest.raises(InputError, match=r"none at which the mirror can light.*2026-12-21"):
        run(measurement, BeamPlanOptions(days=days[1:]))


@pytest.mark.slow
def test_what_is_promised_is_what_comes_out(tmp_path: Path) -> None:
    """From a trial at three suns to six: error over promise of four mirrors, 24 numbers of canting."""
    ratios = []
    for seed in (0, 3, 4, 5):
        trial, later = tmp_path / f"trial{seed}", tmp_path / f"later{seed}"
        write_beam_dataset(trial, BenchOptions(suns=3, seed=seed))
        write_beam_dataset(later, BenchOptions(suns=6, seed=seed))
        plan = run(load_beams(trial), BeamPlanOptions(most=3))
        truth = json.loads((later / "truth.json").read_text())
        suns = np.array([one["to_sun"] for one in truth["photos"]])
        after = compare.run(load_beams(later)).after
        assert after is not None
        assert after.is_canting_told
        error = float(np.sqrt(np.mean((after.canting_rad - np.array(truth["canting_rad"])) ** 2)))
        ratios.append(error / promised_rad(plan, suns))
        # Of its own suns it promises what it found; each was aimed elsewhere.
        own = json.loads((trial / "truth.json").read_text())["photos"]
        found = plan.trial.after
        assert found is not None
        stated = float(np.sqrt(np.mean(found.sigma_canting_rad**2)))
        assert promised_rad(plan, np.array([one["to_sun"] for one in own])) == pytest.approx(stated, rel=0.15)
        assert (np.diff(plan.sigmas_rad) < 0).all()
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.4


@pytest.mark.slow
def test_a_sigma_that_no_plan_gives_is_said(tmp_path: Path) -> None:
    write_beam_dataset(tmp_path / "trial", BenchOptions(suns=3, seed=3))
    plan = run(load_beams(tmp_path / "trial"), BeamPlanOptions(wanted_rad=1e-7, most=4))
    assert plan.cheapest is None
    assert any(one.code == "wanted_sigma_not_reached" for one in plan.doubts)
    assert plan.summarise().numbers["suns_count"] is None
    assert "not reached" in plan.headline()
    without = load_beams(tmp_path / "trial")
    model = without.model.model_copy(update={"site": None})
    with pytest.raises(InputError, match="site"):
        run(type(without)(without.folder, model), BeamPlanOptions())


@pytest.mark.slow
def test_facets_are_not_exchanged(tmp_path: Path) -> None:
    """From the design the fit of this mirror runs into a minimum with facets exchanged: 1 mrad off, sigma 0.2."""
    write_beam_dataset(tmp_path / "drawn", BenchOptions(suns=6, seed=2))
    truth = np.array(json.loads((tmp_path / "drawn" / "truth.json").read_text())["canting_rad"])
    after = compare.run(load_beams(tmp_path / "drawn")).after
    assert after is not None
    assert np.abs(after.canting_rad - truth).max() < 4 * after.sigma_canting_rad.max()
    assert np.sqrt(np.mean((after.canting_rad - truth) ** 2)) < 1e-4
    assert after.rival_log_odds > np.log(20.0)
