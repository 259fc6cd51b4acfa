"""What `import vpp_fmu as vpp` offers: the command's verbs as functions, on paths or on objects.

This is the uppermost layer: it calls the verbs' own modules, and nothing of the house imports it. `vpp_fmu.__getattr__` brings
its names when they are first used.
"""
