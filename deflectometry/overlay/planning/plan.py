"""A plan of an overlay: how sure each facet's turn will be, from its measurement.toml before there are photos."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deflectometry.overlay.camera_place import Station
from deflectometry.overlay.doubts import doubts_of_turns
from deflectometry.overlay.facet_fit import FacetFit, fit_facet
from deflectometry.overlay.joint_turns import FEWEST_CHECKS, TURN_BY_WAVES, JointTurns, adjust
from deflectometry.overlay.keys import OverlayMeasurement, OverlayPhotoSection, load_overlay_plan
from deflectometry.overlay.pipeline.lines import OVERLAY_FILE, line_table, lines_over
from deflectometry.overlay.pipeline.measure import build_source
from deflectometry.overlay.pipeline.result import PHOTOS_FILE
from deflectometry.overlay.planning.predicted_photos import (
    FacetInPhoto,
    planned_pose,
    predicted_station,
    predicted_view,
    sight_of,
)
from deflectometry.overlay.source_image import Source
from deflectometry.overlay.turn_fit import ViewTurn
from deflectometry.pipeline.inputs import build_camera, build_facets
from deflectometry.planning.pipeline.changed_values import changed_model
from deflectometry.planning.pipeline.sigma_plan import SigmaPlanResult, run_sigma_plan
from deflectometry.planning.prospect import Change
from deflectometry.planning.sigma_prospect import SigmaProspect
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.measurement.load import MEASUREMENT_FILE
from heliogauge.running.progress import Progress
from heliogauge.validate import FloatArray

#: Tables of a plan: each facet; each facet in each photo.
FACETS_FILE, SIGHTS_FILE = "facets.csv", "sights.csv"
#: What is promised: names with unit, and words.
_LABELS = {
    "canting_x_rms_rad": "canting in x",
    "canting_y_rms_rad": "canting in y",
    "mean_turn_x_rad": "heliostat as a whole in x",
    "mean_turn_y_rad": "heliostat as a whole in y",
}
_SHOWN = {"shown_share": "facets known"}
#: Directions round the source in which one more photo is tried.
_DIRECTIONS = 16
#: How much farther or nearer source and cameras are tried, and how much larger a source and an image.
_DISTANCES, _LARGER = (0.75, 1.33), 1.5
#: Doubts of measuring that a plan says in its own words.
_OWN_WORDS = {"facet_without_image", "waves_unknown"}
#: A place that is known to so much is as good as not surveyed [mm].
_UNSURVEYED_MM = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class OverlayPlanResult(SigmaPlanResult):
    """How sure the turns of facets will be, and what would better them."""

    kind: ClassVar[str] = "overlay-plan"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedScene:
    """Camera, facets and source as they will be.

    photos: Names.
    poses: From the heliostat to the camera, photo by photo.
    sights: Where each facet looks in each photo.
    """

    camera: Camera
    facets: tuple[Facet, ...]
    source: Source
    photos: tuple[str, ...]
    poses: tuple[RigidTransform, ...]
    sights: tuple[FacetInPhoto, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PlannedOverlay:
    """A heliostat before a source, to be looked at before there are photos.

    fitted: Light that was fitted already, by photo, its place, facet and source; of all alternatives.
    """

    measurement: OverlayMeasurement
    fitted: dict[tuple[Any, ...], ViewTurn | None] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the heliostat."""
        return self.measurement.model.name

    def prospect(self) -> SigmaProspect:
        """Return how sure the turns will be.

        InputError: A photo without a place, or one that shows too few corners of facets.
        EstimationError: No facet will show the source's edge, or places and points leave something open.
        """
        scene = self.scene()
        found, names = self.turns(scene), scene.photos
        sigma_m = 1e-3 * self.measurement.model.source.sigma_center_mm
        doubts = doubts_of_turns(scene.facets, scene.source, found, names, sigma_m)
        return SigmaProspect(
            promised=_promised(found),
            labels=_LABELS,
            not_determined=_reasons(found),
            numbers={"facets_count": len(scene.facets), "photos_count": len(names)},
            shares={"shown_share": float(found.known.mean())},
            share_labels=_SHOWN,
            texts=_texts(found),
            facets=_of_facets(scene.facets, found),
            tables={
                FACETS_FILE: _facet_table(scene, found),
                SIGHTS_FILE: _sight_table(scene.sights),
                PHOTOS_FILE: _photo_table(scene),
                OVERLAY_FILE: line_table(
                    line
                    for name, pose in zip(names, scene.poses, strict=True)
                    for facet in scene.facets
                    for line in lines_over(scene.camera, name, pose, facet, scene.source, {})
                ),
            },
            doubts=(*(one for one in doubts if one.code not in _OWN_WORDS), *self._doubts(scene, found)),
        )

    def scene(self) -> PlannedScene:
        """Place camera, facets and source, and look what each photo will show.

        InputError: A photo without a place.
        EstimationError: No facet will show the source's edge.
        """
        model = self.measurement.model
        camera = build_camera(model.camera, self.measurement.folder)
        facets, source = build_facets(model.mirror, model.name), build_source(model.source)
        poses = tuple(planned_pose(facets, place) for place in self._places())
        photos = tuple(one.file for one in model.photo)
        sights = tuple(
            sight_of(camera, pose, facet, source, name)
            for name, pose in zip(photos, poses, strict=True)
            for facet in facets
        )
        if not any(one.edge_share > 0 for one in sights):
            raise EstimationError(
                f"no facet will show the source's edge in any photo: in {photos[0]}, {_words(sights, facets)}; move "
                "source or cameras, or take a source of another size"
            )
        return PlannedScene(camera, facets, source, photos, poses, sights)

    def turns(self, scene: PlannedScene) -> JointTurns:
        """Adjust turns, cameras and source to predicted points and light, as the measurement will.

        InputError: A photo that shows too few corners of facets.
        EstimationError: Places and points leave something open.
        """
        model = self.measurement.model
        stations = [
            replace(
                predicted_station(scene.camera, pose, scene.facets, model.points.sigma_px, one.file),
                place_m=np.array(one.place_m),
                sigma_place_m=1e-3 * one.sigma_place_mm,
            )
            for one, pose in zip(model.photo, scene.poses, strict=True)
        ]

        def fits(
            facet: Facet, moved: Sequence[Station], moved_source: Source, start_rad: FloatArray | None
        ) -> FacetFit:
            # As predicted nothing moves: what was fitted once is right for every station and source.
            return FacetFit(self._fits(scene, stations, facet))

        wave_rad = 1e-3 * (model.plan.difference_of_photos_mrad or 0.0)
        sigma_m = 1e-3 * model.source.sigma_center_mm
        return adjust(scene.camera, scene.facets, stations, scene.source, sigma_m, fits, wave_rad)

    def _fits(self, scene: PlannedScene, stations: Sequence[Station], facet: Facet) -> list[ViewTurn]:
        """Return the turns of a facet as each photo shows it, fitted to predicted light."""
        found, source = [], scene.source
        middle = tuple(source.heliostat_from_source.translation_m.tolist())
        for number, (pose, station) in enumerate(zip(scene.poses, stations, strict=True)):
            key = (number, tuple(pose.translation_m.tolist()), facet.name, source.half_m, middle)
            if key not in self.fitted:
                view = predicted_view(scene.camera, number, pose, station, facet, source, self.measurement.model.plan)
                views = [] if view is None else [view]
                self.fitted[key] = next(iter(fit_facet(facet, views, source, np.zeros(2)).turns), None)
            one = self.fitted[key]
            if one is not None:
                found.append(one)
        return found

    def _places(self) -> FloatArray:
        """Return where the cameras will stand, shape (n, 3) [m]."""
        for one in self.measurement.model.photo:
            if one.place_m is None:
                raise InputError(
                    f"{self.measurement.folder / MEASUREMENT_FILE}: photo {one.file}: place_m is missing; a plan needs "
                    f"the place of each camera. One that will not be surveyed has sigma_place_mm = {_UNSURVEYED_MM:g}"
                )
        return np.array([one.place_m for one in self.measurement.model.photo], dtype=np.float64)

    def _doubts(self, scene: PlannedScene, found: JointTurns) -> Iterator[Doubt]:
        facets = scene.facets
        unknown = [facet for facet, known in zip(facets, found.known, strict=True) if not known]
        if unknown:
            yield Doubt(
                "plan_leaves_facets_unknown",
                f"{len(unknown)} of {len(facets)} facets will stay unknown: {_words(scene.sights, unknown)}",
                {"facets_count": len(unknown)},
            )
        if found.redundancy < FEWEST_CHECKS:
            yield Doubt(
                "plan_cannot_find_waves",
                "too few photos check each other: measuring will not find how wavy the facets are, so that it can "
                "neither confirm difference_of_photos_mrad of [plan] nor state sigmas that contain waves; take three "
                "photos from different places",
                {"checks_count": found.redundancy},
            )
        if self.measurement.model.plan.difference_of_photos_mrad is None:
            yield Doubt(
                "plan_without_facet_waves",
                "no waves of the facets are stated in [plan] (difference_of_photos_mrad): each facet is taken to have "
                "the design's shape, and sigmas of turns hold the noise of pixels and places alone; waves "
                f"turn a facet by some {TURN_BY_WAVES:g} of their RMS slope in each photo",
            )

    def changes(self) -> Iterator[Change]:
        """Yield what might be done otherwise."""
        model, source = self.measurement.model, self.measurement.model.source
        count = len(model.photo)
        more = self._one_more()
        x, y, z = more.place_m or (0.0, 0.0, 0.0)
        yield self._change(
            f"one more photo, from ({x:.2f}, {y:.2f}, {z:.2f}) m",
            ("photo", f"{count} photos", f"{count + 1} photos"),
            {"photo": [one.model_dump(exclude_unset=True) for one in (*model.photo, more)]},
        )
        sigmas = [one.sigma_place_mm for one in model.photo]
        stated = ", ".join(f"{one:g}" for one in sigmas)
        for words, surveyed in (
            ("places of the cameras surveyed twice as well", [0.5 * one for one in sigmas]),
            ("places of the cameras not surveyed", [max(one, _UNSURVEYED_MM) for one in sigmas]),
        ):
            photos = [
                one.model_dump(exclude_unset=True) | {"sigma_place_mm": sigma}
                for one, sigma in zip(model.photo, surveyed, strict=True)
            ]
            after = ", ".join(f"{one:g}" for one in surveyed)
            yield self._change(words, ("photo.sigma_place_mm", stated, after), {"photo": photos})
        if source.sigma_center_mm > 0:
            yield self._halved("place of the source surveyed twice as well", "source", "sigma_center_mm")
        yield self._halved("corners of the facets measured twice as well", "points", "sigma_px")
        for factor in _DISTANCES:
            moved = [
                one.model_dump(exclude_unset=True) | {"place_m": [factor * x for x in one.place_m or ()]}
                for one in model.photo
            ]
            center = [factor * x for x in source.center_m]
            words = f"source and cameras {factor:g} times as far away"
            named = ("source.center_m, photo.place_m", f"{source.center_m[2]:g}", f"{center[2]:g}")
            yield self._change(words, named, {"photo": moved, "source.center_m": center})
        sizes = {
            f"source.{name}": _LARGER * value
            for name in ("width_m", "height_m", "diameter_m")
            if (value := getattr(source, name)) is not None
        }
        before = ", ".join(f"{one / _LARGER:g}" for one in sizes.values())
        after = ", ".join(f"{one:g}" for one in sizes.values())
        yield self._change(f"a source {_LARGER:g} times as large", (", ".join(sizes), before, after), sizes)

    def _halved(self, words: str, table: str, name: str) -> Change:
        value = float(getattr(getattr(self.measurement.model, table), name))
        key = f"{table}.{name}"
        return self._change(words, (key, f"{value:g}", f"{0.5 * value:g}"), {key: 0.5 * value})

    def _change(self, words: str, named: tuple[str, str, str], values: Mapping[str, Any]) -> Change:
        """Return a change; named: its key, value before and after."""
        changed = replace(self.measurement, model=changed_model(self.measurement.model, values))
        return Change(words, *named, replace(self, measurement=changed))

    def _one_more(self) -> OverlayPhotoSection:
        """Return a photo as far from the source as the others, from the direction farthest from theirs."""
        places, photos = self._places(), self.measurement.model.photo
        source = build_source(self.measurement.model.source)
        middle = source.heliostat_from_source
        off = (places - middle.translation_m) @ middle.rotation
        # One camera before the source's middle tells nothing of how far beside it there is room.
        radius = float(np.hypot(off[:, 0], off[:, 1]).mean()) or float(np.hypot(*source.half_m))
        angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        tried = np.column_stack(
            [radius * np.cos(angle), radius * np.sin(angle), np.full(_DIRECTIONS, off[:, 2].mean())]
        )
        nearest = np.linalg.norm(tried[:, None] - off, axis=2).min(axis=1)
        place = middle.apply(tried[np.argmax(nearest)]).tolist()
        sigma = min(one.sigma_place_mm for one in photos)
        return OverlayPhotoSection(file=f"photo {len(photos) + 1}", place_m=place, sigma_place_mm=sigma)


