"""Dots that someone who looks at a drawn photo would name."""

from typing import Any

import numpy as np

from data_synth.dots import DotScene


def known_dots(scene: DotScene) -> list[dict[str, Any]]:
    """Return a dot in the middle of each facet, as one who looks at the photo would name it."""
    wall, known = scene.scene.bench.wall, []
    for facet in scene.scene.facets:
        x, y = scene.scene.bench.project_outline(facet).mean(axis=0)
        around = np.stack(np.meshgrid(x + np.arange(-8.0, 9.0), y + np.arange(-8.0, 9.0)), axis=-1).reshape(-1, 2)
        seen = scene.scene.bench.trace(facet, around[:, 0], around[:, 1])
        column = (seen.u - 0.5) * wall.width_m / scene.pitch_m + 0.5 * (scene.count[0] - 1) - scene.origin[0]
        row = scene.origin[1] - (seen.v - 0.5) * wall.height_m / scene.pitch_m - 0.5 * (scene.count[1] - 1)
        best = np.argmin(np.hypot(column - np.rint(column), row - np.rint(row)))
        number = {"column": int(np.rint(column[best])), "row": int(np.rint(row[best]))}
        known.append({"image_px": around[best].tolist(), **number})
    return known
