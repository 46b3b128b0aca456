"""Backward gazing from images to slope maps: the stages follow each other in `run`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from deflectometry.gazing.camera_gains import (
    Gains,
    LeftOutCamera,
    contradicting_camera,
    fit_gains,
    refuse_exchanged,
    spread_nodes,
)
from deflectometry.gazing.facet_maps import (
    SolvedFacet,
    blind_zones,
    common_modes,
    facet_map,
    misfit_factor,
)
from deflectometry.gazing.keys import GazingMeasurement
from deflectometry.gazing.mirror_points import (
    FEWEST_CAMERAS,
    PIXELS_ACROSS,
    FacetGrid,
    FacetPixels,
    brightness_of,
    collect_pixels,
    footprint_m,
    grid_of,
    pixel_noise,
)
from deflectometry.gazing.node_slopes import Brightness, NodeSlopes, solve_nodes
from deflectometry.gazing.pipeline.disc_check import disc_doubts
from deflectometry.gazing.pipeline.inputs import (
    GazingCamera,
    gazing_sigmas,
    level_covariance,
    mirror_frame,
    read_camera,
    read_sun,
    sun_direction,
)
from deflectometry.gazing.pipeline.place_check import place_doubts
from deflectometry.gazing.pipeline.pointing import mean_pointing, pointing_by_points, pointing_doubts
from deflectometry.gazing.pipeline.result import CameraRow, GazingResult, Pointing
from deflectometry.gazing.sun_profile import SunImage
from deflectometry.pipeline.choices import Options
from deflectometry.pipeline.curl_test import CurlRemedies, curl_doubt
from deflectometry.pipeline.headline import canting_numbers, curl_numbers, facet_numbers, joined_curl, numbers_of_maps
from deflectometry.pipeline.inputs import build_facets, build_mounts
from deflectometry.shape.assemble import assemble_maps
from deflectometry.shape.facet_canting import canting_of_facets, doubt_of_canting
from deflectometry.shape.gridding import default_step_m
from deflectometry.shape.smooth_shape import Align, alignment_words
from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.surfaces import Facet
from heliogauge.results.folder import hash_files
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.slopes.grid import curl_rms
from heliogauge.slopes.map import SlopeMap
from heliogauge.slopes.removal import Removal, remove
from heliogauge.validate import BoolArray, FloatArray

#: Scatter beyond this many times the sigmas is said.
_WORTH_SAYING = 1.3
_CURL_REMEDIES = CurlRemedies(
    "sigmas of single points are too small by that; check flat fields, focus, stray light and each camera's points",
    "check the names and places of the cameras, the points that orient them, flat fields, and whether the mirror or a "
    "cloud moved between their frames",
)
#: A camera that is saturated in more of its image is said: a hot pixel is not.
_SATURATED_SHARE = 1e-3


def run(
    measurement: GazingMeasurement, options: Options | None = None, progress: Progress | None = None
) -> GazingResult:
    """Find the slopes of a heliostat from the brightness of the sun's image in it.

    options: Choices that override the file's; strict refuses a camera that would be left out.
    InputError: Images that cannot be read or do not belong together.
    EstimationError: No sun, clouds before it, cameras exchanged, or too few cameras.
    """
    options, progress, model = options or Options(), progress or SilentProgress(), measurement.model
    facets = build_facets(model.mirror, model.name)
    if not facets:
        raise InputError(f"{measurement.folder}: mirror.outline_m or [[mirror.facet]] is needed")
    sun_in_field = sun_direction(model.sun)
    mirror_from_field = mirror_frame(model.mirror, sun_in_field).inverse()
    sun = mirror_from_field.rotate(sun_in_field)
    with progress.stage("sun"):
        of_sun = read_sun(measurement)
    with progress.stage("images", steps=len(model.camera)) as stage:
        by_points = pointing_by_points(measurement, mirror_from_field.inverse())
        cameras = []
        for section in model.camera:
            cameras.append(read_camera(measurement, section, mirror_from_field))
            stage.advance()
    with progress.stage("mirror points"):
        step_m = _step_m(options, measurement, cameras, facets)
        grids = [grid_of(facet, step_m) for facet in facets]
        seen = _brightness(grids, cameras, sun, model.photometry.reflectance)
    with progress.stage("levels"):
        prior = level_covariance(measurement, cameras, of_sun)
        names = [one.name for one in cameras]
        some = spread_nodes([bright for bright, _, _ in seen])
        if not some:
            raise EstimationError(
                "no camera sees the sun anywhere in the mirror: check time, the sun's direction, mirror.place_m and "
                "the cameras' places, or whether the heliostat tracked"
            )
        sigmas = gazing_sigmas(measurement, list(range(len(cameras))))
        places = np.diag(sigmas.eyes_m**2) + sigmas.mirror_m**2
        refuse_exchanged(names, some, of_sun.profile, prior, places)
        gains = fit_gains(some, of_sun.profile, prior, places)
        left_out = contradicting_camera(gains, prior)
        chosen = [number for number in range(len(cameras)) if left_out is None or number != left_out.number]
        if left_out is not None and options.strict:
            raise EstimationError(f"{_contradiction(names[left_out.number], left_out.gain, left_out.sigma)}, --strict")
        kept = np.array(chosen)
        if left_out is not None:
            prior = prior[np.ix_(kept, kept)]
            places = places[np.ix_(kept, kept)]
            gains = fit_gains([one.of_cameras(kept) for one in some], of_sun.profile, prior, places)
        _refuse_impossible_gains([names[number] for number in chosen], gains, prior)
    with progress.stage("slopes", steps=len(facets)) as stage:
        solved = []
        for grid, (bright, nodes, saturated) in zip(grids, seen, strict=True):
            few = bright.of_cameras(kept).moved(gains.shift_m)
            found = solve_nodes(few, gains.profile, gains.factors)
            solved.append(SolvedFacet(grid, nodes, saturated, few, found))
            stage.advance()
    with progress.stage("maps"):
        factor = misfit_factor(solved)
        sigmas = gazing_sigmas(measurement, chosen)
        frame = "facet frame: x across, y up, seen from the front, z out of the mirror [m]"
        largest = 1e-3 * model.evaluation.largest_sigma_mrad
        all_modes = common_modes(solved, gains, sigmas)
        as_nominal = {
            one.grid.facet.name: facet_map(_scaled(one, factor), modes, largest, frame)
            for one, modes in zip(solved, all_modes, strict=True)
        }
        doubts = [*blind_zones(list(as_nominal.values()))]
        as_nominal = {name: one for name, one in as_nominal.items() if np.isfinite(curl_rms(one)[0])}
        if not as_nominal:
            raise EstimationError(
                "no point of the mirror is known well enough: "
                + ("; ".join(one.text for one in doubts) or "every point contradicts the sun's profile")
            )
        pointing = mean_pointing(as_nominal)
        align = options.align or Align(model.evaluation.align)
        as_measured = {
            name: replace(
                _turned(one, pointing) if align is Align.NORMAL else one, removed=alignment_words(align, len(facets))
            )
            for name, one in as_nominal.items()
        }
    with progress.stage("statistics"):
        removal = options.remove or Removal(model.evaluation.remove)
        maps = {name: remove(one, removal) for name, one in as_measured.items()}
        several = len(facets) > 1
        cantings = canting_of_facets(facets, as_measured, build_mounts(model.mirror)) if several else ()
        assembled = assemble_maps(facets, maps, align, removal)
        whole = assemble_maps(facets, as_measured, align, Removal.NOTHING)
        numbers = facet_numbers(assembled, whole) | joined_curl(as_measured)
        numbers |= canting_numbers(cantings) | pointing.numbers()
    return GazingResult(
        name=model.name,
        facets=facets,
        maps=maps,
        assembled=assembled,
        numbers=numbers,
        facet_numbers=numbers_of_maps(maps, as_measured, cantings) if several else {},
        cantings=cantings,
        sun=of_sun,
        cameras=tuple(_camera_rows(cameras, chosen, gains, left_out)),
        sun_direction=sun,
        doubts=gather_doubts(
            *doubts,
            curl_doubt({name: curl_numbers(one) for name, one in as_measured.items()}, _CURL_REMEDIES),
            doubt_of_canting(cantings) if several else None,
            *_doubts(measurement, of_sun, cameras, left_out, factor),
            *place_doubts([names[number] for number in chosen], gains, places),
            *pointing_doubts(model, pointing, by_points, _mean_sight(cameras)),
        ),
        durations_s=dict(progress.durations_s),
        input_sha256=hash_files(measurement.input_files, measurement.folder),
    )


def _step_m(
    options: Options, measurement: GazingMeasurement, cameras: Sequence[GazingCamera], facets: Sequence[Facet]
) -> float:
    step_mm = options.grid_step_mm or measurement.model.evaluation.grid_step_mm
    pixel = max(footprint_m(one.oriented) for one in cameras)
    if step_mm is not None:
        if 1e-3 * step_mm < 2 * pixel:
            raise InputError(
                f"grid_step_mm = {step_mm:g}: a node needs 2 pixels across, which are {2e3 * pixel:.3g} mm there"
            )
        return 1e-3 * step_mm
    # Rounded down to two digits as the grids of every other source.
    return default_step_m(PIXELS_ACROSS * pixel / 0.4, sum(facet.area_m2 for facet in facets))


def _brightness(
    grids: Sequence[FacetGrid], cameras: Sequence[GazingCamera], sun: FloatArray, reflectance: float
) -> list[tuple[Brightness, BoolArray, BoolArray]]:
    """Return brightness, nodes and nodes with saturated pixels of each facet."""
    pixels: list[list[FacetPixels]] = [
        [collect_pixels(one.oriented, one.light, grid) for grid in grids] for one in cameras
    ]
    noises = [pixel_noise(of_one) for of_one in pixels]
    levels = [reflectance * one.sun.level for one in cameras]
    found = []
    for number, grid in enumerate(grids):
        of_facet = [one[number] for one in pixels]
        bright, nodes = brightness_of(grid, of_facet, noises, levels, [one.oriented for one in cameras], sun)
        saturated = np.any([one.saturated > 0 for one in of_facet], axis=0)
        found.append((bright, nodes, np.asarray(saturated)))
    return found


def _mean_sight(cameras: Sequence[GazingCamera]) -> FloatArray:
    """Return the direction from the mirror to the middle of the cameras, shape (3,)."""
    middle = np.mean([one.oriented.eye_m for one in cameras], axis=0)
    return np.asarray(middle / np.linalg.norm(middle))


def _scaled(facet: SolvedFacet, factor: float) -> SolvedFacet:
    found = facet.found
    return replace(facet, found=NodeSlopes(found.slopes, factor**2 * found.covariance, found.misfit / factor**2))


def _refuse_impossible_gains(names: Sequence[str], gains: Gains, prior: FloatArray) -> None:
    """Refuse levels that neither reflectance nor one camera explains."""
    off = gains.logarithm / np.sqrt(np.diag(prior))
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) < 5.0 and gains.misfit.max() < 20.0:
        return
    listed = ", ".join(f"{name} {factor:.3g}" for name, factor in zip(names, gains.factors, strict=True))
    raise EstimationError(
        f"the cameras see other brightnesses than sun and reflectance explain (factors: {listed}; residuals up to "
        f"{gains.misfit.max():.3g} sigma): a cloud before the sun while some frames were taken, a filter or an "
        "exposure that is not the one stated, or another reflectance; levels are known to "
        f"{100 * float(np.sqrt(prior.diagonal().max())):.2g} %"
    )


def _turned(slope_map: SlopeMap, pointing: Pointing) -> SlopeMap:
    """Return a map whose frame is turned by the pointing; the modes lose what they do to the mean of all facets."""
    common = slope_map.common
    coefficients = common.coefficients.copy()
    if len(common.sources):
        coefficients[:, :, 0] -= pointing.modes
    return replace(
        slope_map,
        slope_x=slope_map.slope_x - pointing.angle_rad[0],
        slope_y=slope_map.slope_y - pointing.angle_rad[1],
        common=replace(common, coefficients=coefficients),
    )


def _camera_rows(
    cameras: Sequence[GazingCamera], chosen: Sequence[int], gains: Gains, left_out: LeftOutCamera | None
) -> Iterator[CameraRow]:
    for number, one in enumerate(cameras):
        if number in chosen:
            place = chosen.index(number)
            yield CameraRow(
                one.name,
                one.oriented.eye_m,
                float(gains.factors[place]),
                float(gains.factors[place] * gains.sigma[place]),
                float(gains.misfit[place]),
                one.oriented.residual_rms_px,
                "",
            )
        else:
            yield CameraRow(
                one.name,
                one.oriented.eye_m,
                np.nan if left_out is None else left_out.gain,
                np.nan if left_out is None else left_out.sigma,
                np.nan,
                one.oriented.residual_rms_px,
                "left out: its brightness contradicts that of the others",
            )


def _contradiction(name: str, gain: float, sigma: float) -> str:
    return (
        f"{name} sees {gain:.3g} (sigma {sigma:.2g}) times the brightness that all others explain: a cloud "
        "before the sun while its frames were taken, another filter or another exposure than stated"
    )


def _doubts(
    measurement: GazingMeasurement,
    of_sun: SunImage,
    cameras: Sequence[GazingCamera],
    left_out: LeftOutCamera | None,
    factor: float,
) -> Iterator[Doubt]:
    model = measurement.model
    if left_out is not None:
        yield Doubt(
            "camera_contradicts_others",
            f"{_contradiction(cameras[left_out.number].name, left_out.gain, left_out.sigma)}; it is left out",
            {"gain_ratio": left_out.gain, "sigma_gain_ratio": left_out.sigma},
        )
    if len(cameras) - (left_out is not None) <= FEWEST_CAMERAS:
        yield Doubt(
            "three_cameras_only",
            "three cameras leave no check: a fourth would show a cloud, a wrong filter or an exchange",
            {},
            Severity.NOTE,
        )
    yield from disc_doubts(model.sun, of_sun, cameras)
    for one in cameras:
        share = float(np.mean(one.light.saturated))
        if share > _SATURATED_SHARE:
            yield Doubt(
                "camera_saturated",
                f"{one.name}: {100 * share:.0f} % of its pixels are saturated; the mirror's points there rest on the "
                "other cameras alone, or are not measured; take a shorter exposure",
                {"saturated_share": share},
            )
    without = [one.name for one in cameras if not one.has_flat]
    if without:
        yield Doubt(
            "flat_missing",
            f"no flat field of {', '.join(without)}: the pixels count as alike, the level as known to "
            f"{model.photometry.sigma_missing_flat_percent:g} %; vignetting of 1 % looks like slopes of 0.05 mrad",
            {"cameras_count": len(without)},
        )
    if factor > _WORTH_SAYING:
        yield Doubt(
            "brightness_scatters_more",
            f"brightnesses differ from the sun's profile {factor:.2g} times as much as noise explains; "
            "all sigmas are raised by that: check flat fields, stray light and the profile",
            {"scatter_ratio": factor},
        )
    stated = {
        "mirror.sigma_place_mm": "sigma_place_mm" in model.mirror.model_fields_set,
        "camera.sigma_place_mm": all("sigma_place_mm" in one.model_fields_set for one in model.camera),
        "sun.sigma_direction_mrad": "sigma_direction_mrad" in model.sun.model_fields_set,
        "sun.sigma_focal_permille": "sigma_focal_permille" in model.sun.model_fields_set,
    }
    missing = [key for key, given in stated.items() if not given]
    if missing:
        yield Doubt(
            "gazing_sigmas_missing",
            f"no sigma is given for {', '.join(missing)}: they count as exact, and sigmas of pointing and focal length "
            "are too small",
            {"inputs_count": len(missing)},
        )
