"""Two results of one drawn mirror: the difference and its sigma, the frames, the verdict."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from deflectometry.cli import app
from deflectometry.comparison.canting_difference import (
    FacetPartner,
    canting_difference,
    facets_left_out,
    partners,
)
from deflectometry.comparison.in_plane import find_motion
from deflectometry.comparison.judgement import Agreement
from deflectometry.comparison.moved_map import PlaneMotion
from deflectometry.comparison.pipeline.compare import compare_results
from deflectometry.exchange.opencsp_import import OpencspOptions, import_opencsp
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.folder import Summary, write_slope_map, write_summary
from heliogauge.results.slope_map_file import ASSEMBLED
from heliogauge.running.verbs import measure
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes
from heliogauge.validate import FloatArray

NOISE_RAD = 5e-5
#: One sigma of the curvature in both axes, and of the shear, of either measurement [1/m].
CURVATURE_PER_M, SHEAR_PER_M = 3e-4, 1e-4
WAVES = ((4e-4, 17.0, 5.0, 0.3), (3e-4, -9.0, 21.0, 1.1), (2e-4, 26.0, -14.0, 2.0))


def wavy_slopes(x: FloatArray, y: FloatArray, seed: int = 0) -> FloatArray:
    """Slopes of a mirror of 100 m focal length with waves of 0.2 to 0.4 m."""
    turn = 0.0 if seed == 0 else 1.0 + seed
    slopes = np.stack([x / 200, y / 200])
    for amplitude, of_x, of_y, phase in WAVES:
        a, b = np.cos(turn) * of_x - np.sin(turn) * of_y, np.sin(turn) * of_x + np.cos(turn) * of_y
        size = amplitude / np.hypot(a, b)
        slopes += size * np.stack([a, b]).reshape(2, *([1] * x.ndim)) * np.cos(a * x + b * y + phase)
    return slopes


def drawn_map(
    rng: np.random.Generator,
    *,
    mirror: int = 0,
    turn_rad: float = 0.0,
    shift_m: tuple[float, float] = (0.0, 0.0),
    step_m: float = 0.02,
    curvature_per_m: float = 0.0,
    shear_per_m: float = 0.0,
    trough_per_m: float = 0.0,
) -> SlopeMap:
    """Draw a measurement in a frame of its own: ``x_first = R(turn) x_own + shift``."""
    side = np.arange(-0.6, 0.6 + 1e-9, step_m)
    x, y = np.meshgrid(side, side)
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    there = cosine * x - sine * y + shift_m[0], sine * x + cosine * y + shift_m[1]
    seen = wavy_slopes(*there, mirror)
    seen[0] += trough_per_m * there[0]
    slopes = np.stack([cosine * seen[0] + sine * seen[1], -sine * seen[0] + cosine * seen[1]])
    slopes += rng.normal(0, NOISE_RAD, slopes.shape)
    draws = rng.normal(size=3)
    bend = curvature_per_m + CURVATURE_PER_M * draws[:2]
    shear = shear_per_m + SHEAR_PER_M * draws[2]
    slopes += np.stack([bend[0] * x + shear * y, bend[1] * y - shear * x])
    modes = np.zeros((3, 2, 3))
    modes[0, 0, 1] = modes[1, 1, 2] = CURVATURE_PER_M
    modes[2, 0, 2], modes[2, 1, 1] = SHEAR_PER_M, -SHEAR_PER_M
    sigma = np.full(x.shape, NOISE_RAD)
    return SlopeMap(
        side,
        side,
        slopes[0],
        slopes[1],
        x / 200,
        y / 200,
        sigma,
        sigma,
        1.0,
        CommonModes(("screen pose",) * 3, modes, np.zeros(2), 1.0),
        np.full(x.shape, np.nan),
        np.zeros(x.shape, np.uint32),
        np.ones(x.shape, bool),
        "paraboloid of focal length 100 m",
        "facet",
        "nothing",
    )


def written(folder: Path, slope_map: SlopeMap, doubts: tuple[Doubt, ...] = ()) -> Path:
    folder.mkdir()
    write_slope_map(folder / "slope_map.nc", {"": slope_map})
    write_summary(folder / "summary.json", Summary("slopes", "facet", {"measured_share": 1.0}, doubts=doubts))
    return folder


@pytest.mark.slow
def test_linear_terms_scatter_as_their_sigmas_say(tmp_path: Path) -> None:
    squares, probabilities, rests = [], [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        pair = [written(tmp_path / f"{name}{seed}", drawn_map(rng)) for name in "ab"]
        found = compare_results(*pair, as_placed=True)
        whitened = np.linalg.solve(np.linalg.cholesky(found.terms.covariance), found.terms.values)
        squares.append(float(whitened @ whitened))
        probabilities.append(found.judgement.terms_probability)
        rests.append(found.judgement.rest_probability)
        assert found.judgement.agreement is Agreement.WITHIN
    # 144 squares of whitened terms: chi-square, two sides of 1 in 500.
    assert 106 < sum(squares) < 191
    assert 0.3 < np.mean(probabilities) < 0.7
    assert 0.3 < np.mean(rests) < 0.7


@pytest.mark.slow
def test_frames_are_found_within_their_sigma(tmp_path: Path) -> None:
    truth = np.array([0.5 * np.pi + 0.004, 0.012, -0.007])
    squares = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        first = written(tmp_path / f"a{seed}", drawn_map(rng))
        second = written(tmp_path / f"b{seed}", drawn_map(rng, turn_rad=truth[0], shift_m=(truth[1], truth[2])))
        found = compare_results(first, second)
        assert found.placed.found is not None
        motion = found.placed.found.motion
        error = np.array([motion.turn_rad, *motion.shift_m]) - truth
        squares.append(float(error @ np.linalg.solve(found.placed.found.covariance, error)))
        assert np.abs(error).max() < 1e-3
        assert found.judgement.agreement is Agreement.WITHIN
        assert "frames_differ" in {one.code for one in found.doubts}
    # Mean of chi-square over 3: of a jackknife over 16 blocks, whose own spread widens it.
    assert 0.4 < np.mean(squares) / 3 < 2.5


@pytest.mark.parametrize("seed", range(2))
def test_the_turn_of_a_map_is_in_the_sigma_of_its_twist(tmp_path: Path, seed: int) -> None:
    """A trough turned by one sigma has another twist, by its curvature times that: no contradiction."""
    rng, trough_per_m = np.random.default_rng(seed), 0.3
    first = written(tmp_path / "first", drawn_map(rng, trough_per_m=trough_per_m))
    drawn = drawn_map(rng, turn_rad=0.02, shift_m=(0.01, 0.0), trough_per_m=trough_per_m)
    found = compare_results(first, written(tmp_path / "second", drawn))
    assert found.placed.found is not None
    twist = found.terms.names.index("twist")
    expected = trough_per_m * found.placed.found.sigmas[0]
    assert found.terms.sigmas[twist] == pytest.approx(expected, rel=0.1)
    assert found.judgement.agreement is Agreement.WITHIN
    # Frames that are taken as they are have no such sigma.
    as_placed = compare_results(tmp_path / "first", tmp_path / "second", as_placed=True)
    assert as_placed.terms.sigmas[twist] < 0.1 * expected


def test_a_place_found_in_noise_has_the_sigma_of_its_scatter() -> None:
    """Noise of the gradients is no structure: taken for it, errors are 2.6 times the sigma."""
    squares = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        pair = [drawn_map(rng, step_m=0.03) for _ in "ab"]
        noisy = [
            replace(
                one,
                slope_x=one.slope_x + rng.normal(0, 3e-4, one.shape),
                slope_y=one.slope_y + rng.normal(0, 3e-4, one.shape),
            )
            for one in pair
        ]
        found = find_motion(*noisy, PlaneMotion.none())
        error = np.array([found.motion.turn_rad, *found.motion.shift_m])
        squares.append(float(error @ np.linalg.solve(found.covariance, error)))
    # Mean of chi-square over 3: of a jackknife over 16 blocks, whose own spread widens it.
    assert 0.4 < np.mean(squares) / 3 < 2.5


def test_the_one_with_curl_is_blamed_for_the_focus(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    sound = written(tmp_path / "sound", drawn_map(rng))
    wrong = written(tmp_path / "wrong", drawn_map(rng, curvature_per_m=-0.011, shear_per_m=2e-3))
    out = tmp_path / "out"
    ended = CliRunner().invoke(app, ["compare", str(wrong), str(sound), "-o", str(out), "--quiet"])
    assert ended.exit_code == 1
    found = compare_results(wrong, sound)
    assert found.judgement.blamed == "wrong"
    assert {"curvature_x", "curvature_y", "shear"} == set(found.judgement.contradicting)
    assert "focal lengths of opposite sign" in found.verdict()
    assert (out / "report.html").stat().st_size > 10_000
    # The other way round the same one is blamed.
    assert compare_results(sound, wrong).judgement.blamed == "wrong"


def test_results_that_agree_end_with_zero(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    pair = [written(tmp_path / name, drawn_map(rng, step_m=step)) for name, step in (("a", 0.02), ("b", 0.015))]
    command = ["compare", *map(str, pair), "-o", str(tmp_path / "out"), "--no-report"]
    ended = CliRunner().invoke(app, command)
    assert ended.exit_code == 0
    assert "agree within their sigmas" in ended.stdout


def test_results_without_any_sigma_are_compared(tmp_path: Path) -> None:
    """Measured slopes of another program have neither random nor common sigmas."""
    pair = []
    for number, name in enumerate("ab"):
        one = drawn_map(np.random.default_rng(number))
        zero = np.zeros_like(one.slope_x)
        bare = replace(one, sigma_random_x=zero, sigma_random_y=zero, common=no_common_modes())
        pair.append(written(tmp_path / name, bare))
    found = compare_results(*pair)
    assert found.judgement.agreement is Agreement.UNKNOWN
    assert found.summarise().numbers["rest_x_expected_rms_rad"] == 0


def test_a_shared_source_cancels(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    pair = [written(tmp_path / name, drawn_map(rng)) for name in "ab"]
    apart, together = (compare_results(*pair, shared=one).terms.sigmas[2] for one in ((), ("screen pose",)))
    assert apart == pytest.approx(np.sqrt(2) * CURVATURE_PER_M, rel=0.05)
    assert together < 0.05 * apart
    with pytest.raises(InputError, match="sources of both: screen pose"):
        compare_results(*pair, shared=("camera",))


@pytest.mark.parametrize("copied", [False, True])
def test_a_result_compared_with_itself_is_refused(tmp_path: Path, copied: bool) -> None:
    one = written(tmp_path / "one", drawn_map(np.random.default_rng(0)))
    other = Path(shutil.copytree(one, tmp_path / "two")) if copied else one
    with pytest.raises(InputError, match="are the same result"):
        compare_results(one, other)


def test_results_without_a_map_are_refused(tmp_path: Path) -> None:
    one = written(tmp_path / "one", drawn_map(np.random.default_rng(0)))
    bare = written(tmp_path / "bare", drawn_map(np.random.default_rng(1)))
    (bare / "slope_map.nc").unlink()
    with pytest.raises(InputError, match="have no slope map"):
        compare_results(one, bare)
    with pytest.raises(InputError, match="no folder of results"):
        compare_results(one, tmp_path)


def _mirrored(slope_map: SlopeMap) -> SlopeMap:
    return replace(slope_map, slope_x=-slope_map.slope_x[:, ::-1], slope_y=slope_map.slope_y[:, ::-1])


def test_two_mirrors_and_a_mirrored_map_are_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    one = written(tmp_path / "one", drawn_map(rng))
    other = written(tmp_path / "other", drawn_map(rng, mirror=1))
    turned = written(tmp_path / "turned", _mirrored(drawn_map(rng)))
    for second, code in ((other, "different_mirrors"), (turned, "map_is_mirrored")):
        doubts = {doubt.code: doubt for doubt in compare_results(one, second).doubts}
        assert doubts[code].severity is Severity.SERIOUS


def test_contradiction_within_enlarged_sigmas_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    wrong = drawn_map(rng, curvature_per_m=-0.004, shear_per_m=2e-3)
    modes = np.concatenate([wrong.common.coefficients, 20 * wrong.common.coefficients])
    sources = (*wrong.common.sources, *("setup in contradiction",) * 3)
    wrong = replace(wrong, common=replace(wrong.common, sources=sources, coefficients=modes))
    found = compare_results(written(tmp_path / "a", wrong), written(tmp_path / "b", drawn_map(rng)))
    assert found.judgement.agreement is Agreement.WITHIN_ENLARGED
    assert found.judgement.blamed == "a"
    assert "agree_within_enlarged_sigmas" in {one.code for one in found.doubts}


@pytest.mark.slow
def test_published_facet_by_dots_and_by_fringes(shared_data: Path, tmp_path: Path) -> None:
    """The dots' set-up is wrong: focal lengths of opposite sign, and curl that no surface has."""
    data = shared_data / "opencsp"
    files = {
        "dots": ("fixed/measurement_facet", "fixed/fixed_pattern_dot_locations", "common/camera_sofast"),
        "fringes": (
            "fringe/measurement_facet",
            "fringe/image_calibration",
            "common/camera_sofast_downsampled",
            "common/display_distorted_2d",
        ),
    }
    results = []
    for name, chosen in files.items():
        inputs = [data / f"{one}.h5" for one in (*chosen, "common/spatial_orientation")]
        folder = tmp_path / name
        import_opencsp([*inputs, data / "common" / "Facet_NSTTF.json"], folder, OpencspOptions(focal_length_m=150.0))
        measure(folder, tmp_path / f"{name}-result")
        results.append(tmp_path / f"{name}-result")
    found = compare_results(*results)
    assert found.judgement.agreement is Agreement.CONTRADICT
    assert found.judgement.blamed == "dots-result"
    assert {"curvature_x", "curvature_y", "shear"} <= set(found.judgement.contradicting)
    assert found.placed.likeness.correlation > 0.95
    # A change in x and y would be 3 mrad; half of the publisher's 0.22 mrad is quadratic.
    assert np.sqrt(np.mean(found.terms.rest_rms_rad**2)) < 0.215e-3
    first, second = (one.values[2:4] for one in found.own_terms)
    assert (first < 0).all()
    assert (second > 0).all()


