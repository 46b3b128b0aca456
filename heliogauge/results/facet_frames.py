"""Where the facets of a mirror stand in its frame, in a summary: what tells facets of two results from each other."""

from collections.abc import Sequence

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.results.folder import Summary

_KEY = "facet_frames"


def facet_geometry(facets: Sequence[Facet]) -> dict[str, object]:
    """Return outlines and frames of facets for a summary's geometry, in the frame of the ensemble."""
    return {
        "outlines": [one.ensemble_from_facet.apply(one.corners_m).tolist() for one in facets],
        _KEY: {
            one.name: [
                one.ensemble_from_facet.rotation_vector_rad.tolist(),
                one.ensemble_from_facet.translation_m.tolist(),
            ]
            for one in facets
        },
    }


def facet_frames(summary: Summary) -> dict[str, RigidTransform]:
    """Return ``ensemble_from_facet`` of each facet; empty where a summary does not say it."""
    return {
        name: RigidTransform.from_rotation_vector(np.asarray(turn), np.asarray(place))
        for name, (turn, place) in summary.geometry_m.get(_KEY, {}).items()
    }
