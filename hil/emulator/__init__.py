"""An emulated rig at byte level: behind each bus the registers, frames and files that the real drivers access.

An emulated bus has two ends. The far end, in the process that runs the physics, is `serve(t)`: it emulates the device up to the
time t. The near end, in the process that runs the loop, is `attached`: it replaces the driver's system calls by an emulated
kernel. Both share one folder of small files, so they can be in one process under a virtual clock, or in two in real time.
Faults are injected by numbers in those files, named in `i2c.FAULTS` and `serial_line.FAULTS`, which any process may set; the
argument `refuse` of `pwm_tree.attached` selects writes to refuse.
"""
