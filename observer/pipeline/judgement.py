"""How far a result may be believed: what was stated beside what photos and result show, each contradiction a doubt."""

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.images.photos import read_luma
from observer.absorber.product import absorber_doubts
from observer.doubts.halves import halves_doubt
from observer.doubts.list_as_whole import list_doubt
from observer.doubts.photos import missing_photos_doubt, other_sizes_doubt, overexposure_doubt, sparse_doubt
from observer.doubts.stated_absorber import stated_absorber_doubt
from observer.doubts.stated_dimensions import (
    diameter_doubt,
    diameter_of_absorber,
    focal_length_doubt,
    focal_length_of_mirror,
    heights_doubt,
    outline_doubts,
    panels_doubt,
)
from observer.photo_edges.outline import clipped_share, photos_from_above, plates_of, rims_in_photo, spans_of
from observer.pipeline.cameras import Cameras
from observer.pipeline.inputs import Inputs
from observer.pipeline.mirror import PlacedAbsorber, SolvedMirror
from observer.pipeline.panels import PlacedPanels
from observer.pipeline.reading.photos import FirstLook
from observer.pipeline.reading.tone import Encodings
from observer.pipeline.stated_camera import is_camera_wrong, stated_camera_doubt
from observer.pipeline.target_list import CheckedList
from observer.product.longitudinal import incidence_doubt
from observer.selection.edge_refusal import unchecked_doubt, undecided_doubt
from observer.slopes.edge_gaps import gaps_doubt
from observer.slopes.shape_share import shape_doubt
from observer.trough.collector import Collector
from observer.trough.visibility import beyond_tube_doubt, coverage_doubt, seeable_shares

#: Findings that a wrong number makes by itself: with that one named, what they advise (another sigma of panels, that
#: the surface follows its slopes, another diameter) would hide it.
_EXPLAINED_BY = {
    "list_beside_mirror": {
        "panel_heights_contradict_reflection",
        "surface_shape_contradicts_reflection",
        "surface_shape_undecided",
    },
    "focal_length_contradicts_photos": {
        "panel_heights_contradict_reflection",
        "surface_shape_contradicts_reflection",
        "surface_shape_undecided",
    },
    "camera_contradicts_targets": {"known_place_contradicts", "targets_contradict_list"},
    "focal_length_contradicts_targets": {"known_place_contradicts", "targets_contradict_list"},
    "principal_point_contradicts_targets": {"known_place_contradicts", "targets_contradict_list"},
    "targets_contradict_list": {"known_place_contradicts"},
    "stated_absorber_contradicts_photos": {"surface_shape_contradicts_reflection", "surface_shape_undecided"},
    "glass_not_stated": {"absorber_diameter_contradicts_reflection", "absorber_diameter_contradicts_photos"},
    "absorber_diameter_contradicts_reflection": {"absorber_diameter_contradicts_photos"},
}

#: A place, and two beside it across the optical axis, small against any distance [m].
_SMALL_STEPS = (np.zeros(3), np.array([0.01, 0.0, 0.0]), np.array([0.0, 0.01, 0.0]))


def judge(
    inputs: Inputs,
    listed: CheckedList,
    panels: PlacedPanels,
    placed: PlacedAbsorber,
    mirror: SolvedMirror,
    encodings: Encodings,
) -> tuple[Doubt, ...]:
    """Return what is doubtful of a solution, and of what was stated.

    encodings: Of the photos.
    InputError: A photo cannot be read.
    """
    cameras, reflector, slope_map = panels.cameras, mirror.reflector, mirror.slope_map
    eyes = cameras.photos.eyes_m
    along_rad = reflector.roughness.along_rad
    camera = stated_camera_doubt(cameras.network, listed.survey, listed.first, inputs.n_modules)
    sparse = sparse_doubt(seeable_shares(mirror.visible, slope_map.aperture, slope_map.valid)[1], eyes)
    usual_sigma = float(np.median(slope_map.sigma_slope()[0][slope_map.valid]))
    # A camera that is proven wrong makes a right list look wrong.
    lies_aside = None
    if panels.listed is not None and not is_camera_wrong(camera):
        lies_aside = list_doubt(panels.listed, panels.moved_rad, usual_sigma, inputs.n_modules)
    is_list_wrong = is_camera_wrong(camera) or _is_serious(lies_aside)
    # ... and either one the tube of a table.
    tube = None
    if placed.seen is not None and not is_list_wrong:
        tube = stated_absorber_doubt(placed.path, placed.seen, inputs.collector, usual_sigma, inputs.n_modules)
    if _is_serious(tube):
        # The shape of panels that comes out with it moves their edges.
        lies_aside = None
    # Each of these, or a few photos, contradict right dimensions.
    with_sizes = not is_list_wrong and not _is_serious(tube) and sparse is None
    own_sigma = np.sqrt(reflector.errors.random[..., 0, 0][slope_map.valid])
    return gather_doubts(
        inputs.doubts,
        listed.doubts,
        camera,
        lies_aside,
        panels.doubts,
        inputs.panels_doubts,
        panels_doubt(reflector.roughness, inputs.collector),
        heights_doubt(reflector) if with_sizes else None,
        sparse,
        gaps_doubt(reflector.gaps, reflector.roughness, own_sigma, eyes),
        missing_photos_doubt([file.name for file in inputs.survey.photo_files]),
        None if _is_mixed(encodings) else _sizes_doubt(cameras, listed.first),
        design_doubts(
            cameras,
            mirror,
            inputs.collector,
            with_sizes=with_sizes,
            encoding_is_clear=not encodings.doubts,
            n_modules=inputs.n_modules,
        ),
        absorber_doubts(
            mirror.absorber, mirror.solution, inputs.collector, is_design=inputs.absorber_source == "design"
        ),
        tube,
        coverage_doubt(mirror.visible, slope_map.x_m, slope_map.aperture, eyes),
        beyond_tube_doubt(mirror.visible, slope_map.aperture, inputs.collector, eyes),
        incidence_doubt(slope_map, eyes, inputs.collector, along_rad),
        shape_doubt(reflector.shape, inputs.shape_from_slopes, usual_sigma),
        unchecked_doubt(reflector.fate),
        undecided_doubt(reflector.fate),
        halves_doubt(reflector.halves, usual_sigma, inputs.n_modules),
    )


