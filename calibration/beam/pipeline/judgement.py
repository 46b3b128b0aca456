"""What a user must hear about measured beams."""

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from calibration.beam.light.beam_flags import BEAM_FLAG_TEXTS, BeamFlag
from heliogauge.doubts import Doubt, Severity, gather_doubts

if TYPE_CHECKING:
    from calibration.beam.files.result import Result

__all__ = ["doubts_of_beams"]

#: Share of the light in the skirts beyond which the size depends on how they are continued.
_MUCH_SKIRT = 0.1
#: Labels that show a common shift, and its size in sigmas: 5 of them come by chance once in a million.
_LEAST_LABELS, _ASIDE = 5, 5.0


def doubts_of_beams(result: "Result") -> tuple[Doubt, ...]:
    """Judge the beams of a measurement."""
    beams = result.beams
    doubts = []
    refused = beams.rejected
    if refused.any():
        reasons = Counter(reason.split(";")[0] for reason, bad in zip(beams.reasons, refused, strict=True) if bad)
        said = ", ".join(f"{count} x {reason}" for reason, count in reasons.most_common(3))
        doubts.append(
            Doubt(
                "beams_refused",
                f"{int(refused.sum())} of {refused.size} photos gave no beam that can be used ({said}); beams.csv "
                f"has the "
                "reason of each",
                {"refused_count": int(refused.sum()), "beams_count": refused.size},
                Severity.SERIOUS if refused.all() else Severity.DOUBT,
            )
        )
    if result.photos.left_out:
        name, reason = next(iter(result.photos.left_out.items()))
        doubts.append(
            Doubt(
                "photos_left_out",
                f"{len(result.photos.left_out)} rows or records were left out ({name}: {reason}); left_out.csv has all",
                {"left_out_count": len(result.photos.left_out)},
            )
        )
    saturated = (beams.flags & np.uint32(BeamFlag.SATURATED)) != 0
    if saturated.any():
        doubts.append(
            Doubt(
                "beams_saturated",
                f"in {int(saturated.sum())} of {saturated.size} photos {BEAM_FLAG_TEXTS[BeamFlag.SATURATED]}: peak, "
                f"flux and "
                "sizes are wrong there, the centre a little; shorten the exposure",
                {"saturated_count": int(saturated.sum()), "beams_count": saturated.size},
            )
        )
    doubts += [*_labels_aside(result), *_sun_down(result), *_light_falls_off(result), *_gauge_dark(result)]
    held = ~refused & ((beams.flags & np.uint32(BeamFlag.BACKGROUND_MAY_HOLD_LIGHT)) != 0)
    if held.any():
        shares = np.array([one.aureole_share for one in beams.sizes])[held]
        doubts.append(
            Doubt(
                "background_may_hold_light",
                f"in {int(held.sum())} of {held.size} photos light seems to be spread around the beam as wide as "
                f"the target (haze, a dirty mirror, the camera's halo), {float(np.median(shares)):.0%} of all light "
                f"(median): sizes are those of the light without it, and their sigma says what it would change; "
                f"give frames without a beam, and measure under a clear sky",
                {"beams_count": int(held.sum()), "median_aureole_share": float(np.median(shares))},
            )
        )
    uneven = ~refused & ((beams.flags & np.uint32(BeamFlag.UNEVEN_TARGET)) != 0)
    if uneven.any():
        doubts.append(
            Doubt(
                "target_uneven",
                f"in {int(uneven.sum())} of {uneven.size} photos {BEAM_FLAG_TEXTS[BeamFlag.UNEVEN_TARGET]}, and "
                "sizes likewise; give frames without a beam (images.empty), or a reflectance_map",
                {"beams_count": int(uneven.sum())},
            )
        )
    skirts = np.array([one.skirt_share for one in beams.sizes])
    wide = ~refused & (skirts > _MUCH_SKIRT)
    if wide.any():
        doubts.append(
            Doubt(
                "beams_with_wide_skirts",
                f"{int(wide.sum())} beams have more than {_MUCH_SKIRT:.0%} of their light where it does not stand "
                f"out of the "
                "background: their sizes rest on how the skirts are continued (in the sigma); expose longer, or "
                "give frames "
                "without a beam",
                {"beams_count": int(wide.sum())},
                Severity.NOTE,
            )
        )
    return gather_doubts(result.photos.doubts, doubts)


