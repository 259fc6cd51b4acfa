"""Drivers of the rig's devices: ADC on I2C, tachometer on a serial line, pulse outputs. They do not depend on the emulator."""
