"""Figures and the report page."""

from vpp_fmu.report.curves import behind_against_before, reached_against_commanded, stacked
from vpp_fmu.report.evidence import evidence_bars
from vpp_fmu.report.fits import correlation_heatmap, learning_curve, parameter_change
from vpp_fmu.report.learned import learned_curve
from vpp_fmu.report.maps import map_lines, map_residuals, map_section
from vpp_fmu.report.page import Page
from vpp_fmu.report.records import closed_loop, measured_against_predicted, two_records
from vpp_fmu.report.remainders import correlations, overlap_heatmap, residual_by_move, residual_spectrum
from vpp_fmu.report.residuals import autocorrelation, cross_correlation, residual_by_section, residual_histogram
from vpp_fmu.report.thinning import thinning
from vpp_fmu.report.twin import adapted_parameters, residual_in_band

__all__ = [
    "Page",
    "adapted_parameters",
    "autocorrelation",
    "behind_against_before",
    "closed_loop",
    "correlation_heatmap",
    "correlations",
    "cross_correlation",
    "evidence_bars",
    "learned_curve",
    "learning_curve",
    "map_lines",
    "map_residuals",
    "map_section",
    "measured_against_predicted",
    "overlap_heatmap",
    "parameter_change",
    "reached_against_commanded",
    "residual_by_move",
    "residual_by_section",
    "residual_histogram",
    "residual_in_band",
    "residual_spectrum",
    "stacked",
    "thinning",
    "two_records",
]
