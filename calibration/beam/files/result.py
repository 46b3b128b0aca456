"""Measured beams and what they rest on: summary, beams.csv, contours.csv, flux.nc, lines for the terminal."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from calibration.beam.files.flux_store import FluxStore
from calibration.beam.light.contours import Contour
from calibration.beam.light.flux_scale import FluxScale
from calibration.beam.light.vignetting import LightFall
from calibration.beam.pipeline.beams import BeamMeasurements, beam_columns, write_beams
from calibration.beam.pipeline.reading import BeamPhotos
from heliogauge.results.arrays import LabelledArray, write_arrays
from heliogauge.results.folder import Summary, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.thumbnails import write_thumbnails
from heliogauge.validate import BoolArray, FloatArray

__all__ = ["BEAMS_FILE", "CONTOURS_FILE", "FLUX_FILE", "Result"]

BEAMS_FILE, CONTOURS_FILE, FLUX_FILE, LEFT_OUT_FILE = "beams.csv", "contours.csv", "flux.nc", "left_out.csv"


@dataclass(frozen=True, slots=True, eq=False)
class Result(InstrumentResult):
    """Beams of many photos.

    Parameters
    ----------
    photos : BeamPhotos
        The photos and what is known of each.
    beams : BeamMeasurements
        Place and size of each beam.
    scales : tuple of FluxScale
        What turns the brightness of each photo into flux.
    contours : tuple of tuple of Contour
        Contours of each beam.
    flux : mapping of str to FluxStore
        The light of the beams by target.
    thumbnails : mapping of str to bytes
        Pictures of some photos on their targets, by name.
    light_falls : mapping of str to LightFall
        What the lens takes from the light, by target, where frames without a beam show it.
    name : str
        Name of what was measured.
    doubts : tuple of Doubt
        What makes the result doubtful.
    durations_s : mapping of str to float
        Wall time of each stage [s].
    input_sha256 : mapping of str to str
        Hash of each file that was read.
    """

    kind: ClassVar[str] = "beam"
    photos: BeamPhotos
    beams: BeamMeasurements
    scales: tuple[FluxScale, ...]
    contours: tuple[tuple[Contour, ...], ...]
    flux: Mapping[str, FluxStore]
    thumbnails: Mapping[str, bytes] = field(default_factory=dict)
    light_falls: Mapping[str, LightFall] = field(default_factory=dict)

    @property
    def by_calorimeter(self) -> bool:
        """Whether a calorimeter in the target scales the flux."""
        return any("calorimeter" in one.words for one in self.scales)

    @property
    def offsets_m(self) -> FloatArray:
        """Measured place minus the label that came with the photos, shape (n, 2); NaN without one [m]."""
        numbers = self.photos.numbers
        if "label_x_m" not in numbers:
            return np.full((len(self.beams.files), 2), np.nan)
        return np.stack([self.beams.x_m - numbers["label_x_m"], self.beams.y_m - numbers["label_y_m"]], axis=1)

    def columns(self) -> dict[str, object]:
        """Return what beams.csv has beside places and sizes."""
        beams, photos = self.beams, self.photos
        more: dict[str, object] = {}
        distance = self.distances_m
        if np.isfinite(distance).any():
            columns = beam_columns(beams)
            for name in ("width_major", "width_minor", "d50", "d90", "d95"):
                for sigma in ("", "sigma_"):
                    more[f"{sigma}{name}_mrad"] = 1e3 * np.asarray(columns[f"{sigma}{name}_m"]) / distance
            more["distance_m"] = distance
        more["flux_unit"] = [one.unit for one in self.scales]
        peak, sigma_peak, power, sigma_power = np.array([one.of_beam for one in self.scales]).T
        more |= {"peak_flux": peak, "sigma_peak_flux": sigma_peak, "power": power, "sigma_power": sigma_power}
        more["skirt_share"] = np.array([one.skirt_share for one in beams.sizes])
        more["aureole_share"] = np.array([one.aureole_share for one in beams.sizes])
        offsets = self.offsets_m
        if np.isfinite(offsets).any():
            more |= {"label_x_m": photos.numbers["label_x_m"], "label_y_m": photos.numbers["label_y_m"]}
            more |= {"off_label_x_m": offsets[:, 0], "off_label_y_m": offsets[:, 1]}
        return more | {name: list(texts) for name, texts in photos.passed_on.items()}

    def _centred_m(self, used: BoolArray) -> FloatArray:
        """Return the distance to the labels after the median offset of each target."""
        lengths = []
        for target in dict.fromkeys(self.beams.targets):
            mine = used & np.array([name == target for name in self.beams.targets])
            offsets = self.offsets_m[mine]
            offsets = offsets[np.isfinite(offsets).all(axis=1)]
            if len(offsets):
                lengths.append(np.hypot(*(offsets - np.median(offsets, axis=0)).T))
        return np.concatenate(lengths)

    @property
    def distances_m(self) -> FloatArray:
        """From the mirror to the target of each photo, shape (n,); NaN where not known [m]."""
        own = self.photos.numbers.get("distance_m", np.full(len(self.beams.files), np.nan))
        known = np.array([self.photos.distances_m.get(name, np.nan) for name in self.beams.targets])
        return np.where(np.isfinite(own), own, known)

    def summarise(self) -> Summary:
        """Collect the headline numbers with their sigmas, doubts and provenance."""
        beams = self.beams
        used = ~beams.rejected & np.isfinite(beams.x_m)
        numbers: dict[str, float | int | None] = {
            "beams_count": len(beams.files),
            "measured_count": int(used.sum()),
            "refused_count": int((~used).sum()),
            "left_out_count": len(self.photos.left_out),
        }
        for name, values, sigma in self._medians(used):
            numbers[name], numbers[f"sigma_{name}"] = values, sigma
        offsets = np.hypot(*self.offsets_m[used].T)
        offsets = offsets[np.isfinite(offsets)]
        if offsets.size:
            numbers["median_off_label_m"] = float(np.median(offsets))
            numbers["largest_off_label_m"] = float(offsets.max())
            numbers["median_off_label_centred_m"] = float(np.median(self._centred_m(used)))
        if self.light_falls:
            largest = max(self.light_falls.values(), key=lambda one: one.over_target)
            numbers["light_fall_over_target_share"] = largest.over_target
            numbers["sigma_light_fall_over_target_share"] = (
                largest.over_target * largest.sigma_per_radius2 / max(abs(largest.per_radius2), 1e-12)
            )
        texts = {
            "place": "centre of the light on the target: x right, y up, as seen from the field",
            "sizes": "from all of the light; beyond where it stands out of the background its skirts are continued "
            "by the "
            "elliptic bell that fits the beam, and half of what they change is in the sigma",
            "flux": self.scales[0].words if self.scales else "",
            "light_fall": "fall of an empty target's light towards the photo's corners over the target: vignetting, or "
            "daylight that bends so",
            "sigma": "1 standard deviation; of a median: that of the single beam in the median",
        }
        return self._summary(
            numbers, texts, {name: "no beam was measured" for name in numbers if numbers[name] is None}
        )

    def _medians(
        self, used: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    ) -> list[tuple[str, float | None, float | None]]:
        columns = beam_columns(self.beams)
        found: list[tuple[str, float | None, float | None]] = []
        for name in ("d50_m", "d90_m", "d95_m", "width_major_m", "width_minor_m"):
            values, sigma = np.asarray(columns[name])[used], np.asarray(columns[f"sigma_{name}"])[used]
            known = np.isfinite(values)
            found.append(
                (f"median_{name}", float(np.median(values[known])), float(np.median(sigma[known])))
                if known.any()
                else (f"median_{name}", None, None)
            )
        return found

    def write_files(self, folder: Path) -> None:
        """Write beams.csv, contours.csv, flux.nc, pictures into an existing folder."""
        write_beams(folder / BEAMS_FILE, self.beams, self.columns())
        if self.photos.left_out:
            write_table_csv(
                folder / LEFT_OUT_FILE,
                {"photo": list(self.photos.left_out), "reason": list(self.photos.left_out.values())},
            )
        rows = [
            (file.name, line.share, number, x, y)
            for file, lines in zip(self.beams.files, self.contours, strict=True)
            for line in lines
            for number, points in enumerate(line.lines_m)
            for x, y in points.tolist()
        ]
        names = ("image", "share_of_peak", "line", "x_m", "y_m")
        write_table_csv(
            folder / CONTOURS_FILE,
            dict(zip(names, map(list, zip(*rows, strict=True)), strict=True)) if rows else {name: [] for name in names},
        )
        self._write_flux(folder / FLUX_FILE)
        write_thumbnails(folder, dict(self.thumbnails))

    def _write_flux(self, path: Path) -> None:
        arrays: list[LabelledArray] = []
        attributes: dict[str, object] = {"title": f"Flux of beams on their targets: {self.name}"}
        for number, (target, store) in enumerate(self.flux.items()):
            end = "" if len(self.flux) == 1 else f"_{number + 1}"
            rows = store.rows
            unit = self.scales[rows[0]].unit if rows else "DN"
            factor = np.array([self.scales[row].per_dn for row in rows], dtype=np.float32)
            values = store.values_dn * factor[:, None, None]
            arrays += [
                LabelledArray(
                    f"beam{end}",
                    (f"beam{end}",),
                    np.array(rows, dtype=np.int32),
                    "1",
                    f"row of {BEAMS_FILE}, from 0, {target}",
                ),
                LabelledArray(f"y{end}", (f"y{end}",), store.y_m, "m", "up on the target, as seen from the field"),
                LabelledArray(f"x{end}", (f"x{end}",), store.x_m, "m", "right on the target, as seen from the field"),
            ]
            axes = (f"beam{end}", f"y{end}", f"x{end}")
            arrays.append(
                LabelledArray(
                    f"flux{end}", axes, values, unit, f"flux of the beam on target {target}, without background"
                )
            )
            scales = [self.scales[row] for row in rows]
            white = np.array([one.white_dn for one in scales]) / np.sqrt(store.averaged)
            noise = (np.hypot([one.background_dn for one in scales], white) * factor).astype(np.float32)
            arrays.append(
                LabelledArray(
                    f"sigma_flux{end}",
                    (f"beam{end}",),
                    noise,
                    unit,
                    "standard deviation of a pixel: noise and background",
                )
            )
            scale = np.array([self.scales[row].sigma_share for row in rows], dtype=np.float32)
            arrays.append(
                LabelledArray(
                    f"sigma_scale{end}",
                    (f"beam{end}",),
                    scale,
                    "1",
                    "standard deviation of the whole picture's scale, as a share",
                )
            )
            attributes[f"target{end}"] = target
        write_arrays(path, arrays, attributes)

    def headline(self) -> str:
        """Return how many beams were measured, and their sizes."""
        numbers = self.summarise().numbers
        lines = [
            f"{self.name}: {numbers['measured_count']} of {numbers['beams_count']} beams measured"
            + (f", {numbers['refused_count']} refused with a reason" if numbers["refused_count"] else "")
        ]
        if numbers.get("median_d90_m") is not None:
            lines.append(
                f"  D50 {numbers['median_d50_m']:.3f} m, D90 {numbers['median_d90_m']:.3f} m "
                f"(\u00b1 {numbers['sigma_median_d90_m']:.3f}), widths {numbers['median_width_major_m']:.3f} x "
                f"{numbers['median_width_minor_m']:.3f} m (medians)"
            )
        if "median_off_label_m" in numbers:
            lines.append(
                f"  off the labels by {numbers['median_off_label_m']:.3f} m (median), "
                f"{numbers['largest_off_label_m']:.3f} m at most"
            )
        return "\n".join(lines)
