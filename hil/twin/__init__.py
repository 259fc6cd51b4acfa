"""The twin that runs beside the rig: its band from an identification, its parameters, and one update per tick."""
