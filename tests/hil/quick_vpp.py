"""`vpp` with shorter waits before a run on the rig: `python -m tests.hil.quick_vpp hil run ...`."""

import sys

from hil.loop import rig
from hil.safety import polarity
from vpp_fmu.app.cli import main


def shorten_waits(put=setattr) -> None:
    """Shorten the polarity check, the rest before the tare, the tare and the wait at the first command."""
    for module, name, value in (
        (polarity, "SETTLE", 0.8),
        (polarity, "AVERAGE", 0.5),
        (rig, "REST", 0.3),
        (rig, "TARE_SAMPLES", 250),
        (rig, "SETTLE", 0.5),
    ):
        put(module, name, value)


if __name__ == "__main__":
    shorten_waits()
    sys.exit(main())
