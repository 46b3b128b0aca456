"""A number that is not determined says why, in the summary of every kind of result.

Each kind of result stands in one of two tables: `UNDETERMINED` makes a summary in which what may lack a value lacks it;
`DETERMINED` says why all numbers of a kind are always there. A new kind of result must be put into one of them.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import cv2
import numpy as np
import pytest

from calibration.beam.files.comparison import Comparison as MirrorComparison
from calibration.beam.files.comparison import PhotoComparison
from calibration.beam.keys import load_beams
from calibration.beam.pipeline import compare
from calibration.beam.pipeline.measure import run as measure_beams
from calibration.beam.planning.plan import BeamPlan
from calibration.camera.files.compared import Compared
from calibration.camera.files.summary import headline_numbers, not_determined
from calibration.camera.judgement.comparison import Comparison as CameraComparison
from calibration.heliostat.files.store_field import failed_row, field_summary
from calibration.heliostat.performance.entries import Entry
from calibration.heliostat.performance.files.result import Result as SheetTests
from data_synth.heliostats import BenchOptions, write_beam_dataset
from deflectometry.comparison.pipeline.result import Comparison as MapComparison
from deflectometry.dots.series.pipeline.result import SeriesResult
from deflectometry.exchange.measure_slopes import SlopesResult
from deflectometry.gazing.pipeline.result import GazingResult
from deflectometry.gazing.planning.plan import GazingPlanResult
from deflectometry.gazing.planning.spacing import Spacing
from deflectometry.laser.pipeline.measure import LaserResult
from deflectometry.overlay.planning import plan as overlay
from deflectometry.overlay.planning.plan import OverlayPlanResult
from deflectometry.pipeline import headline as map_numbers
from deflectometry.pipeline import result as deflectometry_result
from deflectometry.pipeline.result import Result as DeflectometryResult
from deflectometry.planning.pipeline.plan import PlanResult
from deflectometry.planning.prospect import FacetProspect, Prospect
from deflectometry.planning.sigma_prospect import SigmaProspect
from deflectometry.poses.pipeline.result import PosesResult
from deflectometry.scans.pipeline.measure import SurfaceScanResult
from deflectometry.screen_geometry.pipeline.geometry import Result as ScreenResult
from deflectometry.screen_geometry.planning.plan import ScreenPlanResult
from deflectometry.stars.pipeline.measure import StarsResult
from deflectometry.stars.planning.plan import StarsPlanResult
from deflectometry.stars.planning.predicted_night import PlannedTime
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.folder import UNEXPLAINED, Summary, explained
from heliogauge.results.frame import InstrumentResult
from heliogauge.slopes.map import SlopeMap
from observer.pipeline.headline import surface_numbers
from observer.pipeline.result import Result as TroughResult
from observer.studies import align
from photogrammetry.networks.length_error import LengthStatement
from photogrammetry.networks.quality import network_numbers
from photogrammetry.pipeline.single_photos import TargetsResult
from photogrammetry.planning.plan import PlanResult as NetworkPlan
from tests.architecture.source_tree import PACKAGES
from tests.heliogauge.reporting.test_figures import make_map

NAN = float("nan")


def bare(kind: type[Any], **known: Any) -> Any:
    """Return a result of which only some fields are known; the others answer whatever they are asked."""
    one = object.__new__(kind)
    usual: dict[str, Any] = {"name": "one", "doubts": (), "durations_s": {}, "input_sha256": {}}
    for item in fields(kind):
        object.__setattr__(one, item.name, (usual | known).get(item.name, MagicMock()))
    return one


def flat_map() -> SlopeMap:
    """A flat mirror of which no node is measured with all of its neighbours."""
    one = make_map(rows=12, columns=14)
    holes = np.where(np.indices(one.shape).sum(axis=0) % 2 == 0, 1.0, np.nan)
    zero = np.zeros(one.shape)
    return replace(one, slope_x=zero * holes, slope_y=zero * holes, design_slope_x=zero, design_slope_y=zero)


def map_and_facets() -> tuple[map_numbers.Numbers, dict[str, map_numbers.Numbers]]:
    """Return numbers of a flat mirror, and of a facet of which too little is measured for its canting."""
    one = flat_map()
    numbers = map_numbers.facet_numbers(one, one)
    return numbers, {"A1": map_numbers._numbers_of_canting(None) | numbers}


def maps(kind: type[InstrumentResult], **known: Any) -> Callable[[Path], Summary]:
    def summary(_: Path) -> Summary:
        numbers, facets = map_and_facets()
        usual = {"numbers": numbers, "facets": facets, "facet_numbers": facets, "cantings": (), "texts": {}}
        return bare(kind, **(usual | known)).summarise()

    return summary


def beam_without_light(folder: Path) -> Summary:
    write_beam_dataset(folder / "beam", BenchOptions(suns=1, seed=3))
    for photo in (folder / "beam").rglob("*.png"):
        cv2.imwrite(str(photo), np.full_like(cv2.imread(str(photo), cv2.IMREAD_UNCHANGED), 40))
    return measure_beams(load_beams(folder / "beam")).summarise()


def beam_that_leaves_canting_open(folder: Path) -> Summary:
    """One sun does not tell the canting of four facets."""
    write_beam_dataset(folder / "beam", BenchOptions(suns=1, seed=3))
    result = compare.run(load_beams(folder / "beam"))
    assert "canting_not_determined" in {one.code for one in result.doubts}
    row = PhotoComparison(0.98, 0.99, NAN, 1.0, NAN, 0.01)
    saturated = bare(MirrorComparison, rows=(row,), mirror=result.mirror, stand=result.stand, after=None)
    numbers = {f"saturated_{key}": value for key, value in saturated.summarise().numbers.items()}
    assert numbers["saturated_largest_d90_difference_share"] is None
    assert "D90 not determined" in saturated.headline()
    assert "canting not determined" in result.headline()
    result.write(folder)
    return result.summarise()


def beam_plan(_: Path) -> Summary:
    trial = SimpleNamespace(after=SimpleNamespace(sigma_canting_rad=np.full((3, 2), 1e-4)), photos=("first",))
    worth = SimpleNamespace(noise=1.0, variance=2.0, facets=3, sigma_rad=lambda *_: NAN, frames_for=lambda *_: None)
    return bare(
        BeamPlan, trial=trial, worth=worth, suns=(SimpleNamespace(information=None),), wanted_rad=1e-4
    ).summarise()


def camera_without_drawing(_: Path) -> Summary:
    intrinsics = SimpleNamespace(focal_x_px=1.0, focal_y_px=1.0, center_x_px=1.0, center_y_px=1.0)
    chance = dict.fromkeys(("chi_square", "chance"), NAN)
    others = ("rms_rad", "largest_rad", "expected_rad", "raw_rms_rad", "raw_largest_rad", "raw_expected_rad")
    result: Any = SimpleNamespace(
        quality=SimpleNamespace(rms_px=0.1, rms_as_drawn_px=NAN, rejected=(), redundancy=9, sigma_factor_ratio=1.0),
        sigma=SimpleNamespace(rms_ray_rad=1.0, rms_free_rad=1.0, worst_projection_px=1.0),
        camera=SimpleNamespace(**vars(intrinsics), sigma_parameters=np.ones(4)),
        kept_apart_px=NAN,
        held_out_px=NAN,
        held_out=(),
        intrinsics=(),
        coverage=SimpleNamespace(share=1.0, radius_share=1.0),
        photos=(),
        left_out=(),
        shape=SimpleNamespace(has_drawing=False),
        comparison=SimpleNamespace(**chance, **dict.fromkeys(others, 1.0), rotation_rad=np.zeros(3), freedom=0),
    )
    return explained(Summary("camera", "one", headline_numbers(result), not_determined=not_determined(result)))


def cameras_without_covariance(_: Path) -> Summary:
    grid = np.zeros((2, 2))
    same = CameraComparison(np.arange(2.0), np.arange(2.0), grid, grid, grid, grid, np.zeros(3), NAN, 0)
    return bare(Compared, comparison=same).summarise()


def heliostats_that_failed(_: Path) -> Summary:
    shared: Any = SimpleNamespace(split="balanced", free="auto", thorough=False)
    rows = [failed_row("AA39", "no row can be used")]
    return explained(field_summary("field", rows, shared, durations_s={}, input_sha256={}))


def sheet_of_nothing(_: Path) -> Summary:
    entry = Entry("drift", "rate_mrad", "drift of the beam", None, note="one day is too short")
    return bare(SheetTests, entries=(entry,), about={}).summarise()


def network_without_redundancy(_: Path) -> Summary:
    observations = SimpleNamespace(n=8, n_rays=np.array([2, 2]), n_targets_in_photo=np.array([2, 2]))
    observations.targets, observations.covariance_px2 = (), np.zeros((8, 2, 2))
    bundle = MagicMock(
        residuals_px=np.zeros((8, 2)),
        sigma_points_m=np.zeros((2, 3)),
        sigma0=NAN,
        variance_factor=NAN,
        redundancy=0,
        points_m=np.eye(2, 3),
    )
    bundle.problem.observations, bundle.problem.constraints = observations, ()
    bundle.variance_factor_interval.return_value = (NAN, NAN)
    bundle.state.points_m = np.eye(2, 3)
    solved: Any = SimpleNamespace(
        bundle=bundle,
        image_sigma_factor=1.0,
        largest_eccentricity_px=0.0,
        rejected=(),
        network=SimpleNamespace(suspicious=()),
    )
    numbers, why = network_numbers(solved, LengthStatement((), (), None))
    return explained(Summary("photogrammetry", "one", numbers, not_determined=why))


def trough_without_heights(_: Path) -> Summary:
    """Heights too small to be seen, and an absorber too far off for a best place."""
    reflector: Any = SimpleNamespace(
        shape=SimpleNamespace(share=0.5, sigma=np.inf, effect_rad=0.0), roughness=SimpleNamespace(along_rad=1e-3)
    )
    numbers, why = surface_numbers(reflector)
    return bare(TroughResult)._summary(numbers, {}, why)


def gazing_plan(_: Path) -> Summary:
    nothing = bare(GazingPlanResult, best=Spacing(1.0, 2e-3, NAN, 0.0, 1.0, NAN))
    assert "not determined" in nothing.headline()
    return nothing.summarise()


def stars_plan(_: Path) -> Summary:
    sigma = np.array([[1e-5, 1e-5], [NAN, NAN]])
    best = PlannedTime(np.array([3, 0]), sigma, np.array([1e-5, 1e-5]), np.datetime64("2026-03-14T20:00"), -0.5, ())
    return bare(StarsPlanResult, facets=("A1", "A2"), times=(best,), together=(best,)).summarise()


def map_plan(_: Path) -> Summary:
    whole, numbers = flat_map(), map_and_facets()[0]
    place = RigidTransform.identity()
    facets = (FacetProspect("A1", 1.0, "", whole, place), FacetProspect("A2", 0.0, "the lower half", None, place))
    prospect = Prospect(whole, numbers, facets, 0.01, 100)
    return bare(PlanResult, prospect=prospect, limits={}, alternatives=()).summarise()


def sigma_plan(kind: type[Any], found: SigmaProspect) -> Summary:
    return bare(kind, prospect=found, alternatives=()).summarise()


def overlay_plan(_: Path) -> Summary:
    """Of two facets one shows the source's edge: neither has a canting against the other."""
    sigma = np.diag([1e-8, 1e-8, NAN, NAN])
    turns: Any = SimpleNamespace(
        known=np.array([True, False]), canting=lambda: (None, sigma), mean_turn=lambda: (None, 1e-8 * np.eye(2))
    )
    facets: Any = [SimpleNamespace(name=name) for name in ("A1", "A2")]
    each = overlay._of_facets(facets, turns)
    assert each["A2"]["sigma_canting_x_rad"] is None
    found = SigmaProspect(overlay._promised(turns), {}, overlay._reasons(turns), {}, {}, {}, {}, each)
    return sigma_plan(OverlayPlanResult, found)


