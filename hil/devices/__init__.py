"""The rig's devices as they are: ADC on I2C, tachometer on a serial line, pulse outputs. Nothing here knows of an emulator."""
