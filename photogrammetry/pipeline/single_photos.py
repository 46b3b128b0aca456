"""What is read in single photos, without a network: codes with their centres, and what was refused."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.regular import MOST_IMAGE_BYTES
from heliogauge.flags import SampleFlag
from heliogauge.images.camera_raw import CAMERA_RAW
from heliogauge.images.photos import read_image
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.folder import Summary, hash_files, write_table_csv
from heliogauge.results.frame import InstrumentResult
from heliogauge.results.thumbnails import write_thumbnails
from heliogauge.running.progress import Progress, SilentProgress
from heliogauge.validate import FlagArray
from photogrammetry.detection.detections import Detections
from photogrammetry.detection.photo_targets import TargetSearch
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.pipeline.inputs import build_search
from photogrammetry.pipeline.overlay import draw_overlay
from photogrammetry.pipeline.photos import (
    OnePhoto,
    find_systematic_faults,
    measure_photo,
    read_together,
    without_doubled,
)

OVERLAY_FOLDER = "overlays"
_PHOTO_SUFFIXES = CAMERA_RAW | {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp"}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TargetsResult(InstrumentResult):
    """What was read in some photos.

    photos: What each shows.
    overlays: Each photo with what was found drawn on it, as a JPEG file.
    """

    kind: ClassVar[str] = "photogrammetry-targets"
    photos: tuple[OnePhoto, ...]
    overlays: tuple[bytes, ...]

    def summarise(self) -> Summary:
        """Collect counts, sizes and sigmas."""
        coded = [one.detections for one in self.photos]
        sigma = np.concatenate([np.sqrt(0.5 * (one.sigma_px**2).sum(axis=1)) for one in coded])
        radius = np.concatenate([one.radius_px for one in coded])
        names = {name.split(".")[0] for one in coded for name in one.names}
        known = np.isfinite(radius)
        numbers: dict[str, float | int | None] = {
            "photos_count": len(self.photos),
            "targets_read_count": len(sigma),
            "codes_count": len(names),
            "refused_count": sum(len(one.refused) for one in self.photos),
            "dots_without_code_count": sum(len(one.dots) for one in self.photos),
            "center_sigma_median_px": float(np.median(sigma)) if len(sigma) else None,
            "dot_diameter_median_px": float(2 * np.median(radius[known])) if known.any() else None,
        }
        radii = [one.unread.radii for one in self.photos if one.unread is not None and one.unread.radii is not None]
        for name in ("inner", "outer"):
            middle = float(np.median([getattr(one, name) for one in radii])) if radii else None
            numbers[f"ring_{name}_radius_ratio"] = middle
        missing = {key: "no target was read" for key, value in numbers.items() if value is None}
        return self._summary(numbers, {}, missing)

    def write_files(self, folder: Path) -> None:
        """Write the tables and overlays into an existing folder."""
        write_table_csv(folder / "targets.csv", _table([one.detections for one in self.photos], "code"))
        write_table_csv(folder / "dots.csv", _table([one.dots for one in self.photos], "dot"))
        refused = [(one.detections.photo, bad) for one in self.photos for bad in one.refused]
        places = [(np.nan, np.nan) if bad.place is None else (bad.place.x_px, bad.place.y_px) for _, bad in refused]
        columns: dict[str, Any] = {
            "photo": [photo for photo, _ in refused],
            "name": [bad.name for _, bad in refused],
            "x_px": np.array([x for x, _ in places]),
            "y_px": np.array([y for _, y in places]),
            "reason": [bad.reason for _, bad in refused],
        }
        write_table_csv(folder / "refused.csv", columns)
        sizes: dict[str, Any] = {
            "photo": [one.detections.photo for one in self.photos],
            "width_px": np.array([one.size_px[0] for one in self.photos]),
            "height_px": np.array([one.size_px[1] for one in self.photos]),
        }
        write_table_csv(folder / "photos.csv", sizes)
        write_thumbnails(folder, {one.detections.photo: one.thumbnail for one in self.photos if one.thumbnail})
        place = folder / OVERLAY_FOLDER
        place.mkdir(exist_ok=True)
        for one, picture in zip(self.photos, self.overlays, strict=True):
            (place / f"{Path(one.detections.photo).stem}.jpg").write_bytes(picture)

    def headline(self) -> str:
        """Return what was read in a few lines for the terminal."""
        numbers = self.summarise().numbers
        lines = [
            f"{numbers['targets_read_count']} targets read in {numbers['photos_count']} photos "
            f"({numbers['codes_count']} different codes), {numbers['refused_count']} refused, "
            f"{numbers['dots_without_code_count']} dots without a code"
        ]
        width = max((len(one.detections.photo) for one in self.photos), default=0)
        for one in self.photos[:20]:
            sigma = np.sqrt(0.5 * (one.detections.sigma_px**2).sum(axis=1))
            middle = f", sigma of a centre {np.median(sigma):.3f} px (median)" if len(sigma) else ""
            lines.append(
                f"  {one.detections.photo:{width}}  {len(one.detections)} read, {len(one.refused)} refused{middle}"
            )
        if len(self.photos) > 20:
            lines.append(f"  and {len(self.photos) - 20} more, see targets.csv")
        return "\n".join(lines)


def read_single_photos(
    files: Sequence[Path], section: TargetsSection, *, jobs: int | None = None, progress: Progress | None = None
) -> TargetsResult:
    """Read the targets of photos, each by itself but for where the sheet has its rings.

    files: The photos; of a folder all photos in it.
    section: What is searched for.
    jobs: Photos measured side by side.
    InputError: No photos, one that cannot be read, names that occur twice, or an impossible dictionary.
    """
    progress = progress or SilentProgress()
    paths = _photo_paths(files)
    search = build_search(section, Path())
    with progress.stage("hash inputs"):
        hashes = hash_files(paths, most_bytes=MOST_IMAGE_BYTES)

    def one(file: Path, asked: TargetSearch) -> tuple[OnePhoto, bytes]:
        image = read_image(file)
        found = without_doubled(measure_photo(image, file.name, section, asked))
        return found.with_thumbnail(make_thumbnail(image)), draw_overlay(image, found)

    found = read_together("read photos", one, paths, search, lambda both: both[0], jobs=jobs, progress=progress)
    photos = tuple(photo for photo, _ in found)
    doubts: tuple[Doubt, ...] = find_systematic_faults(photos)
    name = paths[0].name if len(paths) == 1 else f"{len(paths)} photos of targets"
    return TargetsResult(
        name=name,
        photos=photos,
        overlays=tuple(picture for _, picture in found),
        doubts=doubts,
        durations_s=dict(progress.durations_s),
        input_sha256=hashes,
    )


def _photo_paths(files: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for file in files:
        if file.is_dir():
            inside = sorted(path for path in file.iterdir() if path.suffix.lower() in _PHOTO_SUFFIXES)
            if not inside:
                raise InputError(f"{file}: there is no photo in this folder (JPEG, PNG, TIFF)")
            found += inside
        else:
            found.append(file)
    if not found:
        raise InputError("photos: at least one is needed")
    stems: dict[str, Path] = {}
    for path in found:
        if path.stem in stems:
            raise InputError(f"photos: {stems[path.stem]} and {path} have one name; read them one after the other")
        stems[path.stem] = path
    return found


def _table(parts: Sequence[Detections], name: str) -> dict[str, Any]:
    sigma = np.concatenate([np.sqrt(0.5 * (one.sigma_px**2).sum(axis=1)) for one in parts])
    pixels = np.concatenate([one.pixels_px for one in parts])
    return {
        "photo": [one.photo for one in parts for _ in one.names],
        name: [text for one in parts for text in one.names],
        "x_px": pixels[:, 0],
        "y_px": pixels[:, 1],
        "sigma_px": sigma,
        "radius_px": np.concatenate([one.radius_px for one in parts]),
        "flag": [words_of_flags(mask) for one in parts for mask in one.flags],
    }


def words_of_flags(mask: FlagArray) -> str:
    """Return the names of the flags of one sample, in lower case with blanks between them; empty without any."""
    return " ".join(str(flag.name).lower() for flag in SampleFlag if int(mask) & flag)