def test_an_even_map_has_no_correlation(tmp_path: Path) -> None:
    """A map of one slope all over, as exact, has no fine structure: rounding is none."""
    one = drawn_map(np.random.default_rng(0))
    zero = np.zeros_like(one.slope_x)
    even = replace(one, slope_x=zero + 1e-4, slope_y=zero, sigma_random_x=zero, sigma_random_y=zero)
    found = compare_results(written(tmp_path / "a", one), written(tmp_path / "even", even))
    assert found.summarise().numbers["fine_structure_correlation_ratio"] is None
    assert "different_mirrors" not in {one.code for one in found.doubts}


#: Facets of an ensemble and the sigmas of its canting: of each facet by itself, and of what turns all alike.
FACETS, OWN_RAD, ALL_RAD = 5, 3e-5, 2e-3


def drawn_ensemble(rng: np.random.Generator, leans: FloatArray) -> dict[str, SlopeMap]:
    """Draw facets that lean (f, 2), measured with errors of each facet and one that turns all."""
    found, of_all = {}, ALL_RAD * rng.normal(size=2)
    for number, lean in enumerate(leans):
        one = drawn_map(rng, step_m=0.06)
        off = lean + of_all + OWN_RAD * rng.normal(size=2)
        tilts = np.zeros((2 + 2 * FACETS, 2, 3))
        tilts[0, 0, 0] = tilts[1, 1, 0] = ALL_RAD
        tilts[2 + 2 * number, 0, 0] = tilts[3 + 2 * number, 1, 0] = OWN_RAD
        sources = ("mirror pose",) * 2 + ("facet place",) * (2 * FACETS)
        common = CommonModes(sources, tilts, np.zeros(2), 1.0)
        found[f"facet {number}"] = replace(
            one, slope_x=one.slope_x + off[0], slope_y=one.slope_y + off[1], common=common
        )
    return found


