"""The loop with the rig: time, sensors, one tick, its log, and the session around it."""
