"""The API of `import vpp_fmu as vpp`: the command's verbs as functions, on paths or on objects.

This is the uppermost layer: it calls the verbs' modules, and no other module imports it. `vpp_fmu.__getattr__` imports its
names at their first use.
"""
