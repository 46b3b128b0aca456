"""From the photo of a target in its file to the beam on the target's plane."""

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from calibration.beam.images.target_frames import (
    ArucoMarkers,
    CornerPixels,
    DarkMarks,
    MarkerTemplates,
    TargetFrame,
    WholeImage,
)
from calibration.beam.light.background import TargetSurface, empty_target
from calibration.beam.light.beam_flags import BeamFlag
from calibration.beam.light.beam_image import Beam, BeamSettings, measure_beam, no_beam
from calibration.beam.light.vignetting import LightFall, light_fall
from calibration.beam.target.marks import (
    CORNERS,
    MarkTemplate,
    TargetCorners,
    dark_corners,
    mark_corner,
    template_corners,
)
from calibration.beam.target.view import Rectifier, TargetImage, view_from_points, whole_image
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import Image, read_channel
from heliogauge.validate import float_array, freeze
from photogrammetry.detection import find_markers

__all__ = ["PhotoBeam", "TargetFinder"]


#: Pixels along each side of the target where the fall of the light is looked for: it is smooth.
_FALL_PX = 120


class PhotoBeam(NamedTuple):
    """The beam in a photo, and a note on the photo beyond its flags."""

    beam: Beam
    note: str = ""


class TargetFinder:
    """Rectifies the photos of one target; what does not change from photo to photo is made once.

    InputError: Templates or photos without a beam that cannot be used.
    EstimationError: The target is not found in a photo without a beam.
    """

    def __init__(self, frame: TargetFrame) -> None:
        self._frame = frame
        left, low = frame.corners_m.min(axis=0)
        right, high = frame.corners_m.max(axis=0)
        self._extent = np.array([left, right, low, high])
        self._templates = _templates(frame.source) if isinstance(frame.source, MarkerTemplates) else ()
        self._shape: tuple[int, int] | None = None
        self._fixed: Rectifier | None = None
        if isinstance(frame.source, CornerPixels):
            self._fixed = self._rectifier(
                TargetCorners(
                    float_array("pixels_px", frame.source.pixels_px, (4, 2)), frame.source.sigma_px, np.ones(4)
                )
            )
        self._near: TargetCorners | None = None
        self._photo_shape: tuple[int, ...] | None = None
        self._empty = self._empty_target()
        self._reflectance = None
        if frame.reflectance_file is not None:
            self._reflectance = np.asarray(read_channel(frame.reflectance_file, "luminance"), dtype=np.float64)
            if not (self._reflectance > 0).mean() > 0.5:
                raise InputError(f"{frame.reflectance_file}: more than half of the reflectance map is black")

    def look(self, file: Path) -> None:
        """Find the marks once, so that all photos start their search from the same place, whatever their order.

        Corners that are given in pixels are those of photos as large as this one, or as the frames without a beam.
        """
        if self._fixed is not None and self._photo_shape is None:
            with suppress(InputError):  # Its own row has the reason.
                self._photo_shape = read_channel(file, self._frame.channel).shape
        if isinstance(self._frame.source, MarkerTemplates):
            try:
                self._near = template_corners(read_channel(file, self._frame.channel), self._templates)
            except (EstimationError, InputError):
                return  # Each photo then searches for itself, and notes what is wrong with it.

    def measure(self, file: Path, settings: BeamSettings) -> PhotoBeam:
        """Measure one photo; the note says what cannot be measured, nothing is raised."""
        try:
            photo = read_channel(file, self._frame.channel)
        except InputError as error:
            return PhotoBeam(no_beam(BeamFlag.UNREADABLE), str(error))
        try:
            image = self._on_target(photo)
        except (EstimationError, InputError) as error:
            return PhotoBeam(no_beam(BeamFlag.TARGET_NOT_FOUND), str(error))
        if self._empty is not None and self._empty.values_dn.shape != image.values_dn.shape:
            sizes = f"{image.values_dn.shape[::-1]} px, frames without a beam {self._empty.values_dn.shape[::-1]} px"
            return PhotoBeam(no_beam(BeamFlag.TARGET_NOT_FOUND), f"the target measures {sizes}")
        return PhotoBeam(measure_beam(image, empty=self._empty, reflectance=self._reflectance, settings=settings))

    def image(self, file: Path) -> TargetImage:
        """Read one photo and put it on the target's plane."""
        return self._on_target(read_channel(file, self._frame.channel))

    def lens_fall(self) -> LightFall | None:
        """Return what the lens takes from the light towards the photo's corners, by the first frame without a beam.

        Returns None: without such a frame, where photos are cut to the target, or where too little is seen of it.
        """
        if not self._empty_files or isinstance(self._frame.source, WholeImage):
            return None
        photo = read_channel(self._empty_files[0], self._frame.channel)
        source = self._frame.source
        corners = source.pixels_px if isinstance(source, CornerPixels) else self._corners(photo).pixels_px
        plane_from, seen = (np.asarray(one, dtype=np.float32) for one in (self._frame.corners_m, corners))
        homography = np.asarray(cv2.getPerspectiveTransform(plane_from, seen), dtype=np.float64)
        left, right, low, high = self._extent.tolist()
        x, y = np.linspace(left, right, _FALL_PX), np.linspace(low, high, _FALL_PX)
        places = np.stack([*np.meshgrid(x, y), np.ones((y.size, x.size))], axis=-1) @ homography.T
        pixels = places[..., :2] / places[..., 2:]
        maps = (pixels[..., 0].astype(np.float32), pixels[..., 1].astype(np.float32))
        values = np.asarray(cv2.remap(photo, *maps, cv2.INTER_LINEAR, borderValue=0), dtype=np.float64)
        middle = (np.array([photo.shape[1], photo.shape[0]]) - 1) / 2
        inside = np.all((pixels >= 0) & (pixels <= 2 * middle), axis=-1)
        radius2 = np.sum(((pixels - middle) ** 2), axis=-1) / float(middle @ middle)
        return light_fall(np.where(inside, values, np.nan), radius2, x, y)

    def _on_target(self, photo: Image) -> TargetImage:
        source = self._frame.source
        if isinstance(source, WholeImage):
            return whole_image(photo, self._frame.corners_m, by_index=source.places == "index")
        if self._fixed is not None:
            self._photo_shape = self._photo_shape or photo.shape
            if photo.shape != self._photo_shape:
                sizes = [f"{shape[1]} x {shape[0]} px" for shape in (photo.shape, self._photo_shape)]
                raise EstimationError(f"the photo has {sizes[0]}, corners_px are those of photos of {sizes[1]}")
            return self._fixed.rectify(photo, full_scale_dn=_full_scale(photo))
        return self._rectifier(self._corners(photo)).rectify(photo, full_scale_dn=_full_scale(photo))

    def _rectifier(self, corners: TargetCorners) -> Rectifier:
        frame = self._frame
        view = view_from_points(corners.pixels_px, frame.corners_m, camera=frame.camera, sigma_px=corners.sigma_px)
        made = Rectifier(view, self._extent, self._shape)
        if self._empty_files and self._shape is None:
            # Frames without a beam and photos must come out in the same pixels, wherever the marks are found.
            self._shape = made.size
        return made

    @property
    def _empty_files(self) -> tuple[Path, ...]:
        return self._frame.empty_files

    def _corners(self, photo: Image) -> TargetCorners:
        source = self._frame.source
        if isinstance(source, MarkerTemplates):
            return template_corners(photo, self._templates, near=self._near)
        if isinstance(source, ArucoMarkers):
            return _marker_centers(photo, source)
        outer = isinstance(source, DarkMarks) and source.corner == "outer"
        return dark_corners(photo, outer=outer)

    def _empty_target(self) -> TargetSurface | None:
        if not self._empty_files:
            return None
        return empty_target([self.image(file).values_dn for file in self._empty_files])