def test_canting_differs_as_its_sigmas_say() -> None:
    """What turns all facets by milliradians cancels; of 24 pairs chi-square has 2 (f - 1) degrees of freedom each."""
    rng, chances, squares = np.random.default_rng(1), [], []
    for _ in range(24):
        leans = 1e-3 * rng.normal(size=(FACETS, 2))
        found = canting_difference(drawn_ensemble(rng, leans), drawn_ensemble(rng, leans), ())
        assert found is not None
        chances.append(found.probability)
        squares.append(np.mean((found.difference_rad / found.sigma_rad) ** 2))
    assert np.mean(squares) == pytest.approx(1.0, abs=3 * np.sqrt(2 / (24 * 8)))
    assert 0.3 < np.mean(chances) < 0.7


def test_facets_that_are_not_compared_have_a_reason(tmp_path: Path) -> None:
    """By name, one is missing, one has another design, and one is hardly measured; two are compared."""
    rng, leans = np.random.default_rng(3), np.zeros((FACETS, 2))
    first, second = drawn_ensemble(rng, leans), drawn_ensemble(rng, leans)
    second["other"] = second.pop("facet 0")
    second["facet 1"] = replace(second["facet 1"], design="another one")
    hidden = np.where(np.arange(second["facet 2"].slope_x.shape[1]) > 2, np.nan, second["facet 2"].slope_x)
    second["facet 2"] = replace(second["facet 2"], slope_x=hidden, slope_y=hidden)
    left = facets_left_out(first, second)
    assert list(left) == ["facet 0", "facet 1", "facet 2"]
    assert "name" in left["facet 0"]
    assert "designs" in left["facet 1"]
    assert "measured" in left["facet 2"]
    folders = [written(tmp_path / name, maps["facet 3"]) for name, maps in (("a", first), ("b", second))]
    for folder, maps in zip(folders, (first, second), strict=True):
        write_slope_map(folder / "slope_map.nc", {**maps, ASSEMBLED: maps["facet 3"]})
    (doubt,) = [one for one in compare_results(*folders).doubts if one.code == "facets_not_compared"]
    assert doubt.numbers == {"compared_count": 2, "facets_count": FACETS}


