"""Length measurement error: known lengths as a network has them, in the form of VDI/VDE 2634 part 1."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, IntArray, positive
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.bundle.constraints import Distance

#: What the guideline asks for: so many measuring lines, with so many lengths on each.
LINES_NEEDED = 7
LENGTHS_PER_LINE_NEEDED = 5
#: Targets within this share of the network's extent of one straight line are on one measuring line.
_LINE_SHARE = 0.02
#: A length whose own known value makes this share of what is known of it has nothing to be compared with.
_ALONE = 1e-6
#: An error is outside, or inside, the limits when the known length's expanded uncertainty (k = 2) cannot change it.
_COVERAGE = 2.0


class LengthRole(StrEnum):
    """How a known length and its measured value came together."""

    KEPT_APART = "kept apart"
    LEFT_OUT = "left out"


class Verdict(StrEnum):
    """Whether an error is permissible; open where the known length's own uncertainty decides."""

    INSIDE = "inside"
    OUTSIDE = "outside"
    OPEN = "open"
    NO_LIMIT = ""


@dataclass(frozen=True, slots=True)
class PermissibleError:
    """Largest permissible length measurement error ``E(L) = A + L / K``, never above B.

    a_m: A, the error permitted at length zero [m].
    k: K, dimensionless: 100 000 adds 10 um for each metre.
    b_m: B, the error permitted at any length [m].
    InputError: A number is not positive, or B is below A.

    >>> round(PermissibleError(a_m=1e-5, k=100_000, b_m=5e-5).at(2.0), 9)
    3e-05
    """

    a_m: float
    k: float = float("inf")
    b_m: float = float("inf")

    def __post_init__(self) -> None:
        positive("permissible length error: A", self.a_m, "metres")
        if not self.k > 0:
            raise InputError(f"permissible length error: K = {self.k}: a positive number is needed")
        if not self.b_m >= self.a_m:
            raise InputError(f"permissible length error: B = {self.b_m:g} m is below A = {self.a_m:g} m")

    def at(self, length_m: float) -> float:
        """Return the permissible error of one length [m]."""
        return min(self.a_m + length_m / self.k, self.b_m)


@dataclass(frozen=True, slots=True, eq=False)
class LengthCheck:
    """One known length against a network that did not use it.

    name: The two targets.
    role: Kept apart from the adjustment, or left out of it for this comparison only.
    measured_m, sigma_measured_m: The network's length, and its sigma from the joint covariance of both targets [m].
    ends_m (2, 3): The two targets [m].
    line: Number of its measuring line, counted from 1.
    permissible_m: Permissible error; infinite without a limit [m].
    """

    name: str
    role: LengthRole
    known_m: float
    sigma_known_m: float
    measured_m: float
    sigma_measured_m: float
    ends_m: FloatArray
    line: int = 0
    permissible_m: float = float("inf")

    @property
    def error_m(self) -> float:
        """Measured minus known [m]."""
        return self.measured_m - self.known_m

    @property
    def sigma_error_m(self) -> float:
        """Sigma of the error: the measured length and the known one are independent [m]."""
        return float(np.hypot(self.sigma_measured_m, self.sigma_known_m))

    @property
    def verdict(self) -> Verdict:
        """Whether the error is permissible.

        Inside or outside only where the known length's expanded uncertainty (2 sigma) cannot change the answer, as
        ISO 14253-1 has it.
        """
        if not np.isfinite(self.permissible_m):
            return Verdict.NO_LIMIT
        spare = self.permissible_m - abs(self.error_m)
        if abs(spare) < _COVERAGE * self.sigma_known_m:
            return Verdict.OPEN
        return Verdict.INSIDE if spare > 0 else Verdict.OUTSIDE