def screen_plan(_: Path) -> Summary:
    names = ("x_m", "width_m")
    found = SigmaProspect(dict.fromkeys(names, NAN), {}, dict.fromkeys(names, "there is no scale"), {}, {}, {}, {})
    return sigma_plan(ScreenPlanResult, found)


def screen_without_ends(_: Path) -> Summary:
    """No row and no column of dots has both ends."""
    table = {name: np.linspace(0.0, 1.0, 9) for name in ("x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m")}
    result = MagicMock(tests=())
    result.points.return_value, result._size.return_value = table, (np.full(2, NAN), np.full(2, NAN))
    result.measured.cam_from_screen, result._summary = None, bare(ScreenResult)._summary
    result.network.result.solved.bundle.problem.observations = SimpleNamespace(n=4, photos=())
    return ScreenResult.summarise(result)


def maps_without_sigma(_: Path) -> Summary:
    terms = SimpleNamespace(names=(), values=(), sigmas=(), rest=np.zeros((2, 5)), rest_rms_rad=np.zeros(2))
    judged = SimpleNamespace(terms_probability=NAN, stated_probability=NAN, rest_probability=NAN)
    placed = SimpleNamespace(likeness=SimpleNamespace(correlation=NAN), found=None)
    canted = SimpleNamespace(difference_rad=np.zeros((2, 2)), sigma_rad=np.zeros((2, 2)), probability=NAN)
    result = MagicMock(
        terms=terms,
        stated=terms,
        judgement=judged,
        placed=placed,
        cantings=canted,
        rest=MagicMock(mean_square=np.zeros(2)),
    )
    result._difference_rms.return_value, result._summary = np.zeros(2), bare(MapComparison)._summary
    return MapComparison.summarise(result)


