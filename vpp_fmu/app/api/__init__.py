"""The verbs as functions, on paths or on objects: `import vpp_fmu as vpp` has their names, and the command calls them.

Each decision on noise, step, rig and range is made here. `vpp_fmu.__getattr__` imports the names at their first use.
"""