@dataclass(frozen=True, slots=True, eq=False)
class LengthStatement:
    """The quality of a network in known lengths.

    checks: The comparisons: those kept apart first, then each used length left out once.
    not_checked: Used lengths without which the network has no scale, and lengths of targets that are not in it.
    permissible: The limit.
    """

    checks: tuple[LengthCheck, ...]
    not_checked: tuple[str, ...]
    permissible: PermissibleError | None

    def of(self, role: LengthRole) -> tuple[LengthCheck, ...]:
        """Return the comparisons of one kind."""
        return tuple(one for one in self.checks if one.role is role)

    @property
    def best(self) -> tuple[LengthCheck, ...]:
        """Lengths kept apart, or those left out where none was kept apart."""
        return self.of(LengthRole.KEPT_APART) or self.of(LengthRole.LEFT_OUT)

    @property
    def verdict(self) -> Verdict:
        """Outside if one error is, else open if one is, else inside; nothing without a limit or a length."""
        found = {one.verdict for one in self.best}
        return next((one for one in (Verdict.OUTSIDE, Verdict.OPEN, Verdict.INSIDE) if one in found), Verdict.NO_LIMIT)

    @property
    def lengths_of_line(self) -> tuple[int, ...]:
        """Number of lengths on each measuring line, most first."""
        lines = np.array([one.line for one in self.best], dtype=np.intp)
        return tuple(sorted((int(n) for n in np.bincount(lines)[1:] if n), reverse=True)) if lines.size else ()

    @property
    def coverage_text(self) -> str:
        """What of the guideline's arrangement is fulfilled, in words."""
        counts = self.lengths_of_line
        if not counts:
            return "no length to check with; keep a scale bar apart (check_only = true) or give at least two"
        full = sum(count >= LENGTHS_PER_LINE_NEEDED for count in counts)
        apart = self.best[0].role is LengthRole.KEPT_APART
        role = "kept apart" if apart else "that were used, each left out once,"
        said = (
            f"{_count(sum(counts), 'length')} {role} on {_count(len(counts), 'measuring line')}, {full} of them "
            f"with {LENGTHS_PER_LINE_NEEDED} or more; VDI/VDE 2634 part 1 asks for {LINES_NEEDED} lines with "
            f"{LENGTHS_PER_LINE_NEEDED} each: "
        )
        return said + ("fulfilled" if apart and full >= LINES_NEEDED else "a check, no acceptance test")


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def state_length_errors(
    bundle: BundleResult, checks: Sequence[Distance] = (), permissible: PermissibleError | None = None
) -> LengthStatement:
    """Compare known lengths with a network that did not use them.

    checks: Lengths that were kept apart. Every length that was used is also left out once.
    permissible: Limit of the errors.

    A length that was used is predicted without it in closed form: with the leverage ``h = s^2 / sigma^2`` of its
    known value (s the adjusted length's sigma, sigma its own), the network without it differs from the known value by
    ``e / (1 - h)`` and has the variance ``s^2 / (1 - h)``, to first order what an adjustment without it gives. At ``h
    = 1`` the length alone is the scale, and nothing is left to compare it with.
    """
    place = {name: i for i, name in enumerate(bundle.problem.observations.targets)}
    used = [one for one in bundle.problem.constraints if isinstance(one, Distance)]
    found: list[LengthCheck] = []
    missing: list[str] = []
    for known, role in [
        *((one, LengthRole.KEPT_APART) for one in checks),
        *((one, LengthRole.LEFT_OUT) for one in used),
    ]:
        if not all(name in place for name in known.targets):
            missing.append(f"{known.name}: not in the network")
            continue
        pair = np.array([place[name] for name in known.targets], dtype=np.intp)
        length, sigma = measured_length(bundle, pair)
        if role is LengthRole.LEFT_OUT:
            rest = 1 - (sigma / known.sigma_m) ** 2
            if not rest > _ALONE:
                missing.append(f"{known.name}: without it nothing gives the scale")
                continue
            length, sigma = known.distance_m + (length - known.distance_m) / rest, sigma / np.sqrt(rest)
        if not np.isfinite(length):
            missing.append(f"{known.name}: its targets are not determined")
            continue
        limit = float("inf") if permissible is None else permissible.at(known.distance_m)
        found.append(
            LengthCheck(
                known.name,
                role,
                known.distance_m,
                known.sigma_m,
                length,
                float(sigma),
                bundle.points_m[pair],
                permissible_m=limit,
            )
        )
    if not scale_is_known(bundle):
        # Lengths in an arbitrary unit have no error.
        return LengthStatement((), tuple(one.name + ": the network has no scale" for one in found), permissible)
    numbered = [one for role in LengthRole for one in _number([c for c in found if c.role is role], _extent_m(bundle))]
    return LengthStatement(tuple(numbered), tuple(missing), permissible)


def scale_is_known(bundle: BundleResult) -> bool:
    """Say whether constraints or fixed targets give the network its scale.

    Returns: False where coordinates are in an arbitrary unit.
    """
    shares = bundle.system.movements.shares
    return not bool(np.linalg.norm(shares[6]) > 1e-6) if shares.size else True


def measured_length(bundle: BundleResult, pair: IntArray) -> tuple[float, float]:
    """Return the distance of two targets with its sigma.

    Shapes: pair (2,).
    Returns: Distance and sigma from the joint covariance of both targets; the sigma of fixed ones is 0 [m].
    """
    difference = bundle.points_m[pair[0]] - bundle.points_m[pair[1]]
    length = float(np.linalg.norm(difference))
    direction = np.concatenate([difference, -difference]) / length
    free = np.isin(pair, bundle.problem.target_indices(bundle.problem.fixed), invert=True)
    joint = np.zeros((6, 6))
    if free.any():
        rows = np.nonzero(np.repeat(free, 3))[0]
        joint[np.ix_(rows, rows)] = bundle.covariance.joint(targets=pair[free])
    return length, float(np.sqrt(max(float(direction @ joint @ direction), 0.0)))


def _extent_m(bundle: BundleResult) -> float:
    points = bundle.points_m[np.isfinite(bundle.points_m).all(axis=1)]
    return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0


def _number(checks: list[LengthCheck], extent_m: float) -> list[LengthCheck]:
    """Give each length its measuring line: the longest one opens a line, those along it are on it."""
    line_of: dict[int, int] = {}
    count = 0
    for first in sorted(range(len(checks)), key=lambda i: -checks[i].known_m):
        if first in line_of:
            continue
        count += 1
        start, end = checks[first].ends_m
        along = (end - start) / np.linalg.norm(end - start)
        for other, one in enumerate(checks):
            arms = one.ends_m - start
            beside = np.linalg.norm(arms - np.outer(arms @ along, along), axis=1)
            if other not in line_of and (beside <= _LINE_SHARE * extent_m).all():
                line_of[other] = count
    return [replace(one, line=line_of[i]) for i, one in enumerate(checks)]
