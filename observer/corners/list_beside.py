"""Whether the listed targets, all together, lie to the mirror as the list says: asked of the edges of the panels.

A list whose targets all stand too high, too far in x, or lean, agrees with itself: no target of it contradicts the
others. The mirror's edges do not belong to the list. Their offsets from the drawing over all photos, with what the list
leaves open of the poses and mounting leaves open of the panels as covariance, tell by generalised least squares (Aitken
1935) how the list as a whole stands beside the drawing. The focal length of the design, whose error lifts edges in
proportion to x^2, is estimated beside: else it would look like another height of the list.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray
from observer.doubts.by_chance import contradicting_sigmas

#: Unknowns of the list that are judged.
_N_UNKNOWNS = 3
#: No list is beside the mirror by so much, no focal length by this share; what edges do not tell stays that uncertain,
#: as where all that are seen lie in one line [m, rad].
_LARGEST = 1.0


class ListBeside(NamedTuple):
    """How the list stands beside the mirror as drawn: listed minus true places.

    value (3,): By how much all places are too far in x, too high [m]; by how much z rises too much with x, about the
        height of the rims [rad].
    sigma (3,): Standard deviations; infinite, or a metre or radian, where nothing is known.
    """

    value: FloatArray
    sigma: FloatArray

    def contradicting(self, n_modules: int = 1) -> FloatArray:
        """Return the numbers that are none of chance, zero for the others, shape (3,).

        n_modules: Modules that are judged alike.
        """
        limit = contradicting_sigmas(_N_UNKNOWNS * n_modules)
        return np.where(np.abs(self.value) > limit * self.sigma, self.value, 0.0)

    def since(self, before: FloatArray) -> "ListBeside":
        """Return the same of a list that was mended before.

        before (3,): By how much it was.
        """
        return ListBeside(before + self.value, self.sigma)


def list_steps(poses: Sequence[RigidTransform], rim_height_m: float) -> FloatArray:
    """Return the steps of poses in the list's frame to those in the mirror's, for one unit of what the list is beside.

    poses: ``cam_from_frame`` by the list.
    Returns (n, 6, 3): Steps of `RigidTransform.moved` [rad, m].
    """
    steps = np.zeros((len(poses), 6, _N_UNKNOWNS))
    for step, pose in zip(steps, poses, strict=True):
        across, along, up = pose.rotation.T
        # A place p is listed at p + a x (p - rim), with a = -y for z that rises with x.
        step[:3, 2], step[3:, 2] = -along, rim_height_m * across
        step[3:, 0], step[3:, 1] = across, up
    return steps


def list_beside(offset: FloatArray, by_unknown: FloatArray, by_list: FloatArray, by_focal: FloatArray) -> ListBeside:
    """Estimate how a list stands beside the mirror from edges in photos; all rows over their sigma.

    offset (m,): How far edges are beside where poses and drawing have them.
    by_unknown (m, q): What moves them besides, for unknowns of unit covariance.
    by_list (m, 3): What moves them if the list is beside the mirror [1/m, 1/m, 1/rad].
    by_focal (m,): What moves them if the focal length of the design is another one.
    """
    moved = np.column_stack([by_list, by_focal])
    inner = np.eye(by_unknown.shape[1]) + by_unknown.T @ by_unknown
    # The inverse of 1 + B B^T by that of 1 + B^T B (Woodbury).
    weighted = moved - by_unknown @ np.linalg.solve(inner, by_unknown.T @ moved)
    covariance = np.linalg.inv(moved.T @ weighted + np.eye(_N_UNKNOWNS + 1) / _LARGEST**2)
    value = covariance @ (weighted.T @ offset)
    return ListBeside(value[:_N_UNKNOWNS], np.sqrt(np.diag(covariance))[:_N_UNKNOWNS])
