/* Random sequences of calls on an FMU's source, legal or not. Each must return a status, and a message if the call is refused;
 * a crash, a leak, an endless loop and a NaN are errors.
 *
 * Compiled after the FMU's C file with -DVERSION=2 or 3, with the sanitizers where they are available.
 * Usage: fuzz SEED CALLS. */

#include <stdint.h>

static uint64_t seed;

static unsigned below(unsigned n) {
  seed = seed * 6364136223846793005u + 1442695040888963407u;
  return n ? (unsigned)(seed >> 33) % n : 0; /* a model may have no inputs */
}

/* A pointer, now and then a null pointer. */
static void *maybe(const void *pointer) { return below(9) ? (void *)pointer : NULL; }

static double value(void) {
  static const double odd[] = {0.0, -1.0, 1e300, -1e-300, NAN, INFINITY, -INFINITY, 1e-5, 3.0, 5000.0};
  return below(3) ? below(6000) * 0.01 : odd[below(10)];
}

static double step_size(void) {
  static const double sizes[] = {0.004, 0.001, 0.0137, 0.05, 1e-9, 0.0, -0.004, NAN, INFINITY, 1e9};
  return sizes[below(below(4) ? 4 : 10)];
}

static long messages, characters;

static void hear(const char *category, const char *text) {
  messages++;
  characters += (long)(strlen(category) + strlen(text)); /* reads them all */
}

/* A copy in a block of exactly its size, so that the sanitizer detects accesses beyond it. */
static void *copied(const void *values, size_t bytes) {
  void *block = values ? malloc(bytes) : NULL;
  return block ? memcpy(block, values, bytes) : NULL;
}

#define MANY 6

#define EXCHANGE(name, call, type)                                                                                            \
  static int name(void *c, const unsigned *r, size_t n, const type *x) {                                                      \
    void *values = copied(x, n * sizeof *x);                                                                                  \
    const int status = call(c, r, n, COUNTED(values, n));                                                                     \
    free(values);                                                                                                             \
    return status;                                                                                                            \
  }

/* Calls whose names or arguments differ between the versions. Each function is one call. */

#if VERSION == 2

#define CALL(name) fmi2##name
#define STATE(before, after) fmi2##before##FMUstate##after
#define FROM_BYTES fmi2DeSerializeFMUstate
#define COUNTED(values, n) values

static void log_message(void *environment, fmi2String name, fmi2Status status, fmi2String category, fmi2String format, ...) {
  char text[2 * MESSAGE];
  va_list none;
  (void)environment, (void)name, (void)status;
  va_start(none, format);
  vsnprintf(text, sizeof text, format, none);
  va_end(none);
  hear(category, text);
}

static void *instance(void) {
  static const fmi2CallbackFunctions heard = {log_message, NULL, NULL, NULL, NULL}, deaf = {0};
  return fmi2Instantiate(maybe("a %s %n"), below(9) ? fmi2CoSimulation : fmi2ModelExchange, maybe(MODEL_GUID), NULL,
                         below(3) ? &heard : below(2) ? &deaf : NULL, 0, 1);
}

static int enter_at(void *c, double time) {
  (void)time; /* SetupExperiment sets it */
  return fmi2EnterInitializationMode(c);
}

static int go_on(void *c, double time, double size) { return fmi2DoStep(c, time, size, 1); }

EXCHANGE(write_reals, fmi2SetReal, double)
EXCHANGE(read_reals, fmi2GetReal, double)
EXCHANGE(write_integers, fmi2SetInteger, int)
EXCHANGE(read_integers, fmi2GetInteger, int)
EXCHANGE(write_booleans, fmi2SetBoolean, fmi2Boolean)
EXCHANGE(read_booleans, fmi2GetBoolean, fmi2Boolean)

/* Calls of this version only. */
static int special(void *c, const unsigned *r, size_t n, double *x) {
  const int kind = (int)below(5), order[MANY] = {1};
  int whole;
  const char *text[MANY] = {NULL};
  fmi2Status status;
  switch (below(12)) {
    case 0: case 1: case 2: return fmi2SetupExperiment(c, below(2), value(), value(), below(2), value());
    case 3: return fmi2SetRealInputDerivatives(c, r, n, order, maybe(x));
    case 4: return fmi2GetRealOutputDerivatives(c, r, n, order, maybe(x));
    case 5: return fmi2GetStatus(c, kind, maybe(&status));
    case 6: return fmi2GetRealStatus(c, kind, maybe(x));
    case 7: return fmi2GetIntegerStatus(c, kind, maybe(&whole));
    case 8: return fmi2GetBooleanStatus(c, kind, maybe(&whole));
    case 9: return fmi2GetStringStatus(c, kind, maybe(text));
    case 10: return below(2) ? fmi2GetString(c, r, n, text) : fmi2SetString(c, r, n, text);
    default: return fmi2CancelStep(c);
  }
}

