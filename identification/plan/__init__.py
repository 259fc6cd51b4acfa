"""The next experiment: commands that tell most about a model, within a rig's ranges."""