def ring_of_facets(turn_rad: float) -> dict[str, RigidTransform]:
    """Five facets on a ring, each canted towards its middle by 20 mrad and by 2 mrad of its own, in a turned frame."""
    turned = RigidTransform.from_rotation_vector([0.0, 0.0, -turn_rad], np.zeros(3))
    found = {}
    for number in range(FACETS):
        angle = 2 * np.pi * number / FACETS
        place = 2.0 * np.array([np.cos(angle), np.sin(angle), 0.0])
        lean = np.array([-0.02 * np.sin(angle), 0.02 * np.cos(angle), 0.0])
        found[f"facet {number}"] = turned @ RigidTransform.from_rotation_vector(lean, place)
    return found


def drawn_in_frame(leans: FloatArray, turn_rad: float, moved: int) -> dict[str, SlopeMap]:
    """Return maps of facets that lean (f, 2) in the ensemble, as seen in a turned frame by other names."""
    own = leans @ _about_z(turn_rad)[:2, :2]
    return drawn_ensemble(np.random.default_rng(moved), np.roll(own, moved, axis=0))


@pytest.mark.parametrize("turn_rad", [0.5 * np.pi + 3e-3, np.pi, -0.01])
def test_canting_is_compared_where_one_map_was_moved(turn_rad: float) -> None:
    """Facets are known by their places, whatever their names and however their frames are turned."""
    leans = 1e-3 * np.random.default_rng(5).normal(size=(FACETS, 2))
    first = drawn_ensemble(np.random.default_rng(7), leans)
    frames = ring_of_facets(0.0)
    squares = []
    for moved in range(FACETS):
        second = drawn_in_frame(leans, turn_rad, moved)
        # Their frames turn about z with the ensemble's, and facet n has the name of facet n + moved.
        names = [f"facet {(number + moved) % FACETS}" for number in range(FACETS)]
        frames_there = {
            name: RigidTransform(one.rotation @ _about_z(turn_rad), one.translation_m)
            for name, one in zip(names, ring_of_facets(turn_rad).values(), strict=True)
        }
        pairs = partners(frames, frames_there, PlaneMotion(turn_rad, np.zeros(2)))
        assert {one.first: one.second for one in pairs} == dict(zip(frames, names, strict=True))
        found = canting_difference(first, second, facets_left_out(first, second, pairs), pairs)
        assert found is not None
        assert found.names == tuple(frames)
        squares.append(np.mean((found.difference_rad / found.sigma_rad) ** 2))
    # Half of the variance is that of the first, the same in all five: 8 numbers, and 40.
    assert np.mean(squares) == pytest.approx(1.0, abs=3 * np.sqrt(0.25 * 2 / 8 + 0.25 * 2 / 40))
    # 5 mrad between the frames move facets canted by 20 mrad by 0.1 mrad, half of it squared in x and half in y.
    unsure = canting_difference(first, second, (), pairs, 5e-3)
    assert unsure is not None
    added = np.sum(unsure.sigma_rad**2 - found.sigma_rad**2, axis=0)
    assert added == pytest.approx(0.5 * FACETS * 1e-4**2, rel=0.1)
    by_name = canting_difference(first, second, ())
    assert by_name is not None
    assert np.abs(by_name.difference_rad / by_name.sigma_rad).max() > 10