#else

#define CALL(name) fmi3##name
#define STATE(before, after) fmi3##before##FMUState##after
#define FROM_BYTES fmi3DeserializeFMUState
#define COUNTED(values, n) values, n

static void log_message(void *environment, fmi3Status status, fmi3String category, fmi3String message) {
  (void)environment, (void)status;
  hear(category, message);
}

static void *instance(void) {
  const char *name = maybe("a %s %n"), *token = maybe(MODEL_GUID);
  Logger logger = below(3) ? log_message : NULL;
  const unsigned required[] = {N_INPUTS};
  switch (below(18)) {
    case 0: return fmi3InstantiateModelExchange(name, token, NULL, 0, 1, NULL, logger);
    case 1: return fmi3InstantiateScheduledExecution(name, token, NULL, 0, 1, NULL, logger, NULL, NULL, NULL);
    default:
      return fmi3InstantiateCoSimulation(name, token, NULL, 0, 1, below(2), below(2), required, !below(18), NULL, logger,
                                         NULL);
  }
}

static int enter_at(void *c, double time) {
  return fmi3EnterInitializationMode(c, below(2), value(), time, below(2), value());
}

static int go_on(void *c, double time, double size) {
  bool event, end, early;
  double reached;
  return fmi3DoStep(c, time, size, below(2), maybe(&event), maybe(&end), maybe(&early), maybe(&reached));
}

EXCHANGE(write_reals, fmi3SetFloat64, double)
EXCHANGE(read_reals, fmi3GetFloat64, double)
EXCHANGE(write_integers, fmi3SetInt32, int32_t)
EXCHANGE(read_integers, fmi3GetInt32, int32_t)
EXCHANGE(write_booleans, fmi3SetBoolean, bool)
EXCHANGE(read_booleans, fmi3GetBoolean, bool)

/* Calls with `n` references and a random number of values. */
static int miscounted(void *c, const unsigned *r, size_t n, const double *x) {
  const size_t there = below(MANY + 1);
  double *values = copied(x, there * sizeof *x);
  int status;
  switch (below(4)) {
    case 0: status = fmi3SetFloat64(c, r, n, values, there); break;
    case 1: status = fmi3GetFloat64(c, r, n, values, there); break;
    case 2: status = fmi3GetDirectionalDerivative(c, r, 0, r, n, values, there, NULL, 0); break;
    default: status = fmi3GetDirectionalDerivative(c, r, n, r, 0, NULL, 0, values, there);
  }
  free(values);
  return status;
}

