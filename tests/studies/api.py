"""What `import vpp_fmu` costs, and every public name of it: seconds of a fresh interpreter beyond those of an empty one."""

import argparse
import subprocess
import sys
import time

import vpp_fmu

AIM = 0.2
"""s for the import of the package; names are paid for when they are used."""


def seconds(code: str, times: int) -> float:
    """The least of several fresh interpreters."""
    return min(_once(code) for _ in range(times))


def _once(code: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began


def main(options: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies api", description=__doc__)
    parser.add_argument("--times", type=int, default=3, metavar="N", help="interpreters, of which the fastest counts")
    times = parser.parse_args(options).times
    nothing = seconds("pass", times)
    print(f"import vpp_fmu        {seconds('import vpp_fmu', times) - nothing:6.3f} s (aim: below {AIM:g} s)")
    for name in ("__version__", *vpp_fmu.__all__):
        print(f"vpp.{name:17} {seconds(f'import vpp_fmu; vpp_fmu.{name}', times) - nothing:6.3f} s")
