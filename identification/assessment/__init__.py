"""What the numbers are worth: intervals beyond the linear ones, tests of the residual, predictions and their bands."""
