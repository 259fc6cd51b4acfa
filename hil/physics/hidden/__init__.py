"""What a rig may do beyond the paper's equations, each by option: written for the physical model, apart from the effects that
the diagnosis knows (`vpp_fmu.kernel.effects`), so that the one can be tried on the other. Some are in no library at all."""