def test_designs_in_turned_frames_are_compared_by_their_slopes() -> None:
    """Off-axis facets of one paraboloid name other slopes in a turned frame; a trough has the same words both ways."""
    turn = 0.5 * np.pi
    partner = FacetPartner("facet", "facet", _about_z(turn)[:2, :2], np.zeros(2), np.zeros(2))

    def left_out(second: SlopeMap, sigma_turn_rad: float = 0.0) -> dict[str, str]:
        return facets_left_out({"facet": first}, {"facet": second}, [partner], sigma_turn_rad)

    one = drawn_map(np.random.default_rng(1), step_m=0.06)
    x, y = one.design_slope_x, one.design_slope_y
    first = replace(one, design_slope_x=x + 0.02, design="paraboloid (slopes 20, 0 mrad at the origin of its frame)")
    # What leans by 20 mrad along the first's x does so along -y of a frame that is turned by a quarter.
    words = "paraboloid (slopes 0, -20 mrad at the origin of its frame)"
    assert left_out(replace(one, design_slope_y=y - 0.02, design=words)) == {}
    assert "designs" in left_out(replace(one, design_slope_y=y + 0.02, design=words))["facet"]
    longer = replace(one, design_slope_x=0.97 * x, design_slope_y=0.97 * y - 0.02)
    assert "designs" in left_out(longer)["facet"]
    # 0.1 mrad of 20 are a turn of 5 mrad.
    turned = replace(one, design_slope_x=x + 1e-4, design_slope_y=y - 0.02)
    assert "designs" in left_out(turned)["facet"]
    assert left_out(turned, 5e-3) == {}
    first = replace(one, design_slope_y=np.zeros_like(y), design="trough")
    assert left_out(replace(one, design_slope_x=np.zeros_like(x), design="trough")) == {}
    assert "designs" in left_out(first)["facet"]