def _words(sights: Sequence[FacetInPhoto], facets: Sequence[Facet], most: int = 4) -> str:
    """Say why facets show none of the source's edge, or too little, by their first photo."""
    said = []
    for facet in facets[:most]:
        one = next(one for one in sights if one.facet == facet.name)
        said.append(f"facet {facet.name}: {one.words or 'too little of the edge is in it'}")
    return "; ".join(said) + (f"; and {len(facets) - most} more" if len(facets) > most else "")


def _promised(found: JointTurns) -> dict[str, float]:
    _, of_mean = found.mean_turn()
    _, of_canting = found.canting()
    each = np.diag(of_canting).reshape(-1, 2)
    canting = np.sqrt(np.nanmean(each, axis=0)) if found.known.sum() > 1 else np.full(2, np.nan)
    return dict(zip(_LABELS, [*canting.tolist(), *np.sqrt(np.diag(of_mean)).tolist()], strict=True))


def _reasons(found: JointTurns) -> dict[str, str]:
    """Say why numbers of the mirror, or of one of its facets, are not determined."""
    alone = "a single facet has no canting against others"
    reasons = {name: alone for name, one in _promised(found).items() if np.isnan(one)}
    if not found.known.all():
        hidden = "no photo will show enough of the source's edge in the facet"
        reasons |= dict.fromkeys(("canting_x_rad", "canting_y_rad"), hidden)
    return reasons


