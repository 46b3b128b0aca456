"""An adjustment that does not settle says what is usually wrong."""

import pytest

from heliogauge.errors import EstimationError
from observer.pipeline_camera import explained


def test_an_adjustment_that_does_not_settle_names_the_usual_causes() -> None:
    with pytest.raises(EstimationError, match=r"200 iterations.*rolling shutter.*zoom.*\[camera\] free"), explained():
        raise EstimationError("bundle adjustment: not converged after 200 iterations")
    with pytest.raises(EstimationError, match=r"^other$"), explained():
        raise EstimationError("other")
