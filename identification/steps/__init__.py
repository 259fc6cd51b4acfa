"""Step responses: delay and two lags of each channel from single steps."""