/* Types that no variable has, and functions for other kinds of FMU. */
static int special(void *c, const unsigned *r, size_t n, double *x) {
  union {
    float float32[MANY];
    int8_t int8[MANY];
    uint8_t uint8[MANY];
    int16_t int16[MANY];
    uint16_t uint16[MANY];
    uint32_t uint32[MANY];
    int64_t int64[MANY];
    uint64_t uint64[MANY];
    const char *text[MANY];
    const uint8_t *binary[MANY];
    bool truth[MANY];
  } v = {{0}};
  size_t sizes[MANY] = {0};
  uint64_t counter[MANY] = {1}, resolution[MANY] = {1};
  fmi3DependencyKind kinds[MANY];
  fmi3IntervalQualifier qualifiers[MANY];
  const int32_t order[MANY] = {1};
  const bool sets = below(2);
  bool *truth = maybe(v.truth);
  double *reals = maybe(x);
#define OF_TYPE(kind, values) (sets ? fmi3Set##kind(c, r, n, maybe(values), n) : fmi3Get##kind(c, r, n, maybe(values), n))
  switch (below(39)) {
    case 0: return OF_TYPE(Float32, v.float32);
    case 1: return OF_TYPE(Int8, v.int8);
    case 2: return OF_TYPE(UInt8, v.uint8);
    case 3: return OF_TYPE(Int16, v.int16);
    case 4: return OF_TYPE(UInt16, v.uint16);
    case 5: return OF_TYPE(UInt32, v.uint32);
    case 6: return OF_TYPE(Int64, v.int64);
    case 7: return OF_TYPE(UInt64, v.uint64);
    case 8: return OF_TYPE(String, v.text);
    case 9: return sets ? fmi3SetBinary(c, r, n, sizes, v.binary, n) : fmi3GetBinary(c, r, n, maybe(sizes), v.binary, n);
    case 10: return sets ? fmi3SetClock(c, r, n, truth) : fmi3GetClock(c, r, n, truth);
    case 11: return fmi3EnterEventMode(c);
    case 12: return fmi3EnterStepMode(c);
    case 13: return fmi3EnterConfigurationMode(c);
    case 14: return fmi3ExitConfigurationMode(c);
    case 15: return fmi3EnterContinuousTimeMode(c);
    case 16: return fmi3EvaluateDiscreteStates(c);
    case 17: return fmi3SetTime(c, value());
    case 18: return fmi3GetNumberOfEventIndicators(c, maybe(sizes));
    case 19: return fmi3GetNumberOfContinuousStates(c, maybe(sizes));
    case 20: return fmi3GetNumberOfVariableDependencies(c, r[0], maybe(sizes));
    case 21: return sets ? fmi3SetContinuousStates(c, reals, n) : fmi3GetContinuousStates(c, reals, n);
    case 22: return fmi3GetContinuousStateDerivatives(c, reals, n);
    case 23: return fmi3GetEventIndicators(c, reals, n);
    case 24: return fmi3GetNominalsOfContinuousStates(c, reals, n);
    case 25: return fmi3ActivateModelPartition(c, r[0], value());
    case 26: return fmi3CompletedIntegratorStep(c, below(2), truth, truth);
    case 27: return sets ? fmi3SetShiftDecimal(c, r, n, reals) : fmi3GetShiftDecimal(c, r, n, reals);
    case 28: return sets ? fmi3SetIntervalDecimal(c, r, n, reals) : fmi3GetIntervalDecimal(c, r, n, reals, qualifiers);
    case 29:
      return sets ? fmi3SetShiftFraction(c, r, n, counter, resolution) : fmi3GetShiftFraction(c, r, n, counter, resolution);
    case 30:
      return sets ? fmi3SetIntervalFraction(c, r, n, counter, resolution)
                  : fmi3GetIntervalFraction(c, r, n, counter, resolution, qualifiers);
    case 31: return fmi3GetOutputDerivatives(c, r, n, order, reals, n);
    case 32: return fmi3GetVariableDependencies(c, r[0], sizes, v.uint32, sizes, kinds, n);
    case 33: return fmi3UpdateDiscreteStates(c, truth, truth, truth, truth, truth, reals);
    case 34: return fmi3GetAdjointDerivative(c, r, n, r, n, reals, n, reals, n);
    default: return miscounted(c, r, n, x);
  }
}

#endif

static int derivatives(void *c, const unsigned *r, size_t n, const unsigned *q, size_t p, const double *x, const double *y) {
  double *moved = copied(x, p * sizeof *x), *found = copied(y, n * sizeof *y);
  const int status = CALL(GetDirectionalDerivative)(c, r, n, q, p, COUNTED(moved, p), COUNTED(found, n));
  free(moved), free(found);
  return status;
}

static void *instances[2];
static void *kept[4]; /* saved states */
static char *bytes;   /* a serialised one, of `size` */
static size_t size;
static long steps;

/* Mostly the instance's time, else a random one. */
static double when(const Slave *c) { return c && below(8) ? c->time : value(); }

static int drive(void *c) {
  const unsigned r = below(N_INPUTS);
  if (TYPES[r] == REAL) return write_reals(c, &r, 1, (double[]){below(200) ? below(6000) * 1.0 : 1e300});
  if (TYPES[r] == INTEGER) return write_integers(c, &r, 1, (int[]){(int)below(9)});
  return write_booleans(c, &r, 1, (CALL(Boolean)[]){below(2)});
}

static int advance(void *c, double time, double span) {
  const int status = go_on(c, time, span);
  if (status == OK)
    for (int i = N_INPUTS; i < FIRST_PARAMETER; i++)
      if (!is_finite(((Slave *)c)->m.v[i])) return -1;
  return status;
}

/* A legal start and some steps, since random calls mostly end in the error state. */
static int orderly(void *c) {
  int status = CALL(Reset)(c);
  if (status == OK) status = enter_at(c, 0.0);
  if (status == OK && N_PARAMETERS && !below(8)) { /* then the steps carry the tangents of all parameters, which is slow */
    const unsigned output = N_INPUTS, parameter = FIRST_PARAMETER;
    status = derivatives(c, &output, 1, &parameter, 1, (double[]){1.0}, (double[]){0.0});
  }
  if (status == OK) status = CALL(ExitInitializationMode)(c);
  for (unsigned i = 0; i < 50 && status == OK; i++) {
    status = drive(c);
    if (status == OK) status = advance(c, ((Slave *)c)->time, 0.001 * (1 + below(9)));
    steps += status == OK;
  }
  return status;
}

