"""The operator's page: what the rig does, in a browser on this machine, and STOP. A process of its own serves it."""
