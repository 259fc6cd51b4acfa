"""The byte side of an emulated rig: behind each bus the registers, frames and files that the real driver code talks to.

An emulated bus has two ends. Behind it, in the process that runs the physics, `serve(t)` does what is due up to the time t.
In front of it, in the process that runs the loop, `attached` puts the emulated kernel where the driver makes its system
calls. Both ends meet in one folder of small files, so they may live in one process under a virtual clock, or in two in real
time. So do the faults that can be injected: numbers in those files, named in `i2c.FAULTS` and `serial_line.FAULTS`, that any
process may set; `pwm_tree.attached` takes the writes to refuse.
"""