def without_consequences(doubts: tuple[Doubt, ...]) -> tuple[Doubt, ...]:
    """Leave out doubts that another one explains, which weighs as much: a small cause has no serious consequence."""
    weight = list(Severity).index

    def is_explained(one: Doubt) -> bool:
        return any(
            one.code in _EXPLAINED_BY.get(cause.code, ()) and weight(one.severity) <= weight(cause.severity)
            for cause in doubts
        )

    return tuple(one for one in doubts if not is_explained(one))


def _is_serious(doubt: Doubt | None) -> bool:
    return doubt is not None and doubt.severity is Severity.SERIOUS


def _is_mixed(encodings: Encodings) -> bool:
    return any(one.own for one in encodings.kinds)


def _sizes_doubt(cameras: Cameras, first: FirstLook) -> Doubt | None:
    """Compare the sizes of round targets between photos, each over what its place lets expect."""
    found, names = cameras.network.points, [file.name for file in cameras.files]
    # A target that no two photos place has none.
    placed = np.isfinite(found.xyz_m[:, 0])
    place = {name: xyz for name, xyz, known in zip(found.ids, found.xyz_m, placed, strict=True) if known}
    number = {name: k for k, name in enumerate(found.ids)}
    photo, target, sizes = [], [], []
    for one in first.targets:
        table = one.detections
        rows = [
            k
            for k, name in enumerate(table.names)
            if name in place and table.usable[k] and np.isfinite(table.radius_px[k])
        ]
        if not rows or table.photo not in names:
            continue
        view = cameras.views[names.index(table.photo)]
        middle = np.array([place[table.names[k]] for k in rows])
        # Targets look along the optical axis: a unit square across it shows how large a unit disc looks.
        corners = [view.project(middle + step) for step in _SMALL_STEPS]
        area = np.abs(np.linalg.det(np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=2)))
        photo += [names.index(table.photo)] * len(rows)
        target += [number[table.names[k]] for k in rows]
        sizes += (table.radius_px[rows] / np.sqrt(area)).tolist()
    return other_sizes_doubt(names, np.array(photo, np.intp), np.array(target, np.intp), np.array(sizes))


def design_doubts(
    cameras: Cameras,
    mirror: SolvedMirror,
    collector: Collector,
    *,
    with_sizes: bool = True,
    encoding_is_clear: bool = True,
    n_modules: int = 1,
) -> tuple[Doubt, ...]:
    """Compare width, length, focal length and tube diameter as stated with what seven of the photos show.

    with_sizes: Whether focal length and tube are judged.
    encoding_is_clear: Whether it is known how the photos are encoded, which changes the width of the tube.
    n_modules: Modules of the flight, each of which is judged.
    Returns: What does not fit; and whether the mirror is overexposed.
    InputError: A photo cannot be read.
    """
    targets = cameras.network.points
    plates = plates_of(targets.ids, targets.xyz_m)
    rims, clipped = [], []
    for number in photos_from_above(cameras.photos.eyes_m):
        image, view = read_luma(cameras.files[number]), cameras.views[number]
        rims.append(rims_in_photo(image, view, collector, plates))
        clipped.append(clipped_share(image, view, collector))
    focal_length, diameter = None, None
    if with_sizes:
        seen = focal_length_of_mirror(mirror.slope_map, collector)
        focal_length = focal_length_doubt(seen, mirror.absorber, collector)
        seen_width = diameter_of_absorber(mirror.reflector, collector)
        diameter = diameter_doubt(seen_width, collector, encoding_is_clear=encoding_is_clear, n_modules=n_modules)
    sizes = outline_doubts(*spans_of(np.array(rims)), collector)
    return gather_doubts(overexposure_doubt(float(np.median(clipped))), focal_length, diameter, sizes)
