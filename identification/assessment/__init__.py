"""Accuracy of a fit: nonlinear intervals, tests of the residual, predictions and their bands."""
