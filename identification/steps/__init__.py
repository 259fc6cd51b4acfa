"""Step responses: dead time and two lags of each channel from single steps."""
