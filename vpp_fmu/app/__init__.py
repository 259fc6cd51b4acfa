"""The upper floor: command line, public API, the study of the paper, and the day of a rig."""
