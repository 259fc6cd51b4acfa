"""Figures and the report page."""

from vpp_fmu.report.fits import correlation_heatmap, learning_curve, parameter_change
from vpp_fmu.report.maps import map_residuals, map_surface
from vpp_fmu.report.page import Page
from vpp_fmu.report.records import closed_loop, measured_against_predicted, two_records
from vpp_fmu.report.residuals import autocorrelation, cross_correlation, residual_by_section, residual_histogram
from vpp_fmu.report.thinning import thinning

__all__ = [
    "Page",
    "autocorrelation",
    "closed_loop",
    "correlation_heatmap",
    "cross_correlation",
    "learning_curve",
    "map_residuals",
    "map_surface",
    "measured_against_predicted",
    "parameter_change",
    "residual_by_section",
    "residual_histogram",
    "thinning",
    "two_records",
]
