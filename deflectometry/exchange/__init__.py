"""Measurements of other programs become measurement folders."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry.exchange.opencsp_import import OpencspOptions as OpencspOptions
    from deflectometry.exchange.opencsp_import import SetupSigmas as SetupSigmas
    from deflectometry.exchange.opencsp_import import import_opencsp as import_opencsp

__getattr__, __dir__, __all__ = lazy_face(__name__)
