"""A rig's day: model and controller improve each other, round by round, while the rig runs."""
