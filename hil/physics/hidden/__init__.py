"""Optional effects of a rig beyond the paper's equations. They are written independently of the diagnosis' effects
(`vpp_fmu.kernel.effects`), so that the diagnosis can be tested on them. Some are in no library at all."""
