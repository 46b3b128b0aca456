"""Figures and sections of the reports of troughs."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer.report.maps import theta_r_map as theta_r_map
    from observer.report.pictures import overlay_figure as overlay_figure
    from observer.report.results import open_trough as open_trough

__getattr__, __dir__, __all__ = lazy_face(__name__)
