"""What stands above everything else: command line, public API, the paper's study, a rig's day."""
