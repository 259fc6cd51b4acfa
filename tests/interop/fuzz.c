/* Random sequences of calls on an FMU's source, legal or not: what may come of them is a status, never a crash.
 *
 * Compiled behind the FMU's one C file, with the sanitizers where there are any. Usage: fuzz SEED CALLS. */

#include <stdint.h>

static uint64_t state;

static unsigned below(unsigned n) {
  state = state * 6364136223846793005u + 1442695040888963407u;
  return (unsigned)(state >> 33) % n;
}

static long told;

static void log_message(void *environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String message, ...) {
  (void)environment, (void)status;
  told += (long)(strlen(name) + strlen(category) + strlen(message)); /* reads them all */
}

static double value(void) {
  static const double odd[] = {0.0, -1.0, 1e300, -1e-300, NAN, INFINITY, -INFINITY, 1e-5, 3.0, 5000.0};
  return below(3) ? below(6000) * 0.01 : odd[below(10)];
}

static double step_size(void) {
  static const double sizes[] = {0.004, 0.001, 0.0137, 0.05, 1e-9, 0.0, -0.004, NAN, INFINITY, 1e9};
  return sizes[below(below(4) ? 4 : 10)];
}

/* Most of the time where the instance is, else somewhere. */
static double when(fmi2Component c) { return c && below(8) ? ((Slave *)c)->time : value(); }

#define MANY 6
#define KEPT 4

int main(int count, char **arguments) {
  const fmi2CallbackFunctions heard = {log_message, NULL, NULL, NULL, NULL}, deaf = {0};
  fmi2Component instances[2] = {NULL, NULL};
  fmi2FMUstate kept[KEPT] = {NULL};
  fmi2Byte *bytes = NULL;
  size_t size = 0;
  long calls = count > 2 ? atol(arguments[2]) : 1000, good = 0, steps = 0;
  state = count > 1 ? (uint64_t)atol(arguments[1]) : 1;
  for (; calls; calls--) {
    fmi2Component *at = &instances[below(2)], c = *at;
    fmi2FMUstate *slot = &kept[below(KEPT)];
    fmi2ValueReference r[MANY], q[MANY];
    double x[MANY], y[MANY];
    fmi2Integer whole[MANY] = {0};
    const unsigned n = below(MANY + 1), p = below(MANY + 1);
    for (unsigned i = 0; i < MANY; i++) {
      r[i] = below(4) ? below(N_VALUES) : below(N_VALUES + 4);
      q[i] = below(4) ? below(N_INPUTS) : below(N_VALUES + 4);
      x[i] = value();
    }
    fmi2Status status = fmi2OK;
    switch (below(40)) {
      case 0:
        fmi2FreeInstance(c);
        *at = NULL;
        break;
      case 1: case 2:
        if (!c) *at = fmi2Instantiate(below(9) ? "a %s %n" : NULL, below(9) ? fmi2CoSimulation : fmi2ModelExchange,
                                      below(9) ? MODEL_GUID : NULL, NULL, below(3) ? &heard : below(2) ? &deaf : NULL, 0, 1);
        break;
      case 3: status = fmi2SetupExperiment(c, 0, 0.0, value(), 0, 0.0); break;
      case 4: case 5: status = fmi2EnterInitializationMode(c); break;
      case 6: case 7: status = fmi2ExitInitializationMode(c); break;
      case 8: if (!below(8)) status = fmi2Terminate(c); break;
      case 9: case 10: case 11: status = fmi2Reset(c); break;
      case 12: status = fmi2SetReal(c, r, n, x); break;
      case 13: status = fmi2SetReal(c, below(9) ? q : NULL, n, below(9) ? x : NULL); break;
      case 14: status = fmi2GetReal(c, r, n, below(9) ? y : NULL); break;
      case 15: status = below(2) ? fmi2GetInteger(c, r, below(2), whole) : fmi2GetBoolean(c, r, below(2), whole); break;
      case 16: status = below(2) ? fmi2SetBoolean(c, r, below(2), whole) : fmi2SetInteger(c, r, below(2), whole); break;
      case 17: status = fmi2GetDirectionalDerivative(c, r, n, q, p, x, y); break;
      case 18: status = fmi2GetDirectionalDerivative(c, q, n, r, p, x, below(9) ? y : NULL); break;
      case 19: status = fmi2GetFMUstate(c, below(9) ? slot : NULL); break;
      case 20: case 21: status = fmi2SetFMUstate(c, *slot); break;
      case 22: status = fmi2FreeFMUstate(c, below(9) ? slot : NULL); break;
      case 23:
        if (fmi2SerializedFMUstateSize(c, *slot, &size) == fmi2OK) {
          bytes = realloc(bytes, size);
          status = fmi2SerializeFMUstate(c, *slot, bytes, size - (below(9) ? 0 : 8));
        } else
          size = 0;
        break;
      case 24:
        if (size && !below(3)) bytes[below((unsigned)size)] ^= (fmi2Byte)(1 << below(8));
        if (bytes) status = fmi2DeSerializeFMUstate(c, bytes, below(9) ? size : below((unsigned)size + 1), slot);
        break;
      case 25:
        status = fmi2SetDebugLogging(c, (int)below(2), below(2), (fmi2String[]){below(4) ? "logStatusError" : below(2) ? "logAll" : "x"});
        break;
      case 26: status = fmi2SetRealInputDerivatives(c, r, below(2), whole, x); break;
      case 27: status = fmi2GetRealOutputDerivatives(c, r, below(2), whole, y); break;
      case 28: status = below(2) ? fmi2GetStatus(c, fmi2DoStepStatus, &status) : fmi2GetRealStatus(c, fmi2Terminated, y); break;
      case 29: if (!below(8)) status = fmi2CancelStep(c); break;
      case 30: case 31: /* an orderly start, else most of the time would be spent in the error state */
        if (fmi2Reset(c) != fmi2OK || fmi2EnterInitializationMode(c) != fmi2OK) break;
        r[0] = N_INPUTS, q[0] = FIRST_PARAMETER;
        if (below(2)) fmi2GetDirectionalDerivative(c, r, 1, q, 1, x, y);
        fmi2ExitInitializationMode(c);
        for (unsigned i = 0; i < 50; i++) {
          fmi2SetReal(c, (fmi2ValueReference[]){below(N_INPUTS)}, 1, (double[]){below(6000) * 1.0});
          steps += fmi2DoStep(c, ((Slave *)c)->time, 0.001 * (1 + below(9)), 1) == fmi2OK;
        }
        break;
      default:
        if (below(2)) fmi2SetReal(c, (fmi2ValueReference[]){below(N_INPUTS)}, 1, (double[]){below(6000) * 1.0});
        status = fmi2DoStep(c, when(c), step_size(), 1);
    }
    good += status == fmi2OK;
  }
  for (int i = 0; i < KEPT; i++) free(kept[i]);
  for (int i = 0; i < 2; i++) fmi2FreeInstance(instances[i]);
  free(bytes);
  printf("%ld calls carried out, %ld orderly steps, %ld characters told\n", good, steps, told);
  return 0;
}
