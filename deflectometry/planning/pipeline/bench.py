"""A mirror before a screen that is not measured yet: the measurement's own evaluation on predicted samples."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from deflectometry.keys import BenchMeasurement, BenchModel, CameraParameters
from deflectometry.pipeline.assess import SourceMeasurement, measure_source
from deflectometry.pipeline.choices import Options, build_choices
from deflectometry.pipeline.evaluate import Evaluation
from deflectometry.pipeline.inputs import build_facets, build_setup, describe_mirror, inputs_without_sigma
from deflectometry.pipeline.mean_normal import mean_normal, words_as_exact
from deflectometry.pipeline.plausibility import refuse_impossible
from deflectometry.pipeline.result import Result
from deflectometry.pipeline.stated_inputs import INPUTS_FILE, UNSTATED, inputs_table
from deflectometry.planning.holes import OF_HOLES, hole_doubt, words_of_hole
from deflectometry.planning.keys import BenchPlanSection
from deflectometry.planning.pipeline.changed_values import changed_model, value_of
from deflectometry.planning.predicted_sight import FacetSight, facet_sight, facing_pose
from deflectometry.planning.prospect import Change, FacetProspect, PlannedSource, Prospect
from deflectometry.setup.camera_and_screen import Setup
from deflectometry.shape.common_modes import FACET_PLACE, MIRROR_POSE
from deflectometry.sources.source import Source
from heliogauge.doubts import Doubt, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import Facet
from heliogauge.running.progress import SilentProgress
from heliogauge.validate import Float32Array

#: Light beside the mirror, over its own.
_BESIDE = 0.05
#: How much nearer or farther the mirror is tried, and how much larger the screen.
_DISTANCE_FACTORS, _SCREEN_FACTOR = (0.7, 1.4), 1.25
#: Surveyed place of the mirror that is tried where none is planned [mm].
_PLACE_MM = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """Camera, screen and mirror as they will stand.

    measurement: As planned, with what will be measured of the mirror's place put in.
    """

    measurement: BenchMeasurement
    setup: Setup
    facets: tuple[Facet, ...]
    cam_from_mirror: RigidTransform
    sights: tuple[FacetSight, ...]
    plan: BenchPlanSection

    @classmethod
    def of(cls, measurement: BenchMeasurement, plan: BenchPlanSection) -> "Bench":
        """Place everything and trace what the mirror will show.

        InputError: The mirror's place is not stated, or it is seen from behind, or not whole, or shows no screen.
        """
        model = measurement.model
        facets = build_facets(model.mirror, model.name)
        if not facets:
            raise InputError(f"{measurement.folder}: mirror.outline_m or [[mirror.facet]] is needed for a plan")
        setup = build_setup(measurement)
        pose = _planned_pose(measurement, setup, facets, plan)
        try:
            refuse_impossible(setup, pose)
        except EstimationError as error:
            raise InputError(str(error)) from None
        sights = tuple(facet_sight(setup, pose, one, plan.blur_px) for one in facets)
        if not any((one.inside & one.on_screen).any() for one in sights):
            raise InputError(
                f"{measurement.folder}: no part of the mirror shows the screen to the camera; check the mirror's pose, "
                "the screen's place and size, and the design's focal length"
            )
        predicted = replace(measurement, model=_with_predicted_places(model, setup, pose))
        return cls(predicted, setup, facets, pose, sights, plan)

    def image(self, contrast_dn: float, noise_dn: float) -> Float32Array:
        """Return how the mirror will stand out, shape (h, w) [DN]."""
        camera = self.setup.camera
        cover = np.zeros((camera.height_px, camera.width_px), dtype=np.float32)
        for one in self.sights:
            # What looks past the screen stays as dark as what is beside the mirror.
            cover[one.rows, one.columns] += one.cover if one.seen_share == 1 else one.cover * one.on_screen
        light = contrast_dn * (_BESIDE + (1 - _BESIDE) * np.minimum(cover, 1.0))
        # Edges are weighted by how they scatter: without noise they would count as exact.
        noise = np.random.default_rng(0).standard_normal(cover.shape, dtype=np.float32)
        return np.asarray(light + noise_dn * noise, dtype=np.float32)

    def result(self, source: Source, setup: Setup, pattern: str) -> Result:
        """Evaluate predicted samples exactly as a measurement.

        setup: Camera and screen, with what the source adds to their sigmas.
        EstimationError: The measurement would be refused, too; of a mirror that sees past the screen, with that part.
        """
        measurement = self.measurement
        hole = hole_doubt(self.sights, setup.size_m)
        ready = SourceMeasurement(
            measurement,
            source,
            setup,
            describe_mirror(measurement, setup),
            build_choices(measurement, Options()),
            pattern,
            lambda: (),
            (),
            gather_doubts(hole),
        )
        try:
            return measure_source(ready, SilentProgress())
        except EstimationError as error:
            if hole is None:
                raise
            raise EstimationError(f"{hole.text}. As planned, measuring would be refused: {error}") from error

    def prospect(self, result: Result, texts: Mapping[str, str]) -> Prospect:
        """Return what a result on predicted samples says of the measurement."""
        evaluation = result.evaluation
        normal = mean_normal(result.setup, evaluation)
        holes = [words_of_hole(one) for one in self.sights]
        return Prospect(
            slope_map=result.assembled_as_measured,
            numbers=result.numbers,
            facets=tuple(
                FacetProspect(
                    one.facet.name,
                    one.seen_share,
                    hole,
                    evaluation.maps.get(one.facet.name),
                    one.facet.ensemble_from_facet,
                )
                for one, hole in zip(self.sights, holes, strict=True)
            ),
            spacing_m=_spacing_m(evaluation),
            samples=sum(int(np.count_nonzero(np.isfinite(one.slope_x))) for one in evaluation.images.values()),
            normal_shares_rad=np.zeros((0, 2)) if normal is None else normal.shares_rad,
            normal_sources=() if normal is None else normal.sources,
            texts={**texts, **result.texts},
            tables={INPUTS_FILE: inputs_table(result.inputs)},
            doubts=gather_doubts(
                (one for one in result.doubts if not (any(holes) and one.code in OF_HOLES)),
                None if normal is None else self._normal_as_exact(),
            ),
        )

    def _normal_as_exact(self) -> Doubt | None:
        """Name what the sigma of the mean normal leaves out: no image knows it, so that nobody else will."""
        exact = words_as_exact(inputs_without_sigma(self.measurement, self.setup))
        if not exact:
            return None
        return Doubt(
            "mean_normal_without_sigmas",
            f"the sigma of the mean normal has {exact} as exact, of which no sigma is given; where the mirror points "
            "is less sure than that. With their sigmas stated it may look worse, and is what will be true",
            {},
        )


def _spacing_m(evaluation: Evaluation) -> float:
    return float(np.median([one.footprint_m for one in evaluation.images.values()]))


def _planned_pose(
    measurement: BenchMeasurement, setup: Setup, facets: Sequence[Facet], plan: BenchPlanSection
) -> RigidTransform:
    section = measurement.model.mirror
    known = describe_mirror(measurement, setup).known_pose
    if known is not None:
        return known.cam_from_mirror
    point = np.zeros(3)
    if plan.mirror_m is not None:
        place = np.array(plan.mirror_m)
    elif section.place is not None:
        point = np.array(section.place.point_m)
        place = setup.cam_from_screen.apply(np.array(section.place.place_m))
    elif section.distance is not None:
        point = np.array(section.distance.point_m)
        place = _on_axis(setup, section.distance.distance_m)
    else:
        raise InputError(
            f"{measurement.folder}: where the mirror will stand is not said; give plan.mirror_m, [mirror.distance], "
            "[mirror.place] or [mirror.pose]"
        )
    if not place[2] > 0:
        raise InputError(
            f"{measurement.folder}: the mirror would stand {-place[2]:.3g} m behind the camera; z of plan.mirror_m is "
            "the distance in front of it"
        )
    return facing_pose(setup, facets, point, place, float(np.deg2rad(section.roll_deg)))


def _on_axis(setup: Setup, distance_m: float) -> Any:
    """Return the place on the camera's axis at a distance from the screen's origin."""
    screen_m = setup.cam_from_screen.translation_m
    square = distance_m**2 - float(screen_m[:2] @ screen_m[:2])
    if not square > 0:
        raise InputError(
            f"mirror.distance: no place on the camera's axis is {distance_m:g} m from the screen's origin, which is "
            f"{np.hypot(*screen_m[:2]):.3g} m beside that axis; give plan.mirror_m"
        )
    return np.array([0.0, 0.0, screen_m[2] + np.sqrt(square)])


def _with_predicted_places(model: BenchModel, setup: Setup, pose: RigidTransform) -> BenchModel:
    """Return what measurement.toml will say once distance, place and known points are measured."""
    section = model.mirror
    update: dict[str, Any] = {}
    if section.distance is not None:
        off = pose.apply(np.array(section.distance.point_m)) - setup.cam_from_screen.translation_m
        update["distance"] = section.distance.model_copy(update={"distance_m": float(np.linalg.norm(off))})
    if section.place is not None:
        place = setup.cam_from_screen.inverse().apply(pose.apply(np.array(section.place.point_m)))
        update["place"] = section.place.model_copy(update={"place_m": tuple(place.tolist())})
    if section.known_point:
        seen = setup.camera.project(pose.apply(np.array([one.point_m for one in section.known_point])))
        update["known_point"] = tuple(
            one.model_copy(update={"image_px": tuple(at)})
            for one, at in zip(section.known_point, seen.tolist(), strict=True)
        )
    return model.model_copy(update={"mirror": section.model_copy(update=update)})


# --- what might be done otherwise -----------------------------------------------------------------------------------

#: Makes a planned source of a changed measurement.
Planner = Callable[[Any], PlannedSource]
_Measurement = TypeVar("_Measurement", bound=BenchMeasurement)

#: Keys of sigmas that are halved, what they are of, and the sources of errors that this makes smaller.
_SIGMAS = (
    ("mirror.distance.sigma_mm", "the mirror's distance measured twice as well", (MIRROR_POSE,)),
    ("mirror.place.sigma_mm", "the mirror's place surveyed twice as well", ("camera and screen", MIRROR_POSE)),
    ("mirror.pose.sigma_rotation_mrad", "the mirror's turn known twice as well", (MIRROR_POSE,)),
    ("mirror.pose.sigma_translation_mm", "the mirror's place known twice as well", (MIRROR_POSE,)),
    ("mirror.sigma_facet_position_mm", "places of the facets known twice as well", (FACET_PLACE,)),
    ("screen.sigma_rotation_mrad", "the screen's turn known twice as well", ("screen pose", "camera and screen")),
    ("screen.sigma_translation_mm", "the screen's place known twice as well", ("screen pose", "camera and screen")),
    ("screen.sigma_width_mm", "the screen's width known twice as well", ("screen size",)),
    ("screen.sigma_height_mm", "the screen's height known twice as well", ("screen size",)),
    ("screen.sigma_sag_mm", "the screen's sag known twice as well", ("screen sag",)),
    ("screen.sigma_points_mm", "the screen's shape known twice as well", ("screen shape",)),
    ("camera.sigma_focal_px", "the focal length known twice as well", ("camera", "camera and screen")),
    ("camera.sigma_center_px", "the principal point known twice as well", ("camera", "camera and screen")),
)
#: Inputs of which nobody may have stated how well they are known: the key that tells, their sigmas, and what they are
#: of. What is tried is what a calibration and a tape measure reach, as in the template of measurement.toml.
_UNSTATED = (
    (
        "camera.focal_x_px",
        {"camera.sigma_focal_px": 1.0, "camera.sigma_center_px": 1.0},
        "the camera's focal length and principal point known to 1 px, and that stated",
    ),
    (
        "screen.translation_m",
        {"screen.sigma_rotation_mrad": (1.0,) * 3, "screen.sigma_translation_mm": (1.0,) * 3},
        "the screen's turn and place known to 1 mrad and 1 mm, and that stated",
    ),
    ("screen.width_m", {"screen.sigma_width_mm": 1.0}, "the screen's width known to 1 mm, and that stated"),
    ("screen.height_m", {"screen.sigma_height_mm": 1.0}, "the screen's height known to 1 mm, and that stated"),
    ("screen.sag", {"screen.sigma_sag_mm": 1.0}, "the screen's sag known to 1 mm, and that stated"),
)


def bench_changes(bench: Bench, planned: Planner) -> Iterator[Change]:
    """Yield what might be done otherwise before any screen: distances, the screen's size, what is surveyed better."""
    measurement, pose = bench.measurement, bench.cam_from_mirror
    if measurement.model.mirror.pose is None:
        place = pose.translation_m
        for factor in _DISTANCE_FACTORS:
            moved = tuple((factor * place).tolist())
            yield Change(
                f"the mirror at {float(np.linalg.norm(moved)):.3g} m instead of {float(np.linalg.norm(place)):.3g} m",
                "plan.mirror_m",
                _text(place.tolist()),
                _text(moved),
                planned(changed(measurement, {"plan.mirror_m": moved})),
            )
    screen = measurement.model.screen
    width, height = (getattr(screen, key, None) for key in ("width_m", "height_m"))
    if width is not None and height is not None:
        larger = {"screen.width_m": _SCREEN_FACTOR * width, "screen.height_m": _SCREEN_FACTOR * height}
        yield Change(
            f"a screen {_SCREEN_FACTOR:g} times as large, with as many fringes",
            "screen.width_m, screen.height_m",
            _text((width, height)),
            _text(larger.values()),
            planned(changed(measurement, larger)),
        )
    for key, words, sources in _SIGMAS:
        sigma = value_of(measurement.model, key)
        each = np.atleast_1d(np.array(0.0 if sigma is None else sigma, dtype=np.float64))
        if (each > 0).any():
            half = 0.5 * each
            after = tuple(half.tolist()) if isinstance(sigma, tuple) else float(half[0])
            yield Change(
                words,
                key,
                _text(each.tolist()),
                _text(half.tolist()),
                planned(changed(measurement, {key: after})),
                sources,
            )
    yield from _stated(bench, planned)
    yield from _surveyed(bench, planned)


