"""What a measurement without a slope map will be worth: standard deviations of its own numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from heliogauge.doubts import Doubt


@dataclass(frozen=True, slots=True, eq=False)
class SigmaProspect:
    """What a measurement without a slope map will be worth.

    promised: Standard deviations by the names of the numbers, with unit ("width_m"); NaN where not determined.
    labels: Words of each.
    not_determined: Why one is NaN, by its name.
    numbers: What else the plan counts.
    shares: What else an alternative may change, by names ending with ``_share``.
    share_labels: Words of each.
    texts: What else is to be said, by its name.
    facets: Numbers of each facet by its name.
    tables: What is written beside, by the file's name.
    """

    promised: Mapping[str, float]
    labels: Mapping[str, str]
    not_determined: Mapping[str, str]
    numbers: Mapping[str, float | int | None]
    shares: Mapping[str, float]
    share_labels: Mapping[str, str]
    texts: Mapping[str, str]
    facets: Mapping[str, Mapping[str, float | int | None]] = field(default_factory=dict)
    tables: Mapping[str, Mapping[str, Sequence[Any]]] = field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()

    def sigmas(self) -> Mapping[str, float]:
        """Return what the plan is about."""
        return self.promised

    def beside(self) -> Mapping[str, float]:
        """Return what else an alternative may change."""
        return self.shares

    def known_facets(self) -> frozenset[str]:
        """Return the names of the facets of which a number is promised."""
        return frozenset(name for name, own in self.facets.items() if any(one is not None for one in own.values()))
