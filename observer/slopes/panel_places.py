"""How high the panels are by their own edges in the photos, known together with the poses of the cameras."""

from dataclasses import dataclass

from heliogauge.validate import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class PanelPlaces:
    """What the panels' edges say of p panels, together with n poses that they have moved already.

    The unknowns are the p mean heights over the design [m], then the p slopes along the trough by which the height
    of each panel changes about its middle.

    value (2 p,): The unknowns.
    covariance (2 p, 2 p): Their covariance.
    with_poses (2 p, 6 n): Their covariance with the steps of the poses (`RigidTransform.moved`).
    by_poses (2 p, 6 n): The same over the covariance of these steps: what errs with the poses, errs with the panels by
        its covariance with the steps times this.
    lean_sigma: Standard deviation that the slopes had before.
    """

    value: FloatArray
    covariance: FloatArray
    with_poses: FloatArray
    by_poses: FloatArray
    lean_sigma: float
