"""What the edges of the panels say of the list of targets as a whole, in words."""

from math import isfinite

from heliogauge.doubts import Doubt, Severity
from observer.corners.list_beside import ListBeside


def list_doubt(listed: ListBeside, moved_rad: float, usual_sigma_rad: float, n_modules: int = 1) -> Doubt | None:
    """Say that the list of targets does not lie to the mirror as it says.

    moved_rad: By how much slopes are others with the list put right, RMS; NaN where they cannot be compared [rad].
    usual_sigma_rad: Usual sigma of a slope [rad].
    n_modules: Modules of the flight, each of which is asked.
    Returns: None where the edges do not contradict the list.
    """
    aside, up, lean = (1e3 * listed.contradicting(n_modules)).tolist()
    of_aside, of_up, of_lean = (1e3 * listed.sigma).tolist()
    said = []
    if up:
        said.append(f"{abs(up):.1f} +- {of_up:.1f} mm too {'high (z)' if up > 0 else 'low (z)'}")
    if aside:
        said.append(f"{abs(aside):.1f} +- {of_aside:.1f} mm too far towards {'+x' if aside > 0 else '-x'}")
    if lean:
        said.append(f"leaning by {abs(lean):.2f} +- {of_lean:.2f} mrad, too high at {'+x' if lean > 0 else '-x'}")
    if not said:
        return None
    numbers = {"aside_m": float(listed.value[0]), "up_m": float(listed.value[1]), "lean_rad": float(listed.value[2])}
    effect = "put right, too little of the reflection is seen to say by how much slopes change"
    if isfinite(moved_rad):
        numbers["slopes_moved_rad"] = moved_rad
        effect = (
            f"put right, slopes change by {1e3 * moved_rad:.2g} mrad RMS (their sigma is {1e3 * usual_sigma_rad:.2g})"
        )
    return Doubt(
        "list_beside_mirror",
        f"targets.file: by the panels' edges in the photos the whole list lies {' and '.join(said)}; {effect}. Was it "
        "measured to the top of plates or marks, or from another origin than the mirror's vertex? Mend x_m and z_m of "
        "all its entries; if they are right, see whether collector.panel_edges_x_m and focal_length_m are, and the "
        "camera's focal length, which targets in one plane seen from above hardly show",
        numbers,
        Severity.DOUBT if moved_rad <= usual_sigma_rad else Severity.SERIOUS,
    )
