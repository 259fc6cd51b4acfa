"""Plan the next experiment: the most informative commands within a rig's ranges."""