def _texts(found: JointTurns) -> dict[str, str]:
    light = float(np.nansum(found.random_rad**2) / np.nansum(np.diag(found.covariance)))
    return {
        "limits": f"of the variance of the turns {light:.0%} are the noise of pixels and waves of the facets, the rest "
        "the places of cameras and source, which all facets share",
        "points": "each camera is placed by the corners of the facets that its photo shows, and by its survey",
    }


def _of_facets(facets: Sequence[Facet], found: JointTurns) -> dict[str, dict[str, float | int | None]]:
    sigma = np.sqrt(np.diag(found.canting()[1])).reshape(-1, 2)
    return {
        facet.name: {
            f"sigma_canting_{axis}_rad": float(value) if np.isfinite(value) else None
            for axis, value in zip("xy", own.tolist(), strict=True)
        }
        for facet, own in zip(facets, sigma, strict=True)
    }


def _facet_table(scene: PlannedScene, found: JointTurns) -> dict[str, Sequence[Any]]:
    columns: dict[str, Sequence[Any]] = {"facet": [one.name for one in scene.facets]}
    for key, covariance in {"canting": found.canting()[1], "turn": found.covariance}.items():
        each = np.sqrt(np.diag(covariance)).reshape(-1, 2)
        columns |= {f"sigma_{key}_{axis}_rad": each[:, k].tolist() for k, axis in enumerate("xy")}
    columns |= {f"sigma_random_{axis}_rad": found.random_rad[:, k].tolist() for k, axis in enumerate("xy")}
    columns["photos"] = [" ".join(scene.photos[n] for n in one) for one in found.seen_in]
    rooms = [
        [one.room_rad for one in scene.sights if one.facet == facet.name and one.edge_share > 0]
        for facet in scene.facets
    ]
    columns["room_rad"] = [min(one, default=np.nan) for one in rooms]
    return columns


