"""What changed between two measurements of one trough: its numbers, and which panels turned."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliogauge.adjust.chi_square import chi_square_limit
from heliogauge.errors import InputError
from heliogauge.slopes.mounts import LEAST_SHARE
from heliogauge.validate import BoolArray, FloatArray, IntArray

#: Numbers of a result that are compared, each with a sigma beside it.
COMPARED = (
    "absorber_mean_x_m",
    "absorber_mean_z_offset_m",
    "intercept_ratio",
)
#: A panel is said to have turned where chance makes the largest change of all panels so large once in a hundred times.
_CHANCE = 0.01


@dataclass(frozen=True, slots=True)
class NumberChange:
    """A number of two results.

    key: Its name in summary.json, with the unit.
    before, after: In the first result and in the other one.
    change, sigma_change: Other minus first, and its standard deviation: the two measurements err apart.
    """

    key: str
    before: float
    after: float
    change: float
    sigma_change: float


@dataclass(frozen=True, slots=True, eq=False)
class PanelState:
    """What one measurement says of the panels.

    x_m (nx,), y_m (ny,): Nodes [m].
    theta_r_rad, theta_ra_rad (ny, nx): Angles against the design and against the absorber; NaN where not measured.
    panel (ny, nx): Number of each node's panel, from 0; -1 for nodes of none.
    sigma_theta_r_rad, sigma_theta_ra_rad (k,): Of the mean over what was measured of each panel.
    """

    x_m: FloatArray
    y_m: FloatArray
    theta_r_rad: FloatArray
    theta_ra_rad: FloatArray
    panel: IntArray
    sigma_theta_r_rad: FloatArray
    sigma_theta_ra_rad: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PanelChanges:
    """How far the panels turned from the first result to another one.

    panel (k,): Numbers of the panels, from 1.
    theta_r_change_rad, sigma_theta_r_change_rad (k,): Change of the mean of theta_r, against the design, over what both
        measured; NaN where that is less than half of the panel [rad].
    theta_ra_change_rad, sigma_theta_ra_change_rad (k,): The same of theta_ra, against the absorber [rad].
    common_share (k,): Share of the panel that both measured.
    is_sure (k,): Where one of the two is beyond what chance makes of the largest of all once in a hundred times.
    """

    panel: IntArray
    theta_r_change_rad: FloatArray
    sigma_theta_r_change_rad: FloatArray
    theta_ra_change_rad: FloatArray
    sigma_theta_ra_change_rad: FloatArray
    common_share: FloatArray
    is_sure: BoolArray


def number_changes(
    first: Mapping[str, float | int | None], other: Mapping[str, float | int | None]
) -> tuple[NumberChange, ...]:
    """Return how numbers changed that both results have.

    first, other: Numbers of their summaries, with sigmas.
    """
    found = []
    for key in COMPARED:
        parts = [numbers.get(name) for numbers in (first, other) for name in (key, f"sigma_{key}")]
        if all(part is not None for part in parts):
            before, sigma_before, after, sigma_after = (float(part or 0.0) for part in parts)
            sigma = float(np.hypot(sigma_before, sigma_after))
            found.append(NumberChange(key, before, after, after - before, sigma))
    return tuple(found)


def panel_changes(first: PanelState, other: PanelState) -> PanelChanges:
    """Return how far each panel turned.

    InputError: The collectors have other panels.

    Means over all that each measured would differ with the holes of either map: a panel is bent. The sigma of a mean
    is known for all of what was measured; over a part of it, it is taken to grow as that of noise would.
    """
    count = first.sigma_theta_r_rad.size
    if other.sigma_theta_r_rad.size != count:
        raise InputError(
            f"observer compare: {count} and {other.sigma_theta_r_rad.size} panels; results of one collector with the "
            "same panel_edges_x_m and panel_edges_y_m are needed"
        )
    own = first.panel >= 0
    of_panel = np.bincount(first.panel[own], minlength=count)
    changes, sigmas = [], []
    for name in ("theta_r_rad", "theta_ra_rad"):
        change = _on_nodes_of(first, other, getattr(other, name)) - getattr(first, name)
        both = own & np.isfinite(change)
        common = np.bincount(first.panel[both], minlength=count)
        mean = np.bincount(first.panel[both], change[both], count) / np.maximum(common, 1)
        measured = np.bincount(first.panel[own & np.isfinite(getattr(first, name))], minlength=count)
        sigma = np.hypot(getattr(first, f"sigma_{name}"), getattr(other, f"sigma_{name}"))
        known = common >= LEAST_SHARE * of_panel
        changes.append(np.where(known, mean, np.nan))
        sigmas.append(np.where(known, sigma * np.sqrt(measured / np.maximum(common, 1)), np.nan))
    share, undecided = common / np.maximum(of_panel, 1), np.zeros(count, dtype=np.bool_)
    numbers = np.arange(1, count + 1)
    found = PanelChanges(numbers, changes[0], sigmas[0], changes[1], sigmas[1], np.asarray(share), undecided)
    return decide_together([found])[0]


def decide_together(parts: Sequence[PanelChanges]) -> tuple[PanelChanges, ...]:
    """Decide which panels surely turned among all of several comparisons, as of the modules of a field.

    parts: Changes of panels; what they say of being sure does not count.
    Returns: The same, sure where chance makes the largest change of all panels so large once in a hundred times.
    """
    times = [
        np.abs([one.theta_r_change_rad, one.theta_ra_change_rad])
        / np.stack([one.sigma_theta_r_change_rad, one.sigma_theta_ra_change_rad])
        for one in parts
    ]
    limit = _limit(sum(int(np.isfinite(one).sum()) for one in times))
    sure = [np.nan_to_num(one).max(axis=0, initial=0.0) > limit for one in times]
    return tuple(replace(one, is_sure=np.asarray(own)) for one, own in zip(parts, sure, strict=True))


def surely_changed(changes: Sequence[Sequence[NumberChange]]) -> list[list[bool]]:
    """Return which numbers surely changed, by the same rule: among all numbers of several comparisons."""
    limit = _limit(sum(len(one) for one in changes))
    return [[abs(each.change) > limit * each.sigma_change for each in one] for one in changes]


def _limit(count: int) -> float:
    """Return how many sigma the largest of so many changes exceeds by chance once in a hundred times."""
    return float(np.sqrt(chi_square_limit(_CHANCE / max(count, 1), 1)))


def _on_nodes_of(first: PanelState, other: PanelState, values: FloatArray) -> FloatArray:
    """Return values of the other map at the nodes of the first; NaN beside what was measured."""
    from scipy.interpolate import RegularGridInterpolator

    if np.array_equal(first.x_m, other.x_m) and np.array_equal(first.y_m, other.y_m):
        return values
    places = RegularGridInterpolator((other.y_m, other.x_m), values, bounds_error=False)
    return np.asarray(places(np.stack(np.meshgrid(first.y_m, first.x_m, indexing="ij"), axis=-1)))