/* One random call, and its status. */
static int attempt(void **at) {
  void *c = *at, **slot = &kept[below(sizeof kept / sizeof *kept)];
  unsigned r[MANY], q[MANY];
  double x[MANY], y[MANY] = {0};
  int whole[MANY] = {0};
  CALL(Boolean) truth[MANY] = {0};
  const unsigned n = below(MANY + 1), p = below(MANY + 1);
  for (unsigned i = 0; i < MANY; i++) {
    r[i] = below(4) ? below(N_VALUES) : below(N_VALUES + 4);
    q[i] = below(4) ? below(N_INPUTS) : below(N_VALUES + 4);
    x[i] = value();
    truth[i] = below(2);
  }
  switch (below(40)) {
    case 0:
      CALL(FreeInstance)(c);
      *at = NULL;
      return OK;
    case 1: case 2:
      if (!c) *at = instance();
      return OK;
    case 3: case 4: return enter_at(c, value());
    case 5: return enter_at(c, 0.0);
    case 6: case 7: return CALL(ExitInitializationMode)(c);
    case 8: return below(8) ? OK : CALL(Terminate)(c);
    case 9: case 10: return CALL(Reset)(c);
    case 11: return write_reals(c, r, n, x);
    case 12: return write_reals(c, maybe(q), n, maybe(x));
    case 13: case 14: return read_reals(c, r, n, maybe(y));
    case 15: return below(2) ? read_integers(c, r, below(2), maybe(whole)) : read_booleans(c, r, below(2), maybe(truth));
    case 16: return below(2) ? write_integers(c, r, below(2), maybe(whole)) : write_booleans(c, r, below(2), maybe(truth));
    case 17: return derivatives(c, r, n, q, p, x, y);
    case 18: return derivatives(c, q, n, r, p, x, maybe(y));
    case 19: return STATE(Get, )(c, maybe(slot));
    case 20: case 21: return STATE(Set, )(c, *slot);
    case 22: return STATE(Free, )(c, maybe(slot));
    case 23: {
      size_t needed;
      const int status = STATE(Serialized, Size)(c, *slot, &needed);
      if (status != OK) return status;
      bytes = realloc(bytes, size = needed);
      return STATE(Serialize, )(c, *slot, (void *)bytes, size - (below(9) ? 0 : 8));
    }
    case 24:
      if (size && !below(3)) bytes[below((unsigned)size)] ^= (char)(1 << below(8));
      return FROM_BYTES(c, maybe(bytes), below(9) ? size : below((unsigned)size + 1), maybe(slot));
    case 25: {
      const char *category = below(4) ? "logStatusError" : maybe(below(2) ? "logAll" : "%n%s%n%s");
      return CALL(SetDebugLogging)(c, below(2), below(2), &category);
    }
    case 26: case 27: case 28: return below(3) ? OK : special(c, r, n, x);
    case 29: case 30: return orderly(c);
    default:
      if (c && below(2)) drive(c);
      return advance(c, when(c), step_size());
  }
}

static bool hears(const Slave *c) { return c && c->logger && c->tells[ERROR]; }

int main(int count, char **arguments) {
  const long calls = count > 2 ? atol(arguments[2]) : 1000;
  long good = 0;
  seed = count > 1 ? (uint64_t)atol(arguments[1]) : 1;
  for (long i = 0; i < calls; i++) {
    void **at = &instances[below(2)];
    const bool heard = hears(*at);
    const long before = messages;
    const int status = attempt(at);
    if (status < OK || status > REFUSED || (status == REFUSED && heard && hears(*at) && messages == before)) {
      fprintf(stderr, "call %ld: status %d, %ld messages\n", i, status, messages - before);
      return 1;
    }
    good += status == OK;
  }
  for (size_t i = 0; i < sizeof kept / sizeof *kept; i++) free(kept[i]);
  for (size_t i = 0; i < sizeof instances / sizeof *instances; i++) CALL(FreeInstance)(instances[i]);
  free(bytes);
  printf("%ld calls carried out, %ld orderly steps, %ld messages of %ld characters\n", good, steps, messages, characters);
  return 0;
}