def _stated(bench: Bench, planned: Planner) -> Iterator[Change]:
    """Yield sigmas stated where the images alone would have to know the input."""
    measurement = bench.measurement
    unstated = inputs_without_sigma(measurement, bench.setup)
    if not isinstance(measurement.model.camera, CameraParameters):
        # Its sigmas are in its file.
        unstated -= {"camera.focal_x_px"}
    for told_by, sigmas, words in _UNSTATED:
        if told_by in unstated:
            yield Change(
                words,
                ", ".join(sigmas),
                "",
                _text(np.concatenate([np.atleast_1d(one) for one in sigmas.values()]).tolist()),
                planned(changed(measurement, sigmas)),
                (UNSTATED,),
                states_sigma=True,
            )


def _surveyed(bench: Bench, planned: Planner) -> Iterator[Change]:
    """Yield a survey of the mirror's place, where none is planned."""
    section = bench.measurement.model.mirror
    if section.place is not None or section.pose is not None:
        return
    place = bench.setup.cam_from_screen.inverse().apply(bench.cam_from_mirror.translation_m)
    surveyed = {"place_m": tuple(place.tolist()), "sigma_mm": (_PLACE_MM,) * 3}
    yield Change(
        f"the mirror's place surveyed in the screen's frame to {_PLACE_MM:g} mm",
        "mirror.place",
        "",
        f"{_PLACE_MM:g} mm",
        planned(changed(bench.measurement, {"mirror.place": surveyed})),
    )


def changed(measurement: _Measurement, values: Mapping[str, Any]) -> _Measurement:
    """Return a measurement with other values of keys, as if its file had said so."""
    return replace(measurement, model=changed_model(measurement.model, values))


def _text(values: Any) -> str:
    """Write numbers that belong together: to four digits of the largest, so that noise of rounding is 0."""
    listed = [float(one) for one in values]
    scale = max(map(abs, listed)) or 1.0
    return ", ".join(f"{round(one / scale, 9) * scale + 0.0:.4g}" for one in listed)


def input_files(measurement: BenchMeasurement, named: Sequence[str]) -> tuple[Path, ...]:
    """Return the files of a plan, measurement.toml first."""
    return (measurement.folder / "measurement.toml", *(measurement.path(one) for one in named))
