"""The stages of a deflectometric measurement, in a row in `measure`."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.keys import DeflectometryMeasurement as DeflectometryMeasurement
    from deflectometry.pipeline.choices import Choices as Choices
    from deflectometry.pipeline.evaluate import Evaluation as Evaluation
    from deflectometry.pipeline.evaluate import evaluate_source as evaluate_source
    from deflectometry.pipeline.inputs import build_setup as build_setup
    from deflectometry.pipeline.inputs import describe_mirror as describe_mirror
    from deflectometry.pose.find_pose import MirrorInput as MirrorInput
    from deflectometry.shape.assemble import assemble_maps as assemble_maps
    from deflectometry.shape.smooth_shape import Align as Align

__getattr__, __dir__, __all__ = lazy_face(__name__)