def _full_scale(photo: Image) -> float:
    # Luminance of a photo in 16 bit comes as float32 (heliogauge.images.photos).
    return 65535.0 if photo.dtype == np.uint16 or float(photo.max()) > 255.5 else 255.0


def _templates(source: MarkerTemplates) -> tuple[MarkTemplate, ...]:
    if len(source.files) != 4 or len(source.anchors_px) not in (0, 4):
        raise InputError(f"markers: four pictures are needed ({', '.join(CORNERS)}), not {len(source.files)}")
    templates = []
    for k, (file, corner) in enumerate(zip(source.files, CORNERS, strict=True)):
        values = np.asarray(read_channel(file, "luminance"), dtype=np.float64)
        try:
            anchor = source.anchors_px[k] if source.anchors_px else mark_corner(values, corner)[0]
        except EstimationError as error:
            raise InputError(
                f"{file}: {error}; give anchors_px, the target's corner in each of the four pictures [column, row]"
            ) from error
        templates.append(MarkTemplate(freeze(values), np.asarray(anchor, dtype=np.float64)))
    return tuple(templates)


def _marker_centers(photo: Image, source: ArucoMarkers) -> TargetCorners:
    found = find_markers(photo, "target", source.dictionary)
    missing = [number for number in source.ids if number not in found.numbers]
    twice = [number for number in source.ids if number in found.duplicated]
    if missing or twice:
        said = f"marker {missing[0]} is not found" if missing else f"marker {twice[0]} is found twice"
        raise EstimationError(f"{said} in the photo; the target has {', '.join(map(str, source.ids))}")
    squares = dict(zip(found.numbers, found.squares, strict=True))
    centers, sigmas = [], []
    for number in source.ids:
        a, b, c, d = squares[number].corners_px
        # The middle of a square is where its diagonals cross, also in perspective.
        along = np.linalg.solve(np.stack([c - a, b - d], axis=1), b - a)
        centers.append(a + along[0] * (c - a))
        sigmas.append(squares[number].covariance_px2)
    sigma = float(np.sqrt(np.mean([np.trace(each, axis1=-2, axis2=-1) / 2 for each in sigmas])))
    return TargetCorners(freeze(np.array(centers)), sigma, np.ones(4))