def photos_without_targets(_: Path) -> Summary:
    photo = MagicMock(unread=None, refused=(), dots=())
    photo.detections.sigma_px, photo.detections.radius_px, photo.detections.names = np.zeros((0, 2)), np.zeros(0), ()
    return bare(TargetsResult, photos=(photo,)).summarise()


def network_plan(_: Path) -> Summary:
    prediction = MagicMock(
        sigma_m=np.full((3, 3), np.inf),
        rms_m=np.inf,
        largest_m=np.inf,
        alone_m=np.full(3, np.inf),
        convergence_rad=np.ones(3),
        coverage_share=0.5,
        rays=np.array([0, 2, 2]),
    )
    task = MagicMock()
    task.target_object.points_m, task.goal.sigma_m, task.reach.distance_m = np.eye(3), 1e-4, 3.0
    task.planned.sigma_px = 0.05
    plan = MagicMock(q=0.7)
    plan.best.prediction = prediction
    return bare(NetworkPlan, task=task, plan=plan).summarise()


def alignment_without_panels(_: Path) -> Summary:
    nowhere = np.full(4, NAN)
    collector = MagicMock(focal_length_m=1.0)
    tilts = MagicMock(tilt_rad=nowhere, sigma_rad=nowhere)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(align, "mount_moves", lambda *_: SimpleNamespace(move_m=nowhere))
        return bare(align.Result, to_absorber=tilts, collector=collector).summarise()


