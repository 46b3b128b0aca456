"""A plan of a screen's geometry: how sure points, size and the measuring camera will be, before there are photos."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deflectometry.planning.pipeline.changed_values import changed_model
from deflectometry.planning.pipeline.sigma_plan import SigmaPlanResult, run_sigma_plan
from deflectometry.planning.prospect import Change
from deflectometry.planning.sigma_prospect import SigmaProspect
from deflectometry.screen_geometry.keys import ScreenGeometryModel, ScreenMeasurement
from deflectometry.screen_geometry.pipeline.geometry import POINTS_FILE, Result, describe
from deflectometry.screen_geometry.pipeline.network import read_display, solve
from deflectometry.screen_geometry.planning.keys import ScreenPlanSection
from deflectometry.screen_geometry.planning.predicted_points import (
    PlannedPhoto,
    PlannedSurface,
    default_places,
    pose_at,
    predicted,
    targets_around,
    twice_as_many,
)
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.measurement.load import MEASUREMENT_FILE, read_measurement, refuse_missing
from heliogauge.running.progress import Progress, SilentProgress
from photogrammetry.pipeline import build_cameras

#: Table of the photos: where each is taken.
PHOTOS_FILE = "photos.csv"
#: What is promised of every screen, of one with a measuring camera, and of the mirror: names with unit, and words.
_LABELS = {
    "x_m": "points x",
    "y_m": "points y",
    "z_m": "points z",
    "width_m": "width",
    "height_m": "height",
}
_OF_CAMERA = {"camera_rotation_rad": "camera's turn", "camera_place_m": "camera's place"}
_OF_MIRROR = {"slope_rms_rad": "slopes"}
#: Taken for a display whose form the measurement will choose: of a plane, depth would be exact.
_FORM = "bent"
#: Photos within a smaller angle leave depth weak, and with it what slanted rays say of lengths: as in photogrammetry's
#: plans [deg].
_LEAST_ANGLE_DEG = 50.0
#: One more photo is tried so far from the front, in so many directions [deg].
_SIDE_DEG, _DIRECTIONS = 45.0, 8
#: Less is rounding [m, rad].
_NOTHING = 1e-15
#: Nodes over the screen at which its error in the mirror is looked at.
_NODES = 9
#: A scale bar that is so much of the longest one is not worth a longer one.
_LONG = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class ScreenPlanResult(SigmaPlanResult):
    """How sure a screen and the measuring camera will be, and what would better them."""

    kind: ClassVar[str] = "screen-geometry-plan"


@dataclass(frozen=True, slots=True, eq=False)
class PlannedScreen:
    """A screen before cameras, to be looked at before there are photos.

    model: What measurement.toml says.
    more_targets: Whether there are twice as many targets as it lists.
    more_places_m (n, 3): Places of photos beside those that it states [m].
    """

    folder: Path
    model: ScreenGeometryModel
    more_targets: bool = False
    more_places_m: tuple[tuple[float, float, float], ...] = ()

    @property
    def name(self) -> str:
        """Name of the screen."""
        return self.model.name

    @property
    def plan(self) -> ScreenPlanSection:
        """What is planned.

        InputError: Nothing is.
        """
        if self.model.plan is None:
            raise InputError(
                f"{self.folder / MEASUREMENT_FILE}: [plan] is missing; give width_m and height_m of the screen"
            )
        return self.model.plan

    def prospect(self) -> SigmaProspect:
        """Return how sure the screen will be.

        InputError: No [plan], a camera without the size of its image, or lengths between targets that are not planned.
        EstimationError: The photos will not determine the screen.
        """
        surface, photos = self.surface(), self.photos()
        found = self.measured(surface, photos)
        numbers = found.summarise().numbers
        labels = _LABELS | (_OF_CAMERA if "camera_distance_m" in numbers else {})
        promised = {name: _number(numbers.get(f"sigma_{name}")) for name in labels}
        has_scale = "scale_missing" not in {one.code for one in found.doubts}
        why = "no row or column of dots has both ends" if has_scale else "there is no scale"
        texts = {
            "screen": found.measured.screen.describe()
            + (
                "; where a plane fits, measuring will take it, with less depth error"
                if self.model.shape.form == "auto" and self.model.display
                else ""
            ),
            "targets": f"{len(surface.targets)} "
            f"{'square markers' if surface.has_markers else 'round targets'}; the length of scale bars and the places "
            "of control points are those of the plan, with their stated sigmas",
            "photos": f"{len(photos)}, from the places in {PHOTOS_FILE}; "
            + (
                "stated in [plan]"
                if self.plan.places_m
                else "no places are stated: eight are taken, six of them 40 deg from the front"
            ),
        }
        if self.plan.mirror_m is not None:
            slopes = _slopes(found, self.plan.mirror_m)
            labels, promised = labels | _OF_MIRROR, promised | {"slope_rms_rad": slopes}
            texts["slopes"] = self._words_of_slopes(slopes)
        if not has_scale:
            promised = {name: one if name == "camera_rotation_rad" else np.nan for name, one in promised.items()}
        # Predicted points have no residuals to speak of.
        doubts = [one for one in found.doubts if one.code != "residuals_contradict_stated_sigmas"]
        return SigmaProspect(
            promised=promised,
            labels=labels,
            not_determined={name: why for name, one in promised.items() if np.isnan(one)},
            numbers={
                "photos_count": len(photos),
                "targets_count": len(surface.targets),
                "points_count": len(found.network.points.u),
                "image_points_count": numbers["image_points_count"],
            },
            shares={},
            share_labels={},
            texts=texts,
            tables={
                POINTS_FILE: {key: one.tolist() for key, one in found.points().items()},
                PHOTOS_FILE: _photo_table(photos),
            },
            doubts=(*doubts, *_doubts(photos, found.network.result.solved.bundle.problem.observations.photos)),
        )

    def surface(self) -> PlannedSurface:
        """Place the screen's targets.

        InputError: No [plan], or a table that cannot be read.
        """
        model, plan = self.model, self.plan
        file = plan.targets if model.display is None else model.display.file
        if file is not None and (model.display is None or (self.folder / file).exists()):
            names, u, v = read_display(self.folder / file)
            targets = dict(zip(names, zip(u.tolist(), v.tolist(), strict=True), strict=True))
        else:
            targets = targets_around(plan.height_m / plan.width_m)
        if self.more_targets:
            targets = twice_as_many(targets)
        has_markers = model.targets is not None and model.targets.has_markers
        return PlannedSurface(plan, targets, has_markers, model.dots is not None)

    def photos(self) -> tuple[PlannedPhoto, ...]:
        """Place the cameras, that of the measuring photo last.

        InputError: A camera without the size of its image.
        """
        plan, measuring = self.plan, self.model.measuring_photo
        names = ["photo_1", *(() if measuring is None else (measuring,))]
        built = build_cameras(self._measurement(names, {}).network, names, None)
        survey = built.camera_of[names[0]]
        camera = built.cameras[survey]
        places = [*(plan.places_m or default_places(self.surface(), camera).tolist()), *self.more_places_m]
        # A camera that calibrates itself is turned by 90 degrees in every other photo.
        turns = "focal_px" in built.models[survey].free
        found = [
            PlannedPhoto(f"photo_{k + 1}", camera, pose_at(place, turned=turns and k % 2 == 1))
            for k, place in enumerate(places)
        ]
        if measuring is not None:
            place = plan.measuring_place_m or (0.0, 0.0, 2 * plan.width_m)
            own = built.cameras[built.camera_of[measuring]]
            found.append(PlannedPhoto(measuring, own, pose_at(place, turned=False)))
        return tuple(found)

    def measured(self, surface: PlannedSurface, photos: Sequence[PlannedPhoto]) -> Result:
        """Adjust predicted image points, as the measurement will.

        InputError: Lengths or control points between targets that are not planned.
        EstimationError: The photos will not determine the screen.
        """
        places, model = surface.places_m(), self.model
        for name in (
            *(end for bar in model.scale_bar for end in (bar.a, bar.b)),
            *(one.target for one in model.control_point),
        ):
            if name not in places:
                raise InputError(
                    f"{self.folder / MEASUREMENT_FILE}: a [[scale_bar]] or [[control_point]] names target {name!r}, "
                    f"which is not planned; planned are {', '.join(list(places)[:6])} ... ({len(places)} in all)"
                )
        values: dict[str, Any] = {
            "scale_bar": [
                one.model_dump(exclude_unset=True) | {"length_m": float(np.linalg.norm(places[one.a] - places[one.b]))}
                for one in model.scale_bar
            ],
            "control_point": [
                one.model_dump(exclude_unset=True) | {"xyz_m": places[one.target].tolist()}
                for one in model.control_point
            ],
            "adjustment.sigmas": "stated",
        }
        if model.shape.form == "auto":
            values["shape.form"] = _FORM
        if model.dots is not None:
            # Which dot is the origin changes no sigma.
            values["dots"] = {"dots": model.dots.dots}
        measurement = self._measurement([one.name for one in photos], values)
        listed = None
        if model.display is not None:
            u, v = np.array(list(surface.targets.values())).T
            listed = (list(surface.targets), u, v)
        seen = predicted(surface, photos)
        if not seen.targets.points.n:
            raise EstimationError(
                f"no photo will show a target of {self.plan.target_mm:g} mm: in all it is outside of the image, seen "
                "by more than 65 deg, or too small to be read; larger targets, or other places"
            )
        try:
            network = solve(measurement, seen, SilentProgress(), listed)
            return describe(measurement, network, {}, SilentProgress())
        except EstimationError as error:
            raise EstimationError(
                "as planned, measuring would be refused (five to eight photos from all sides, 40 deg from the front, "
                f"each with all targets, would do): {error}"
            ) from error

    def _measurement(self, photos: Sequence[str], values: Mapping[str, Any]) -> ScreenMeasurement:
        """Return the measurement of planned photos: all but the measuring one by the first camera that took others."""
        model = self.model
        if model.files.names:
            raise InputError(
                f"{self.folder / MEASUREMENT_FILE}: a plan does not read the tables of [files]; give scale bars and "
                "control points as [[scale_bar]] and [[control_point]]"
            )
        took = [model.measuring_photo is not None and one.took(model.measuring_photo) for one in model.camera]
        survey = next((one for one, other in zip(model.camera, took, strict=True) if not other), model.camera[0])
        for one, other in zip(model.camera, took, strict=True):
            if (other or one is survey) and not one.has_size:
                raise InputError(
                    f"{self.folder / MEASUREMENT_FILE}: camera {one.name}: width_px and height_px are needed for a plan"
                )
        cameras = [survey.model_dump(exclude_unset=True, exclude={"photos"})]
        cameras += [
            one.model_dump(exclude_unset=True)
            for one, other in zip(model.camera, took, strict=True)
            if other and one is not survey
        ]
        changed = changed_model(model, {"camera": cameras, "images": {"photos": list(photos)}} | dict(values))
        return ScreenMeasurement(self.folder, changed, tuple(self.folder / name for name in photos))

    def _words_of_slopes(self, slopes_rad: float) -> str:
        plan = self.plan
        said = (
            f"those of a mirror {plan.mirror_m:g} m away: what errors that all points share do to them, RMS over the "
            "screen; the measuring camera's pose mostly turns the mirror as a whole"
        )
        if plan.fringe_noise_mrad is None:
            return said
        share = 1e3 * slopes_rad / plan.fringe_noise_mrad
        return f"{said}; {share:.2g} of the noise of the fringes, {plan.fringe_noise_mrad:g} mrad"

    def changes(self) -> Iterator[Change]:
        """Yield what might be done otherwise."""
        model, plan, photos = self.model, self.plan, self.photos()
        place = self._one_more(photos)
        count = len(photos) - (model.measuring_photo is not None)
        yield Change(
            f"one more photo from the side, from ({place[0]:.2f}, {place[1]:.2f}, {place[2]:.2f}) m",
            "plan.places_m",
            f"{count} photos",
            f"{count + 1} photos",
            replace(self, more_places_m=(*self.more_places_m, place)),
        )
        surface = self.surface()
        targets = len(surface.targets)
        yield Change(
            "twice as many targets", "targets", f"{targets}", f"{2 * targets}", replace(self, more_targets=True)
        )
        sigmas = {"plan.sigma_target_px": plan.sigma_target_px}
        if model.dots is not None:
            sigmas["plan.sigma_dot_px"] = plan.sigma_dot_px
        yield self._halved("image points measured twice as well (or four photos from each place)", sigmas)
        bars = [one.model_dump(exclude_unset=True) for one in model.scale_bar]
        if bars:
            yield self._rows("lengths known twice as well", "scale_bar", "sigma_mm", bars)
            yield from self._longer_bar(surface)
        points = [one.model_dump(exclude_unset=True) for one in model.control_point]
        if any(any(one.sigma_mm) for one in model.control_point):
            yield self._rows("control points surveyed twice as well", "control_point", "sigma_mm", points)
        if any(one.estimated for one in model.camera):
            known = [
                one.model_dump(exclude_unset=True, exclude={"sigma", "prior"}) | {"free": []} for one in model.camera
            ]
            free = ", ".join(dict.fromkeys(name for one in model.camera for name in one.estimated))
            yield self._change(
                "cameras calibrated beforehand, as if exactly", ("camera.free", free, "none"), {"camera": known}
            )

    def _longer_bar(self, surface: PlannedSurface) -> Iterator[Change]:
        places = surface.places_m()
        names, points = list(places), np.array(list(places.values()))
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        a, b = np.unravel_index(int(np.argmax(apart)), apart.shape)
        bars = [one for one in self.model.scale_bar if not one.check_only]
        if not bars or any(one.a not in places or one.b not in places for one in bars):
            return
        own = [float(np.linalg.norm(places[one.a] - places[one.b])) for one in bars]
        if max(own) < _LONG * float(apart[a, b]):
            longest = bars[int(np.argmax(own))]
            changed = [
                one.model_dump(exclude_unset=True) | ({"a": names[a], "b": names[b]} if one is longest else {})
                for one in self.model.scale_bar
            ]
            named = ("scale_bar.a, scale_bar.b", f"{max(own):.3g} m", f"{apart[a, b]:.3g} m")
            yield self._change(
                "the longest scale bar across the whole screen, as well known", named, {"scale_bar": changed}
            )

    def _rows(self, words: str, table: str, name: str, rows: Sequence[Mapping[str, Any]]) -> Change:
        """Return a change that halves one value of every row of a table."""
        halved = [
            dict(one) | {name: (0.5 * np.asarray(one[name])).tolist()} if name in one else dict(one) for one in rows
        ]
        before, after = (", ".join(f"{one.get(name, 0)}" for one in some) for some in (rows, halved))
        return self._change(words, (f"{table}.{name}", before, after), {table: halved})

    def _halved(self, words: str, sigmas: Mapping[str, float]) -> Change:
        before, after = (", ".join(f"{factor * one:g}" for one in sigmas.values()) for factor in (1.0, 0.5))
        return self._change(words, (", ".join(sigmas), before, after), {key: 0.5 * one for key, one in sigmas.items()})

    def _change(self, words: str, named: tuple[str, str, str], values: Mapping[str, Any]) -> Change:
        """Return a change; named: its key, value before and after."""
        return Change(words, *named, replace(self, model=changed_model(self.model, values)))

    def _one_more(self, photos: Sequence[PlannedPhoto]) -> tuple[float, float, float]:
        """Return the place at 45 degrees from the front that is farthest from those of photos, seen from the screen."""
        places = np.array([one.cam_from_screen.inverse().translation_m for one in photos])
        distance = np.linalg.norm(places, axis=1)
        away, around = np.radians(_SIDE_DEG), 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        tried = np.column_stack(
            [np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.full(_DIRECTIONS, np.cos(away))]
        )
        nearest = (tried @ (places / distance[:, None]).T).max(axis=1)
        x, y, z = (float(np.median(distance)) * tried[int(np.argmin(nearest))]).tolist()
        return x, y, z


def _number(sigma_m: float | int | None) -> float:
    """Return a sigma; NaN where there is none, and 0 where rounding alone is left of it, as of the depth of a plane."""
    if sigma_m is None:
        return float("nan")
    return float(sigma_m) if sigma_m > _NOTHING else 0.0


def _slopes(found: Result, mirror_m: float) -> float:
    """Return the slope errors in one direction that a screen causes in a mirror before it, RMS [rad]."""
    nodes = np.linspace(0.0, 1.0, _NODES)
    u, v = (one.ravel() for one in np.meshgrid(nodes, nodes))
    points = found.measured.screen.points_m(u, v)
    away = (mirror_m - points[:, 2])[:, None]
    square = np.zeros((len(u), 2))
    for one in found.measured.shared:
        moved = one.warp.shifts_m(u, v)
        # The reflected line of sight turns by this, the normal by half of it.
        square += (0.5 * (moved[:, :2] / away + points[:, :2] * moved[:, 2:] / away**2)) ** 2
    return float(np.sqrt(np.nanmean(square)))


def _doubts(photos: Sequence[PlannedPhoto], used: Sequence[str]) -> Iterator[Doubt]:
    """Yield what a plan says of its photos; used: names of those that the network holds."""
    unused = [one.name for one in photos if one.name not in used]
    if unused:
        yield Doubt(
            "plan_photos_unused",
            f"{len(unused)} of {len(photos)} photos show too few targets: {', '.join(unused[:8])}; nearer to the "
            "front, or farther away, they would show more",
            {"photos_count": len(unused)},
        )
    photos = [one for one in photos if one.name in used]
    arms = np.array([one.cam_from_screen.inverse().translation_m for one in photos])
    arms /= np.linalg.norm(arms, axis=1, keepdims=True)
    angle = float(np.degrees(np.arccos(np.clip((arms @ arms.T).min(), -1.0, 1.0))))
    if angle < _LEAST_ANGLE_DEG:
        yield Doubt(
            "plan_photos_from_one_side",
            f"all photos look at the screen from within {angle:.0f} deg: depth is weak, and with it lengths along "
            "slanted lines of sight; take some from 40 deg to the left, right, above and below",
            {"angle_deg": angle},
        )


def _photo_table(photos: Sequence[PlannedPhoto]) -> dict[str, Sequence[Any]]:
    places = np.array([one.cam_from_screen.inverse().translation_m for one in photos])
    axes = np.array([one.cam_from_screen.rotation[0] for one in photos])
    columns: dict[str, Sequence[Any]] = {"photo": [one.name for one in photos]}
    columns |= {f"{axis}_m": places[:, k].tolist() for k, axis in enumerate("xyz")}
    columns["turned"] = ["90 deg" if abs(x) < abs(y) else "upright" for x, y, _ in axes.tolist()]
    return columns


def run_folder(folder: Path, progress: Progress | None = None) -> ScreenPlanResult:
    """Say how sure the geometry of a screen will be, and what would better it.

    InputError, EstimationError: As for `PlannedScreen.prospect`.
    """
    file, model = read_measurement(folder, ScreenGeometryModel)
    planned = PlannedScreen(folder, model)
    cameras = [folder / one.file for one in model.camera if one.file is not None]
    tables = [planned.plan.targets] if model.display is None else []
    files = (file, *cameras, *(folder / one for one in tables if one is not None))
    refuse_missing(file, files)
    return run_sigma_plan(ScreenPlanResult, planned, folder, files, progress)
