"""One flight over several collectors (QFly): photos read once, each module solved for itself, one overview."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.errors import EstimationError, InputError, MetrologyError
from heliogauge.geometry.rigid import RigidTransform, rotation_from_vector
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress, Stage
from observer.keys import ModuleSection, ObserverMeasurement
from observer.pipeline.corners import find_corners_of_each
from observer.pipeline.inputs import AXES, Inputs, build_collector, build_inputs, listed_coordinates, read_tables
from observer.pipeline.measure import Options, evaluate
from observer.pipeline.reading.photos import FirstLook, look_first_at_each
from observer.pipeline.target_list import CheckedList, leave_out_lines
from observer.pipeline.unknown_camera import start_unknown_camera_of_each
from observer.studies import overview as pipeline_overview
from observer.targets.module_targets import ListedPlaces, beside, in_frame
from observer.trough.collector import Collector
from photogrammetry.keys import CoordinateSection
from photogrammetry.start_values import LEAST_TARGETS


@dataclass(frozen=True, slots=True, eq=False)
class _Module:
    """One collector of the flight: what measurement.toml says of it, as values too, and the names of its targets."""

    section: ModuleSection
    inputs: Inputs
    targets: frozenset[str]


def run(
    measurement: ObserverMeasurement,
    folder: Path,
    options: Options | None = None,
    progress: Progress | None = None,
) -> pipeline_overview.Result:
    """Evaluate all modules of a flight and write each one's results, and the overview, into a folder.

    folder: An existing folder; gets a folder for each module. Only one module's results are in memory at a time.
    Returns: What each module gave, or why it gave nothing.
    InputError: Photos, targets, camera or dimensions that cannot be used.
    EstimationError: No module could be measured; the message has each one's reason.
    """
    options, progress = options or Options(), progress or SilentProgress()
    with progress.stage("hash inputs"):
        hashes = hash_files(measurement.input_files, measurement.folder)
    modules, failed = _modules(measurement)
    looks: list[FirstLook] = []
    started = start_unknown_camera_of_each([one.inputs for one in modules], options.jobs, progress)
    modules = [replace(module, inputs=inputs) for module, inputs in zip(modules, started, strict=True)]
    if modules:
        looks = _look_at_each(measurement, modules, options, progress)
    for module in modules:
        name = module.section.name
        try:
            # Nothing of a module is needed any more when it is solved.
            _solve(module, looks.pop(0), folder / name, options, _Named(progress, name), hashes)
        except MetrologyError as error:
            failed[name] = str(error)
            shutil.rmtree(folder / name, ignore_errors=True)
    done = [section for section in measurement.model.module if section.name not in failed]
    if not done:
        reasons = "\n".join(f"  {name}: {reason}" for name, reason in failed.items())
        raise EstimationError(f"{measurement.model.name}: none of {len(failed)} modules could be measured\n{reasons}")
    with progress.stage("overview"):
        # Those that failed have a place in the field, too.
        places = {one.name: np.array(one.place_m) for one in measurement.model.module}
        loops = {one.name: one.loop for one in measurement.model.module if one.loop is not None}
        found = pipeline_overview.run(
            [folder / one.name for one in done], base=folder, places_m=places, loops=loops, failed=failed
        )
        durations = _by_module(progress.durations_s, found.labels)
        found = replace(found, name=measurement.model.name, input_sha256=hashes, durations_s=durations)
        found.write(folder)
    return found


def _look_at_each(
    measurement: ObserverMeasurement, modules: list[_Module], options: Options, progress: Progress
) -> list[FirstLook]:
    """Return what the photos show of each module, by marked targets or by corners of its panels."""
    files, finders = measurement.photo_files, [one.inputs.finder for one in modules]
    searches = [one.inputs.corners for one in modules if one.inputs.corners is not None]
    if searches:
        return find_corners_of_each(files, finders, searches, jobs=options.jobs, progress=progress)
    targets = frozenset[str]().union(*(one.targets for one in modules))
    beside = [
        replace(one.inputs.finder, others=targets - one.targets, list_from_frame=_list_from_frame(one.section))
        for one in modules
    ]
    return look_first_at_each(files, beside, jobs=options.jobs, progress=progress)


def _list_from_frame(section: ModuleSection) -> RigidTransform | None:
    """Return where a module stands in the common list; None where it has a list of its own."""
    if section.targets_file is not None:
        return None
    turn = rotation_from_vector(np.array([0.0, np.radians(section.turn_deg), 0.0]))
    return RigidTransform(turn, np.array(section.place_m, dtype=np.float64))


def _solve(
    module: _Module,
    look: FirstLook,
    folder: Path,
    options: Options,
    progress: Progress,
    hashes: dict[str, str],
) -> None:
    """Evaluate one module and write its folder, which is there whole or not at all."""
    own = _own(look, module.targets) if module.inputs.corners is None else _posed(look)
    shown = {one.detections.photo for one in own.targets}
    survey = module.inputs.survey
    survey = replace(survey, photo_files=tuple(file for file in survey.photo_files if file.name in shown))
    # A flight passes beside each module: photos of one rim only are no news.
    if module.inputs.corners is None:
        listed = leave_out_lines(survey, own, module.inputs.finder.known)
    else:
        listed = CheckedList(survey, own, ())
    if len(listed.first.targets) < 2 and module.inputs.corners is not None:
        raise EstimationError(
            f"{len(listed.first.targets)} of {len(look.photos)} photos show enough corners of its panels for their "
            "pose, two are needed; are its panels and place_m right?"
        )
    if len(listed.first.targets) < 2:
        raise EstimationError(
            f"{len(listed.first.targets)} of {len(look.photos)} photos show enough of its {len(module.targets)} targets"
            f" for their pose ({LEAST_TARGETS}, not on a line), two are needed; are names and places in the list of "
            "targets, and place_m, right?"
        )
    shown = {file.name for file in listed.survey.photo_files}
    kept = {name: digest for name, digest in hashes.items() if Path(name).name in shown or not _is_photo(name, look)}
    inputs = replace(module.inputs, survey=listed.survey, input_sha256=kept)
    result = evaluate(inputs, listed.first, options, progress)
    with progress.stage("write results"):
        folder.mkdir()
        result.write(folder)


def _is_photo(name: str, look: FirstLook) -> bool:
    return Path(name).name in look.photos


def _posed(look: FirstLook) -> FirstLook:
    """Return what was found of one module in the photos that show enough corners of its panels."""
    return replace(look, targets=tuple(one for one in look.targets if one.detections.photo in look.poses))


def _own(look: FirstLook, targets: frozenset[str]) -> FirstLook:
    """Return what was found of one module: its own targets, in the photos that show enough of them."""
    found = []
    for one in look.targets:
        rows = np.array([k for k, name in enumerate(one.detections.names) if name in targets], dtype=np.intp)
        if rows.size >= LEAST_TARGETS:
            found.append(
                replace(one, detections=one.detections.chosen(rows), ellipses_px2=one.ellipses_px2[rows], refused=())
            )
    shown = {one.detections.photo for one in found}
    poses = {name: pose for name, pose in look.poses.items() if name in shown}
    return replace(look, targets=tuple(found), poses=poses)


def _modules(measurement: ObserverMeasurement) -> tuple[list[_Module], dict[str, str]]:
    """Return the modules that can be looked for, and by their names the reasons of those that cannot."""
    model = measurement.model
    modules, failed, n_modules = [], {}, len(model.module)
    for section in model.module:
        collector = section.collector or model.collector
        try:
            if model.corners is not None:
                modules.append(_by_corners(measurement, section))
                continue
            list_file = section.targets_file or str(model.targets_file)
            tables = read_tables(measurement, list_file)
            known = listed_coordinates(tables.targets or {}, measurement.folder / list_file)
            if section.targets_file is None:
                known = _near(known, section, build_collector(collector))
            targets = frozenset(one.target for one in known)
            if len(targets) < LEAST_TARGETS:
                raise InputError(
                    f"{len(targets)} targets of the list are beside it, {LEAST_TARGETS} are needed; place_m = "
                    f"{list(section.place_m)} is where its origin is in the frame of the list"
                )
            bars = tuple(one for one in model.scale_bar if {one.a, one.b} <= targets)
            lengths = tuple(one for one in model.distance if {one.a, one.b} <= targets)
            named = {"name": section.name, "collector": collector, "module": ()}
            own = model.model_copy(update={**named, "scale_bar": bars, "distance": lengths})
            inputs = build_inputs(replace(measurement, model=own), tables, known)
            modules.append(_Module(section, replace(inputs, n_modules=n_modules), targets))
        except InputError as error:
            failed[section.name] = str(error)
    return modules, failed


def _by_corners(measurement: ObserverMeasurement, section: ModuleSection) -> _Module:
    """Return a module whose panels' corners take the place of targets.

    InputError: A drawing without corners that can be seen, or positions that cannot be read.
    """
    model = measurement.model
    collector = section.collector or model.collector
    turned = collector.model_copy(update={"orientation_deg": collector.orientation_deg + section.turn_deg})
    own = replace(measurement, model=model.model_copy(update={"name": section.name, "collector": turned, "module": ()}))
    inputs = build_inputs(own, read_tables(own, None), (), section.place_m)
    return _Module(section, replace(inputs, n_modules=len(model.module)), frozenset())


def _near(
    known: tuple[CoordinateSection, ...], section: ModuleSection, collector: Collector
) -> tuple[CoordinateSection, ...]:
    """Return the coordinates of a module's targets in its own frame."""
    names = tuple(dict.fromkeys(one.target for one in known))
    row = {name: number for number, name in enumerate(names)}
    places, sigma = np.zeros((len(names), 3)), np.full((len(names), 3), np.nan)
    for one in known:
        cell = row[one.target], AXES.index(one.axis)
        places[cell], sigma[cell] = one.value_m, 1e-3 * one.sigma_mm
    own = in_frame(ListedPlaces(names, places, sigma), np.array(section.place_m), float(np.radians(section.turn_deg)))
    return tuple(
        CoordinateSection(
            kind="coordinate",
            target=names[k],
            axis=axis,
            value_m=float(own.places_m[k, place]),
            sigma_mm=1e3 * float(own.sigma_m[k, place]),
        )
        for k in beside(own, collector)
        for place, axis in enumerate(AXES)
        if np.isfinite(own.sigma_m[k, place])
    )


def _by_module(durations_s: dict[str, float], names: tuple[str, ...]) -> dict[str, float]:
    """Return the times of the common stages, and of each module the sum."""
    owner = {stage: next((name for name in names if stage.startswith(f"{name}: ")), stage) for stage in durations_s}
    return {name: sum(s for stage, s in durations_s.items() if owner[stage] == name) for name in owner.values()}


class _Named:
    """Progress of one module: its name stands before each stage.

    progress: Receives the stages.
    """

    def __init__(self, progress: Progress, name: str) -> None:
        self._progress = progress
        self._name = name

    @property
    def durations_s(self) -> dict[str, float]:
        """Wall time of each finished stage of this module [s]."""
        start = f"{self._name}: "
        return {key.removeprefix(start): s for key, s in self._progress.durations_s.items() if key.startswith(start)}

    @contextmanager
    def stage(self, name: str, steps: int = 0) -> Iterator[Stage]:
        """Open a stage."""
        with self._progress.stage(f"{self._name}: {name}", steps) as stage:
            yield stage

    def say(self, text: str) -> None:
        """Pass on one line for the person who waits."""
        self._progress.say(f"{self._name}: {text}")
