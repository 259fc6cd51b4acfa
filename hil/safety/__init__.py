"""Safety of the spinning propeller: states, limits, tare, plausibility, and a process that monitors the loop."""
