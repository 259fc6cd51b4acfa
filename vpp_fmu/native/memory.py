"""What a long record needed goes back to the system, where the C library is glibc.

It cuts arrays of up to 32 MB from heaps, of which each thread has one, and a heap keeps nearly all that it ever held. To map
each array by itself instead would double the time of a fit.
"""

import ctypes
import platform


def give_back() -> None:
    """Return what no array holds any more."""
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).malloc_trim(0)
