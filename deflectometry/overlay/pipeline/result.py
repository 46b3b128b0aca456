"""What comes of an overlay: turns of facets, moves of their mounts, outlines over the photos."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deflectometry.overlay.doubts import reasons
from deflectometry.overlay.joint_turns import JointTurns
from deflectometry.overlay.pipeline.lines import OVERLAY_FILE, OverlayLine, line_table
from deflectometry.pipeline.headline import canting_numbers
from deflectometry.pipeline.result import write_canting
from deflectometry.shape.facet_canting import CANTING_SIGN, FacetCanting, moves_of_facet
from heliogauge.geometry.surfaces import Facet
from heliogauge.results.facet_frames import facet_geometry
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.thumbnails import write_thumbnails
from heliogauge.slopes.statistics import Canting
from heliogauge.validate import FloatArray

TURNS_FILE, PHOTOS_FILE = "turns.csv", "photos.csv"


@dataclass(frozen=True, slots=True, eq=False)
class OverlayResult(InstrumentResult):
    """Turns of the facets of a heliostat.

    facets: All facets.
    turns: Their turns with covariance, and the cameras.
    photos: Names of the photos.
    mounts_m (n, 2): Places of the mounts of each facet in its frame; facets without are left out [m].
    lines: What is drawn over the photos.
    thumbnails: Small photos; size_px: columns and rows of the full ones.
    """

    kind: ClassVar[str] = "overlay"
    facets: tuple[Facet, ...]
    turns: JointTurns
    photos: tuple[str, ...]
    mounts_m: Mapping[str, FloatArray]
    lines: tuple[OverlayLine, ...]
    thumbnails: Mapping[str, bytes]
    size_px: tuple[int, int]

    def cantings(self) -> tuple[FacetCanting, ...]:
        """Return canting and moves of mounts of each facet."""
        values, covariance = self.turns.canting()
        found = []
        for number, facet in enumerate(self.facets):
            known = bool(self.turns.known[number])
            part = slice(2 * number, 2 * number + 2)
            own, value = covariance[part, part], values[number]
            canted = None
            if known:
                angle = float(np.linalg.norm(value))
                sigma = float(np.sqrt(value @ own @ value)) / angle if angle > 0 else float(np.sqrt(np.trace(own)))
                canted = Canting(value, own, angle, sigma, 1.0)
            places = self.mounts_m.get(facet.name, np.zeros((0, 2)))
            moves = moves_of_facet(facet, canted, places)
            found.append(FacetCanting(facet, 1.0 if known else 0.0, canted, places, moves))
        return tuple(found)

    @property
    def not_used(self) -> list[str]:
        """Why photos are not used for each facet, and whether nothing checks its turn; empty where neither."""
        return [reasons(self.turns, k, self.photos) for k in range(len(self.facets))]

    def summarise(self) -> Summary:
        """Collect the numbers with their sigmas."""
        mean, covariance = self.turns.mean_turn()
        cant, of_cant = self.turns.canting()
        known = self.turns.known
        numbers: dict[str, float | int | None] = {}
        for axis, name in enumerate("xy"):
            numbers[f"mean_turn_{name}_rad"] = float(mean[axis])
            numbers[f"sigma_mean_turn_{name}_rad"] = float(np.sqrt(covariance[axis, axis]))
        for axis, name in enumerate("xy"):
            numbers[f"canting_{name}_rms_rad"] = float(np.sqrt(np.mean(cant[known, axis] ** 2)))
            variances = np.diag(of_cant)[axis::2][known]
            numbers[f"canting_{name}_noise_rms_rad"] = float(np.sqrt(np.mean(variances)))
        numbers |= canting_numbers(self.cantings())
        numbers["difference_of_photos_rad"] = self.turns.wave_rad
        numbers["facets_count"], numbers["facets_measured_count"] = len(self.facets), int(known.sum())
        numbers["photos_count"] = len(self.photos)
        texts = {
            "turn": "mean normal against design, positive where the facet rises too much towards +x or +y; a beam "
            "turns by twice as much",
            "canting": f"turn against the mean of all facets, which is how the heliostat as a whole points; "
            f"{CANTING_SIGN}",
            "difference_of_photos": "what one photo's turn of a facet is off beyond the noise of its pixels: waves of "
            "the facet along the edge of the image; it is in the sigmas",
        }
        return self._summary(numbers, texts, geometry_m=facet_geometry(self.facets))

    def write_files(self, folder: Path) -> None:
        """Write tables and small photos into an existing folder."""
        sigmas = np.sqrt(np.diag(self.turns.covariance)).reshape(-1, 2)
        columns: dict[str, Any] = {"facet": [one.name for one in self.facets]}
        for axis, name in enumerate("xy"):
            columns[f"turn_{name}_rad"] = self.turns.turns_rad[:, axis]
            columns[f"sigma_turn_{name}_rad"] = sigmas[:, axis]
            columns[f"sigma_random_{name}_rad"] = self.turns.random_rad[:, axis]
        columns["photos"] = [" ".join(self.photos[n] for n in one) for one in self.turns.seen_in]
        columns["not_used"] = self.not_used
        write_table_csv(folder / TURNS_FILE, columns)
        write_canting(folder, self.cantings())
        write_table_csv(folder / OVERLAY_FILE, line_table(self.lines))
        stations = self.turns.stations
        places = np.array([one.cam_from_heliostat.inverse().translation_m for one in stations])
        write_table_csv(
            folder / PHOTOS_FILE,
            {
                "photo": self.photos,
                "width_px": [self.size_px[0]] * len(stations),
                "height_px": [self.size_px[1]] * len(stations),
                "x_m": places[:, 0],
                "y_m": places[:, 1],
                "z_m": places[:, 2],
                "points_residual_px": [one.residual_px for one in stations],
                "points_probability": [one.probability for one in stations],
                "place_misfit_sigmas": self.turns.place_misfits,
            },
        )
        write_thumbnails(folder, self.thumbnails)

    def headline(self) -> str:
        """Return the most important numbers in a few lines for the terminal."""
        mean, covariance = self.turns.mean_turn()
        sigma = np.sqrt(np.diag(covariance))
        known = self.turns.known
        lines = [
            f"{self.name}: turn of {int(known.sum())} of {len(known)} facets from {len(self.photos)} photos",
            f"  heliostat as a whole  x {1e3 * mean[0]:+.3f} +- {1e3 * sigma[0]:.3f}   y {1e3 * mean[1]:+.3f} +- "
            f"{1e3 * sigma[1]:.3f} mrad",
        ]
        cant, of_cant = self.turns.canting()
        sigmas = np.sqrt(np.diag(of_cant)).reshape(-1, 2)
        for facet, value, one, why in zip(self.facets, cant, sigmas, self.not_used, strict=True):
            lines.append(
                f"  facet {facet.name:8s} against the mean  x {1e3 * value[0]:+.3f} +- {1e3 * one[0]:.3f}   y "
                f"{1e3 * value[1]:+.3f} +- {1e3 * one[1]:.3f} mrad"
                if np.isfinite(value).all()
                else f"  facet {facet.name:8s} unknown"
            )
            lines += [f"    {why}"] if why else []
        return "\n".join(lines)
