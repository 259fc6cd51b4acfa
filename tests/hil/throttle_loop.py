"""A loop that holds the throttle open until its supervisor stops it: `python throttle_loop.py DUTY REPORT MODE`.

Prints "<supervisor's process> <fifo>" once it runs, and "faulted" once it has seen that it was stopped. MODE: "run"; "stop"
(stops itself between a beat and the write of the pulse); "fork" (leaves a child behind that holds all its files); "hurry" (in
real time, as a run is).
"""

import contextlib
import os
import signal
import sys
import time

from hil.devices.clock import MonotonicClock
from hil.loop.realtime import real_time
from hil.safety.supervisor import Supervisor

OPEN, IDLE = 1.5e-3, 1.0e-3
TICK = 0.004


def main(duty: str, report: str, mode: str) -> None:
    with real_time() if mode == "hurry" else contextlib.nullcontext() as granted:
        hold(Supervisor([(duty, IDLE)], report, lifted=granted.lifted if granted else ()), duty, mode)


def hold(supervisor: Supervisor, duty: str, mode: str) -> None:
    clock = MonotonicClock()
    output = os.open(duty, os.O_WRONLY)
    if mode == "fork" and os.fork() == 0:
        time.sleep(1.0)
        os._exit(0)
    start = clock.now()
    for tick in range(1, 5000):
        if supervisor.beat():
            break
        if tick == 25:
            print(supervisor.pid, int(supervisor.fifo), flush=True)
        if tick == 50 and mode == "stop":
            os.kill(os.getpid(), signal.SIGSTOP)
        os.pwrite(output, b"%d\n" % round(OPEN * 1e9), 0)
        clock.wait_until(start + tick * TICK)
    print("faulted", flush=True)
    os.read(0, 1)
    supervisor.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
