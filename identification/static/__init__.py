"""The static map: means of steady stretches, the terms of the polynomial, what of it is sure."""
