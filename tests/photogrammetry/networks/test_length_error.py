"""Known lengths against networks that did not use them."""

from dataclasses import replace

import numpy as np
import pytest

from heliogauge.errors import InputError
from photogrammetry.bundle.adjustment import adjust
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.problem import BundleProblem, CameraModel
from photogrammetry.bundle.state import BundleState
from photogrammetry.networks.length_error import LengthRole, PermissibleError, Verdict, state_length_errors
from tests.photogrammetry.bundle_networks import camera_of, look_at, observe


def grid_network(rng, sigma_px=0.05):
    """Six photos of targets on a grid, three rows of five."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-0.5, 0.5, 3)))
    points = np.column_stack([x, y, 0.1 * np.sin(5 * x)])
    angles = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    poses = [look_at(np.array([1.6 * np.cos(a), 1.6 * np.sin(a), 2.0]), np.zeros(3), a) for a in angles]
    truth = BundleState.from_poses([camera_of()], poses, points)
    return truth, observe(truth, rng, sigma_px)


def true_length(truth, a, b):
    return float(np.linalg.norm(truth.points_m[int(a[1:])] - truth.points_m[int(b[1:])]))


def bars_with_noise(truth, pairs, rng, sigma_m):
    return tuple(Distance(a, b, true_length(truth, a, b) + rng.normal(0, sigma_m), sigma_m) for a, b in pairs)


BARS = (("t0", "t4"), ("t10", "t14"), ("t0", "t10"))
APART = (("t4", "t14"), ("t5", "t9"), ("t1", "t3"))


def test_leaving_a_bar_out_is_what_an_adjustment_without_it_gives() -> None:
    rng = np.random.default_rng(3)
    truth, points = grid_network(rng)
    bars = bars_with_noise(truth, BARS, rng, 5e-5)
    together = state_length_errors(adjust(BundleProblem(points, (CameraModel("c"),), None, bars), truth))
    for place, one in enumerate(together.of(LengthRole.LEFT_OUT)):
        others = (*bars[:place], *bars[place + 1 :])
        alone = adjust(BundleProblem(points, (CameraModel("c"),), None, others), truth)
        (apart,) = state_length_errors(alone, bars[place : place + 1]).of(LengthRole.KEPT_APART)
        assert one.error_m == pytest.approx(apart.error_m, rel=1e-3)
        assert one.sigma_measured_m == pytest.approx(apart.sigma_measured_m, rel=1e-4)


def test_errors_scatter_as_their_sigma_says() -> None:
    rng = np.random.default_rng(4)
    truth, _ = grid_network(rng)
    ratios = {role: [] for role in LengthRole}
    for _ in range(60):
        bars, apart = (bars_with_noise(truth, pairs, rng, 4e-5) for pairs in (BARS, APART))
        problem = BundleProblem(observe(truth, rng, 0.05), (CameraModel("c"),), None, bars)
        for one in state_length_errors(adjust(problem, truth), apart).checks:
            ratios[one.role].append((one.error_m / one.sigma_error_m) ** 2)
    for role, values in ratios.items():
        # Three lengths of one network share its scale: not quite 180 independent values.
        assert len(values) == 180, role
        assert abs(np.mean(values) - 1) < 4 * np.sqrt(2 / 60), role


def test_the_only_bar_cannot_be_checked() -> None:
    rng = np.random.default_rng(5)
    truth, points = grid_network(rng)
    bars = bars_with_noise(truth, BARS[:1], rng, 5e-5)
    statement = state_length_errors(adjust(BundleProblem(points, (CameraModel("c"),), None, bars), truth))
    assert statement.checks == ()
    assert statement.not_checked == ("distance t0 - t4: without it nothing gives the scale",)
    assert "keep a scale bar apart" in statement.coverage_text


def test_lengths_without_scale_have_no_error() -> None:
    rng = np.random.default_rng(6)
    truth, points = grid_network(rng)
    free = adjust(BundleProblem(points, (CameraModel("c"),)), truth)
    statement = state_length_errors(free, bars_with_noise(truth, APART, rng, 5e-5))
    assert statement.checks == ()
    assert all("no scale" in text for text in statement.not_checked)


def test_measuring_lines_are_counted() -> None:
    rng = np.random.default_rng(7)
    truth, points = grid_network(rng)
    flat = BundleState.from_poses(
        truth.cameras, [truth.cam_from_world(i) for i in range(6)], truth.points_m * [1, 1, 0]
    )
    points = observe(flat, rng)
    bars = bars_with_noise(flat, BARS, rng, 5e-5)
    # A row of five targets holds ten lengths, which are one line; two across are two more.
    row = [(f"t{i}", f"t{j}") for i in range(5, 10) for j in range(i + 1, 10)]
    apart = bars_with_noise(flat, [*row, ("t4", "t14"), ("t0", "t14")], rng, 5e-5)
    network = adjust(BundleProblem(points, (CameraModel("c"),), None, bars), flat)
    statement = state_length_errors(network, apart)
    assert statement.lengths_of_line == (10, 1, 1)
    assert "12 lengths kept apart on 3 measuring lines, 1 of them with 5 or more" in statement.coverage_text
    assert "a check, no acceptance test" in statement.coverage_text


def test_seven_lines_of_five_lengths_are_an_acceptance_test() -> None:
    rng = np.random.default_rng(9)
    truth, points = grid_network(rng)
    network = adjust(BundleProblem(points, (CameraModel("c"),), None, bars_with_noise(truth, BARS, rng, 5e-5)), truth)
    statement = state_length_errors(network, bars_with_noise(truth, APART[:1], rng, 5e-5))
    one = statement.checks[0]
    for lines, words in (
        (7, "35 lengths kept apart on 7 measuring lines, 7 of them with 5 or more"),
        (6, "6 measuring"),
    ):
        many = replace(statement, checks=tuple(replace(one, line=i % lines + 1) for i in range(5 * lines)))
        assert words in many.coverage_text
        assert many.coverage_text.endswith(": fulfilled") is (lines == 7)


def test_limits_decide_with_the_known_lengths_own_uncertainty() -> None:
    rng = np.random.default_rng(8)
    truth, points = grid_network(rng, 0.005)
    network = adjust(BundleProblem(points, (CameraModel("c"),), None, bars_with_noise(truth, BARS, rng, 1e-6)), truth)
    length = true_length(truth, *APART[0])
    # The error is -0.1 mm to 1 um; the limit at 1 m is 0.03 + 0.01 L mm.
    for off_m, sigma_m, verdict in ((1e-4, 1e-5, "outside"), (1e-4, 1e-4, "open"), (1e-5, 1e-6, "inside")):
        wrong = Distance(*APART[0], length + off_m, sigma_m)
        statement = state_length_errors(network, [wrong], PermissibleError(3e-5, 1e5))
        assert statement.verdict is Verdict(verdict)
        assert statement.of(LengthRole.KEPT_APART)[0].error_m == pytest.approx(-off_m, abs=5e-6)
    assert state_length_errors(network, [wrong]).verdict is Verdict.NO_LIMIT


def test_permissible_error() -> None:
    limit = PermissibleError(2e-5, 50_000, 6e-5)
    assert [limit.at(length) for length in (0.0, 1.0, 5.0)] == pytest.approx([2e-5, 4e-5, 6e-5])
    for wrong in ({"a_m": 0.0}, {"a_m": 1e-5, "k": 0.0}, {"a_m": 1e-5, "b_m": 1e-6}):
        with pytest.raises(InputError, match="permissible length error"):
            PermissibleError(**wrong)
