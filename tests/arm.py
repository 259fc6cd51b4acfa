"""Run the C text of a native FMU on emulated 64-bit ARM, the processor of a Raspberry Pi."""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from vpp_fmu.export import toolchain
from vpp_fmu.export.c_text import c_text
from vpp_fmu.kernel.types import Model

LIBRARY = Path("/usr/aarch64-linux-gnu")

DRIVER = """
static void print_message(void *environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String text, ...) {
  fprintf(stderr, "%s\\n", text);
}

int main(void) {
  const fmi2CallbackFunctions functions = {print_message};
  fmi2Component c = fmi2Instantiate("a", fmi2CoSimulation, MODEL_GUID, NULL, &functions, 0, 0);
  fmi2ValueReference r[N_INPUTS + N_OUTPUTS];
  double u[N_INPUTS], y[N_OUTPUTS], dt;
  for (int i = 0; i < N_INPUTS + N_OUTPUTS; i++) r[i] = i;
  if (fread(&dt, sizeof dt, 1, stdin) != 1) return 1;
  for (int k = 0; fread(u, sizeof u, 1, stdin) == 1; k++) {
    if (k == 0) fmi2EnterInitializationMode(c);
    fmi2SetReal(c, r, N_INPUTS, u);
    if (k == 0) fmi2ExitInitializationMode(c);
    if (fmi2DoStep(c, k * dt, dt, 1)) return 2;
    fmi2GetReal(c, r + N_INPUTS, N_OUTPUTS, y);
    fwrite(y, sizeof y, 1, stdout);
  }
}
"""


def missing() -> str:
    """What this machine lacks to run it; empty if nothing."""
    if not find_spec("ziglang"):
        return "ziglang is not installed (the extra 'cross')"
    return "" if shutil.which("qemu-aarch64") and LIBRARY.exists() else "no qemu-aarch64 with its C library"


def outputs_on_arm(model: Model, values: Mapping[str, float], rows: np.ndarray, dt: float) -> np.ndarray:
    """Outputs (rows - 1, outputs) after each step of dt seconds under inputs (rows, inputs), each held for one step."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "arm.c").write_text(c_text(model, model.values(values), "{}") + DRIVER)
        target = toolchain.TARGETS["aarch64-linux"][0]
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *toolchain.FLAGS, "arm.c", "-o", "arm", "-lm"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        sent = np.array([dt]).tobytes() + np.ascontiguousarray(rows[:-1]).tobytes()
        command = ["qemu-aarch64", "-L", str(LIBRARY), "./arm"]
        done = subprocess.run(command, cwd=folder, check=True, capture_output=True, input=sent)
    return np.frombuffer(done.stdout).reshape(len(rows) - 1, len(model.outputs))
