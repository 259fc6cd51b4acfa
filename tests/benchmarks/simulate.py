"""python -m tests.benchmarks.simulate [--against CHECKOUT]: nanoseconds a row and run of a compiled model.

Records of even rows of 4 and of 25 ms, of rows of two lengths, and of uneven rows of 17 to 33 ms: by a clock of 0.1 ms, and of
1 ns, by which all rows differ. Effects with a largest step cut long rows into pieces: compare uneven rows with those of 25 ms.
One run, 8 and 64 runs side by side, and one run with sensitivities in four lags. Models: the base, and five with an effect.
The limit: four lags and the map in plain C whose constants are known. `--against`: another checkout runs the same in turn.
"""

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.native import Simulator

HERE = Path(__file__).resolve().parents[2]
MODELS = ("", "pitch_stop_band", "speed_command_resolution", "speed_dependent_lag", "inflow_lag", "pitch_rate_limit")
LAGS = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2")
REPEATS = 5
LIMIT = """
void run(const double *in, long n, const double *c, const double *p, double *out) {
  double w2 = in[0], w = in[0], b2 = in[1], b = in[1];
  for (long k = 0; k < n; k++) {
    w += c[0] * (w2 - w) + c[1] * (in[2 * k] - w2), w2 += c[2] * (in[2 * k] - w2);
    b += c[3] * (b2 - b) + c[4] * (in[2 * k + 1] - b2), b2 += c[5] * (in[2 * k + 1] - b2);
    out[3 * k] = w * (w * (p[0] + p[1] * b + p[2] * w) + b * (p[3] + p[4] * b)), out[3 * k + 1] = w, out[3 * k + 2] = b;
  }
}
"""


def records() -> dict[str, tuple[dict[str, np.ndarray], np.ndarray]]:
    """(commands, steps [s]) of each kind of record."""
    rng, found = np.random.default_rng(0), {}
    uneven = rng.uniform(0.017, 0.033, 5999)
    kinds = {"4 ms": np.full(22499, 0.004), "two": np.where(np.arange(22499) % 2, 0.004, 0.003)}
    kinds |= {"25 ms": np.full(5999, 0.025), "0.1 ms": np.round(uneven, 4), "1 ns": np.round(uneven, 9)}
    for name, steps in kinds.items():
        held = np.arange(len(steps) + 1) // 50
        commands = {
            "omega_ref": rng.uniform(3000.0, 6000.0, held[-1] + 1)[held],
            "beta_ref": rng.uniform(0.0, 10.0, held[-1] + 1)[held],
        }
        found[name] = commands, steps
    return found


def least(work: Callable[[], object]) -> float:
    """s: the shortest of several runs, after one that is not counted."""
    work()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def costs() -> Iterator[tuple[str, str, list[float]]]:
    """(model, record, [ns a row and run: one, 8, 64, with sensitivities])."""
    for name in MODELS:
        model = plant([name] if name else [], LIBRARY)
        values = model.values({e.full(n): v for e in model.effects if e.name == name for n, v in e.probe.items()})
        points = [{**values, "tau_beta_1": 0.2 + 0.001 * k} for k in range(64)]
        simulator, sensitive = Simulator(model), Simulator(model, LAGS)
        for kind, run in records().items():
            rows = len(run[1]) + 1
            own = [
                least(lambda: simulator.simulate(values, *run)),  # noqa: B023
                *(least(lambda: simulator.simulate_all(points[:n], *run)) / n for n in (8, 64)),  # noqa: B023
                least(lambda: sensitive.sensitivities(values, *run)),  # noqa: B023
            ]
            yield name or "base", kind, [1e9 * seconds / rows for seconds in own]


def limit() -> float:
    """ns a row of the base in plain C, its constants known."""
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "limit.c"), Path(folder, "limit.so")
        source.write_text(LIMIT)
        subprocess.run(["cc", "-O2", "-ffp-contract=off", "-shared", "-fPIC", "-o", library, source], check=True)
        run = ctypes.CDLL(str(library)).run
        commands, _ = records()["4 ms"]
        inputs, out = np.column_stack([*commands.values()]), np.empty((22500, 3))
        c, p = np.full(6, 0.02), np.full(5, 0.1)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (inputs, c, p, out)]
        return 1e9 / 22500 * least(lambda: run(pointers[0], ctypes.c_long(22500), *pointers[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, metavar="CHECKOUT")
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    now = list(costs())
    if options.json:
        print(json.dumps(now))
        return
    before: dict = {}
    if options.against:
        command = [sys.executable, str(Path(__file__).resolve()), "--json"]
        environment = {**os.environ, "PYTHONPATH": str(options.against.resolve())}
        text = subprocess.run(command, env=environment, cwd=options.against, check=True, capture_output=True, text=True).stdout
        before = {(model, kind): own for model, kind, own in json.loads(text)}
    print(f"the limit: {limit():.0f} ns a row in plain C\n")
    print(f"{'ns a row and run':26} {'rows':7} {'one':>12} {'8 runs':>12} {'64 runs':>12} {'sensitivities':>14}")
    for model, kind, own in now:
        was = before.get((model, kind), own)
        cells = [f"{a:.0f} -> {b:.0f}" if before else f"{b:.0f}" for a, b in zip(was, own, strict=True)]
        print(f"{model:26} {kind:7} {cells[0]:>12} {cells[1]:>12} {cells[2]:>12} {cells[3]:>14}")


if __name__ == "__main__":
    main()
