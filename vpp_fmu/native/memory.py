"""Return memory of long records to the system, with glibc.

glibc allocates arrays of up to 32 MB from heaps, one per thread, which rarely shrink. Mapping each array separately would
double the time of a fit.
"""

import ctypes
import platform


def give_back() -> None:
    """Return unused memory."""
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).malloc_trim(0)