@pytest.mark.slow
def test_results_in_turned_frames_have_their_canting_compared(tmp_path: Path) -> None:
    turn_rad = 0.5 * np.pi + 3e-3
    leans = 1e-3 * np.random.default_rng(5).normal(size=(FACETS, 2))
    turned = _about_z(turn_rad)
    maps = drawn_ensemble(np.random.default_rng(7), leans), drawn_in_frame(leans, turn_rad, 0)
    roots = drawn_map(np.random.default_rng(1)), drawn_map(np.random.default_rng(2), turn_rad=turn_rad)
    folders = []
    for number, (of_facets, root, by) in enumerate(zip(maps, roots, (0.0, turn_rad), strict=True)):
        folders.append(written(tmp_path / str(number), root))
        write_slope_map(folders[-1] / "slope_map.nc", {**of_facets, ASSEMBLED: root})
        frames = {
            name: RigidTransform(one.rotation @ (turned if by else np.eye(3)), one.translation_m)
            for name, one in ring_of_facets(by).items()
        }
        told = {k: [one.rotation_vector_rad.tolist(), one.translation_m.tolist()] for k, one in frames.items()}
        summary = Summary("slopes", "facet", {"measured_share": 1.0}, geometry_m={"facet_frames": told})
        write_summary(folders[-1] / "summary.json", summary)
    found = compare_results(*folders)
    assert found.placed.is_moved
    assert found.cantings is not None
    assert found.cantings.probability > 0.001


def _about_z(turn_rad: float) -> FloatArray:
    return RigidTransform.from_rotation_vector([0.0, 0.0, turn_rad], np.zeros(3)).rotation


def test_a_facet_that_was_turned_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    leans = 1e-3 * rng.normal(size=(FACETS, 2))
    folders = []
    for name, there in (("before", leans), ("after", leans + 5e-4 * np.eye(FACETS, 2, -3))):
        maps = drawn_ensemble(rng, there)
        folders.append(written(tmp_path / name, maps["facet 0"]))
        write_slope_map(folders[-1] / "slope_map.nc", {**maps, ASSEMBLED: maps["facet 0"]})
    out = tmp_path / "out"
    ended = CliRunner().invoke(app, ["compare", *map(str, folders), "-o", str(out), "--quiet"])
    assert ended.exit_code == 1
    found = compare_results(*folders)
    (doubt,) = [one for one in found.doubts if one.code == "cantings_contradict"]
    assert "facet 3 differs most" in doubt.text
    assert (out / "canting_difference.csv").is_file()
    assert "Canting of facets" in (out / "report.html").read_text(encoding="utf-8")
