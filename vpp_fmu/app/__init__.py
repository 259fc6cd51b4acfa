"""The top layer: command line, public API, reports, the study of the paper, and the day of a rig."""
