"""The sun by a second route: Grena, Solar Energy 82 (2008) 462-470, valid 2003 to 2022, to 0.0027 degree."""

import numpy as np


def grena_2008(times, latitude_deg, longitude_deg, pressure_atm, temperature_c):
    """Return azimuth (0 = north, clockwise), elevation and apparent elevation [rad] of UTC datetime64 instants.

    The paper's seven-parameter form with TT - UT from 2003 to 2022 taken as 67 s (64.5 to 69.4 s: 0.0001 degree).
    """
    seconds = (np.asarray(times) - np.datetime64("2003-01-01T00:00")).astype("timedelta64[ms]").astype(float) / 1e3
    # int(365.25 (y - 2000)) + int(30.6001 (m + 1)) + day + UT/24 - 1158.5 with y = 2002, m = 13, day = 1 is 0.5.
    t = seconds / 86400 + 0.5
    te = t + 67.0 / 86400
    k = te / 1000
    s = 1.72019e-2 * te - 0.0563
    heliocentric = (
        1.740940 + 1.7202768683e-2 * te + 3.34118e-2 * np.sin(s) + 3.488e-4 * np.sin(2 * s)
        + 3.13e-5 * np.sin(0.2127730 * te - 0.585) + 1.26e-5 * np.sin(4.243e-3 * te + 1.46)
        + 2.35e-5 * np.sin(1.0727e-2 * te + 0.72) + 2.76e-5 * np.sin(1.5799e-2 * te + 2.35)
        + 2.75e-5 * np.sin(2.1551e-2 * te - 1.98) + 1.26e-5 * np.sin(3.1490e-2 * te - 0.80)
        + (((-2.30796e-7 * k + 3.7976e-6) * k - 2.0458e-5) * k + 3.976e-5) * k**2
    )  # fmt: skip
    nutation = 8.33e-5 * np.sin(9.252e-4 * te - 1.173)
    obliquity = -6.21e-9 * te + 0.409086 + 4.46e-5 * np.sin(9.252e-4 * te + 0.397)
    lam = heliocentric + np.pi + nutation - 9.932e-5
    ascension = np.arctan2(np.sin(lam) * np.cos(obliquity), np.cos(lam))
    declination = np.arcsin(np.sin(obliquity) * np.sin(lam))
    latitude = np.deg2rad(latitude_deg)
    hour = 6.30038809903 * t + 4.8824623 + 0.9174 * nutation + np.deg2rad(longitude_deg) - ascension
    shift = -4.26e-5 * np.cos(latitude) * np.sin(hour)
    declination_here = declination - 4.26e-5 * (np.sin(latitude) - declination * np.cos(latitude))
    cosine, sine = np.cos(hour) + shift * np.sin(hour), np.sin(hour) - shift * np.cos(hour)
    elevation = np.arcsin(
        np.sin(latitude) * np.sin(declination_here) + np.cos(latitude) * np.cos(declination_here) * cosine
    )
    azimuth = np.pi + np.arctan2(sine, cosine * np.sin(latitude) - np.tan(declination_here) * np.cos(latitude))
    bending = 0.084217 * pressure_atm / ((273 + temperature_c) * np.tan(elevation + 0.0031376 / (elevation + 0.089186)))
    return azimuth, elevation, elevation + np.where(elevation > -0.01, bending, 0.0)