def _sight_table(sights: Sequence[FacetInPhoto]) -> dict[str, Sequence[Any]]:
    return {
        "photo": [one.photo for one in sights],
        "facet": [one.facet for one in sights],
        "edge_share": [one.edge_share for one in sights],
        "room_rad": [one.room_rad for one in sights],
        "off_x_m": [float(one.off_m[0]) for one in sights],
        "off_y_m": [float(one.off_m[1]) for one in sights],
        "reason": [one.words for one in sights],
    }


def _photo_table(scene: PlannedScene) -> dict[str, Sequence[Any]]:
    places = np.array([one.inverse().translation_m for one in scene.poses])
    count = len(scene.photos)
    columns: dict[str, Sequence[Any]] = {
        "photo": list(scene.photos),
        "width_px": [scene.camera.width_px] * count,
        "height_px": [scene.camera.height_px] * count,
    }
    return columns | {f"{axis}_m": places[:, k].tolist() for k, axis in enumerate("xyz")}


def run_folder(folder: Path, progress: Progress | None = None) -> OverlayPlanResult:
    """Say how sure the turns of a heliostat's facets will be, and what would better them.

    InputError, EstimationError: As for `PlannedOverlay.prospect`.
    """
    measurement = load_overlay_plan(folder)
    return run_sigma_plan(OverlayPlanResult, PlannedOverlay(measurement), folder, measurement.files_before, progress)
