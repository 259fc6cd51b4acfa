"""The static map: means of steady holds, the terms of the polynomial, and its uncertainty."""
