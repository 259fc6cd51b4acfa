"""What keeps a spinning propeller safe: states, limits, tare, plausibility, and a process that watches the loop."""
