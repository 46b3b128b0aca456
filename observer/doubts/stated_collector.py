"""What measurement.toml leaves out of the collector, or says of it and its targets that hardly belongs together."""

from collections.abc import Iterator, Sequence

import numpy as np

from heliogauge.doubts import Doubt
from observer.keys import TroughSection
from observer.trough.collector import Collector
from photogrammetry.keys import CoordinateSection

#: Mirrors wider or longer than this have several panels: glass ones are up to 1.7 m (RP3 of LS-3 and EuroTrough).
_ONE_PANEL_M = 2.0
#: Outer edges that leave more of the mirror over than this share of its narrowest panel do not contain all panels.
_LEFT_SHARE = 0.5
#: So many targets are named.
_MOST_NAMED = 5


def panels_doubts(section: TroughSection) -> Iterator[Doubt]:
    """Yield what the collector's data lack of the panels: no edges where there must be some, or not the outer ones.

    An edge list that is stated, be it empty, is believed; two edges are those of one panel that is measured alone.
    """
    size_m = {"panel_edges_x_m": section.aperture_width_m, "panel_edges_y_m": section.length_m}
    lacking = [name for name, size in size_m.items() if name not in section.model_fields_set and size > _ONE_PANEL_M]
    if lacking:
        yield Doubt(
            "one_panel_assumed",
            f"collector.{' and '.join(lacking)} not stated: the mirror, {section.aperture_width_m:g} m x "
            f"{section.length_m:g} m, is taken for one panel there. Slopes are smeared over its joints, by more than "
            "their sigma says, and which panel to turn is not told; state all edges, the outer ones too, and "
            "panel_gap_mm ([] says that it is one panel)",
        )
    for name, size in size_m.items():
        edges = np.array(getattr(section, name))
        left = 0.5 * size - np.abs(edges[[0, -1]]) if edges.size > 2 else np.zeros(2)
        if left.max() > _LEFT_SHARE * np.diff(edges).min(initial=np.inf):
            yield Doubt(
                "panel_edges_end_inside",
                f"collector.{name} runs from {edges[0]:g} to {edges[-1]:g} m, the mirror from {-0.5 * size:g} to "
                f"{0.5 * size:g} m: what is beyond the outermost edges is not measured; state all edges, the outer "
                "ones too",
                {"left_out_m": float(left.max())},
            )


def supports_doubt(section: TroughSection) -> Doubt | None:
    """Say that nobody stated where the tube is held; None where that, or that it is nowhere, is stated."""
    if "support_y_m" in section.model_fields_set:
        return None
    return Doubt(
        "no_supports_assumed",
        "collector.support_y_m not stated: the tube is taken to be held and hidden nowhere. Where supports are, their "
        "reflection counts as the tube's and slopes are wrong by far more than their sigma; state them, those at the "
        "ends too, and support_width_m ([] says that there are none)",
    )


def far_targets_doubt(coordinates: Sequence[CoordinateSection], collector: Collector) -> Doubt | None:
    """Say which targets stand further beside the collector than it is large.

    coordinates: Known coordinates of targets in the trough's frame.
    Returns: None where all are near it.
    """
    width, length = collector.aperture_width_m, collector.length_m
    largest = max(width, length)
    reach = {"x": 0.5 * width + largest, "y": 0.5 * length + largest, "z": collector.rim_height_m + largest}
    far = list(dict.fromkeys(one.target for one in coordinates if abs(one.value_m) > reach[one.axis]))
    if not far:
        return None
    count = len({one.target for one in coordinates})
    named = ", ".join(far[:_MOST_NAMED]) + (f" and {len(far) - _MOST_NAMED} more" if len(far) > _MOST_NAMED else "")
    return Doubt(
        "targets_far_from_collector",
        f"targets.file: {len(far)} of {count} targets stand more than {largest:g} m beside the collector "
        f"({width:g} m x {length:g} m): {named}; are their coordinates in metres, and from its vertex?",
        {"far_count": len(far), "targets_count": count},
    )
