"""The operator's page in a browser on this machine: the rig's state, and STOP. A separate process serves it."""
