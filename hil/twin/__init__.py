"""Compare the rig with the plant model at run time: residual, its expected band, and change detection."""