def _sun_down(result: "Result") -> list[Doubt]:
    """Say where there are beams although the sun has set by the photos' times."""
    suns = result.photos.to_sun
    if len(suns) != len(result.beams.files):
        return []
    down = ~result.beams.rejected & (suns[:, 2] < 0)
    if not down.any():
        return []
    row = int(np.argmin(np.where(down, suns[:, 2], np.inf)))
    depth_deg = float(np.degrees(-np.arcsin(suns[row, 2])))
    return [
        Doubt(
            "beams_without_sun",
            f"{int(down.sum())} of {down.size} beams were photographed while the sun was below the horizon "
            f"({result.beams.files[row].name}: {depth_deg:.0f} degrees): are the times UTC, or the zone stated; is "
            "[site] right? Places and sizes on the target do not use the sun; `beam compare` and tests of tracking do",
            {"beams_count": int(down.sum()), "depth_rad": float(np.radians(depth_deg))},
            Severity.SERIOUS,
        )
    ]


def _gauge_dark(result: "Result") -> list[Doubt]:
    """Say which beams do not light the calorimeter that scales their flux."""
    dark = [
        file.name
        for file, bad, scale in zip(result.beams.files, result.beams.rejected, result.scales, strict=True)
        if not bad and not np.isfinite(scale.per_dn)
    ]
    if not dark:
        return []
    return [
        Doubt(
            "calorimeter_not_lit",
            f"{len(dark)} of {len(result.scales)} beams do not light the calorimeter ({dark[0]}): their flux is not "
            "known; aim at it, or give power_w",
            {"beams_count": len(dark)},
        )
    ]


def _light_falls_off(result: "Result") -> list[Doubt]:
    """Say where the light of an empty target falls towards the photo's corners, and what that does to the beams."""
    found = []
    beams = result.beams
    for target, fall in result.light_falls.items():
        if not fall.is_seen:
            continue
        mine = [
            row
            for row in np.flatnonzero(~beams.rejected).tolist()
            if beams.targets[row] == target and np.isfinite(beams.sizes[row].moments_m2).all()
        ]
        shifts = [fall.shift_m(np.array([beams.x_m[row], beams.y_m[row]]), beams.sizes[row].moments_m2) for row in mine]
        moved = max((float(np.hypot(*one)) for one in shifts), default=0.0)
        matters = any((np.abs(one) > beams.sigma_m[row]).any() for one, row in zip(shifts, mine, strict=True))
        if not matters and not result.by_calorimeter:
            continue  # summary.json has the number.
        corner, sigma = 100 * fall.per_radius2, 100 * fall.sigma_per_radius2
        found.append(
            Doubt(
                "light_falls_off",
                f"the light of target {target} without a beam falls towards the photo's corners ({corner:.0f} \u00b1 "
                f"{sigma:.1f} % there, {fall.over_target:.1%} over the target): vignetting of the lens, or daylight "
                f"that bends so. It moves centres by up to {1e3 * moved:.1f} mm"
                + (", more than their sigma: put the target into the middle of the photo" if matters else "")
                + (
                    "; flux is off by as much as light falls between calorimeter and beam"
                    if result.by_calorimeter
                    else ""
                ),
                {"fall_share": fall.per_radius2, "over_target_share": fall.over_target, "shift_m": moved},
                Severity.DOUBT if matters else Severity.NOTE,
            )
        )
    return found


def _labels_aside(result: "Result") -> list[Doubt]:
    """Say where labels stand aside of the beams by the same on a target: its stated place or theirs has moved."""
    said: list[str] = []
    farthest = 0.0
    used = ~result.beams.rejected & np.isfinite(result.offsets_m).all(axis=1)
    for target in dict.fromkeys(result.beams.targets):
        mine = used & np.array([name == target for name in result.beams.targets])
        if np.count_nonzero(mine) < _LEAST_LABELS:
            continue
        offsets = result.offsets_m[mine]
        middle = np.median(offsets, axis=0)
        # The scatter of a median of normal errors is 1.25 times that of a mean.
        sigma = 1.25 * 1.4826 * np.median(np.abs(offsets - middle), axis=0) / np.sqrt(len(offsets))
        away = float(np.hypot(*middle))
        if away > _ASIDE * float(np.hypot(*sigma)) and away > float(np.median(result.beams.sigma_m[mine])) * 2:
            farthest = max(farthest, away)
            said.append(f"{target} {-middle[0]:+.3f} m right, {-middle[1]:+.3f} m up in {len(offsets)} photos")
    if not said:
        return []
    return [
        Doubt(
            "labels_aside",
            f"labels stand up to {farthest:.3f} m aside of the beams, by the same in all photos of a target "
            f"({'; '.join(said)}): was the target's place or the labels' moved between two releases?",
            {"away_m": farthest, "targets_count": len(said)},
        )
    ]