def series(_: Path) -> Summary:
    numbers, facets = map_and_facets()
    first = bare(DeflectometryResult, numbers=numbers, facets=facets, cantings=(), texts={})
    row = SimpleNamespace(**dict.fromkeys(("turn_rad", "rms_rad", "sigma_turn_rad"), np.zeros(2)), flag="", time_s=0.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(deflectometry_result, "geometry", lambda *_: {})
        patch.setattr(deflectometry_result, "flag_words", lambda *_: "")
        return bare(SeriesResult, first=first, rows=(row,)).summarise()


CAMERA = MagicMock(reason="", misfit=1.0)
CAMERA.eye_m.tolist.return_value = [0.0, 0.0, 1.0]
SCANNED = MagicMock(points_m=np.zeros((1, 3)), odd=np.zeros(3, dtype=bool))
SCANNED.solution.cam_from_mirror.rotation_vector_rad = np.zeros(3)


#: How a summary of each kind comes about in which what may lack a value lacks it.
UNDETERMINED: dict[str, Callable[[Path], Summary]] = {
    "backward-gazing": maps(GazingResult, facets=(), cameras=(CAMERA,), sun_direction=np.zeros(3)),
    "backward-gazing-plan": gazing_plan,
    "beam": beam_without_light,
    "beam-mirror": beam_that_leaves_canting_open,
    "beam-plan": beam_plan,
    "camera": camera_without_drawing,
    "camera-compare": cameras_without_covariance,
    "deflectometry": series,
    "deflectometry-compare": maps_without_sigma,
    "deflectometry-dots-series": series,
    "deflectometry-plan": map_plan,
    "deflectometry-poses": maps(PosesResult, parameters=(), poses=()),
    "heliostat-field": heliostats_that_failed,
    "heliostat-tests": sheet_of_nothing,
    "laser-scan": maps(LaserResult, scan=SimpleNamespace(seen=np.ones(3, dtype=bool)), found=SCANNED),
    "observer": trough_without_heights,
    "observer-alignment": alignment_without_panels,
    "overlay-plan": overlay_plan,
    "photogrammetry": network_without_redundancy,
    "photogrammetry-plan": network_plan,
    "photogrammetry-targets": photos_without_targets,
    "screen-geometry": screen_without_ends,
    "screen-geometry-plan": screen_plan,
    "slopes": maps(SlopesResult),
    "stars": maps(StarsResult, facets=()),
    "stars-plan": stars_plan,
    "surface-scan": maps(SurfaceScanResult),
}
#: Why a kind needs no reasons.
DETERMINED = {
    "camera-plan": "starts from a calibration, whose covariance it extends",
    "heliostat-sheet": "counts",
    "observer-absorber": "a tube without two stations is refused; what is not finite of its shape is left out",
    "observer-compare": "only sags that two orientations show stand in it",
    "observer-compare-fields": "counts, and a mean of what both dates have",
    "observer-overview": "only what a module has stands in it",
    "observer-plan": "a flight without measured nodes is refused",
    "overlay": "facets without a turn are left out, and none at all is refused",
    "response": "fewer than the least number of levels are refused",
    "survey": "counts",
}


def kinds_of_results() -> set[str]:
    """Return the kinds of all results that an instrument can make."""
    for package in PACKAGES:
        for found in walk_packages(import_module(package).__path__, f"{package}."):
            if not found.name.endswith("__main__"):
                import_module(found.name)

    def below(one: type[InstrumentResult]) -> set[type[InstrumentResult]]:
        return {one}.union(*(below(each) for each in one.__subclasses__()))

    # Tests that ran before in this process may have made kinds of their own.
    made_here = [one for one in below(InstrumentResult) if one.__module__.partition(".")[0] in PACKAGES]
    return {one.kind for one in made_here if hasattr(one, "kind")}


def test_every_kind_of_result_is_looked_at() -> None:
    kinds = kinds_of_results()
    assert not UNDETERMINED.keys() & DETERMINED.keys()
    assert kinds == UNDETERMINED.keys() | DETERMINED.keys()


@pytest.mark.parametrize("kind", UNDETERMINED)
def test_what_is_not_determined_says_why(kind: str, tmp_path: Path) -> None:
    """A number without a reason is a warning, which ends the test."""
    summary = UNDETERMINED[kind](tmp_path)
    tables = (summary.numbers, *summary.facets.values())
    missing = {key for table in tables for key, value in table.items() if value is None}
    assert missing
    for key in missing:
        assert len(summary.not_determined[key]) > 5
        assert summary.not_determined[key] != UNEXPLAINED
