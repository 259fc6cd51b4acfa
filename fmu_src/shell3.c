/* The functions of FMI 3.0 co-simulation. The last part of an FMU's single source file.
 *
 * Every function of the standard must exist; those for other interface types, clocks and missing variables are refused. Time
 * is a separate variable after all others. */

#define TIME_REFERENCE N_VALUES

FMI(const char *, GetVersion)(void) { return "3.0"; }

FMI(fmi3Instance, InstantiateCoSimulation)
(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode,
 fmi3Boolean early_return, const fmi3ValueReference required[], size_t n_required, void *environment, Logger logger,
 void *intermediate_update) {
  (void)resources, (void)visible, (void)event_mode, (void)early_return, (void)required, (void)intermediate_update;
  return new_slave(logger, environment, name, token, logging, n_required ? "intermediate variables: found some asked for, expected none" : NULL);
}

FMI(fmi3Instance, InstantiateModelExchange)
(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, void *environment,
 Logger logger) {
  (void)resources, (void)visible;
  return new_slave(logger, environment, name, token, logging, "type: found another one, expected co-simulation");
}

FMI(fmi3Instance, InstantiateScheduledExecution)
(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, void *environment,
 Logger logger, void *clock_update, void *lock, void *unlock) {
  (void)resources, (void)visible, (void)clock_update, (void)lock, (void)unlock;
  return new_slave(logger, environment, name, token, logging, "type: found another one, expected co-simulation");
}

FMI(void, FreeInstance)(fmi3Instance c) { free_slave(c); }

FMI(fmi3Status, SetDebugLogging)(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
  return (fmi3Status)set_logging(c, "fmi3SetDebugLogging", on, n, categories);
}

FMI(fmi3Status, EnterInitializationMode)
(fmi3Instance c, fmi3Boolean tolerance_defined, fmi3Float64 tolerance, fmi3Float64 start_time, fmi3Boolean stop_defined,
 fmi3Float64 stop_time) {
  /* steps are exact and may pass the stop time */
  (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop_time;
  if (setup(c, "fmi3EnterInitializationMode", ENTER_STATES, start_time) != OK) return fmi3Error;
  return (fmi3Status)enter(c, "fmi3EnterInitializationMode");
}

FMI(fmi3Status, ExitInitializationMode)(fmi3Instance c) {
  return (fmi3Status)leave_initialisation(c, "fmi3ExitInitializationMode");
}

FMI(fmi3Status, Terminate)(fmi3Instance c) { return (fmi3Status)terminate(c, "fmi3Terminate"); }

FMI(fmi3Status, Reset)(fmi3Instance c) { return (fmi3Status)reset(c, "fmi3Reset"); }

FMI(fmi3Status, DoStep)
(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no_return, fmi3Boolean *event, fmi3Boolean *end,
 fmi3Boolean *early, fmi3Float64 *reached) {
  (void)no_return;
  Slave *s = c;
  const Status status = do_step(s, "fmi3DoStep", time, size);
  if (event) *event = false;
  if (end) *end = false;
  if (early) *early = false;
  if (reached && s) *reached = s->time;
  return (fmi3Status)status;
}

/* The references of all elements of these variables, to be freed; NULL after a message, or without any. An array has the
 * reference of its first element, and as many values as elements. */
static unsigned *expanded(Slave *s, const char *call, const fmi3ValueReference vr[], size_t n, size_t n_values, bool *good) {
  size_t count = 0;
  *good = false;
  if (!s || !given(s, call, n, vr, vr)) return NULL;
  for (size_t i = 0; i < n; i++) count += vr[i] < N_VALUES && SIZES[vr[i]] ? SIZES[vr[i]] : 1;
  if (count != n_values) {
    refuse(s, MODEL_NAME ": %s: found %zu references of %zu values and room for %zu, expected as many", call, n, count, n_values);
    return NULL;
  }
  unsigned *all = malloc((count ? count : 1) * sizeof *all);
  if (!all) return refuse(s, MODEL_NAME ": out of memory"), NULL;
  count = 0;
  for (size_t i = 0; i < n; i++) {
    const int size = vr[i] < N_VALUES && SIZES[vr[i]] ? SIZES[vr[i]] : 1;
    for (int k = 0; k < size; k++) all[count++] = vr[i] + k;
  }
  *good = true;
  return all;
}

#define EXPANDED(call, vr, n, n_values, doing)                                                                                \
  bool good;                                                                                                                  \
  unsigned *all = expanded(c, call, vr, n, n_values, &good);                                                                  \
  const fmi3Status status = good ? (fmi3Status)(doing) : fmi3Error;                                                           \
  free(all);                                                                                                                  \
  return status;

/* Time may be read alone or with other variables. */
static Status get_float64(Slave *s, const unsigned r[], size_t n, double value[]) {
  static const char call[] = "fmi3GetFloat64";
  if (get_values(s, call, r, n, value) != OK) return REFUSED;
  for (size_t i = 0; i < n; i++) {
    if (r[i] == TIME_REFERENCE)
      value[i] = s->time;
    else if (get_reals(s, call, r + i, 1, value + i) != OK)
      return REFUSED;
  }
  return OK;
}

FMI(fmi3Status, GetFloat64)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t n_values) {
  EXPANDED("fmi3GetFloat64", vr, n, n_values, get_float64(c, all, n_values, value))
}

SETTER(set_booleans, fmi3Boolean, BOOLEAN, value[i])
GETTER(get_booleans, fmi3Boolean, BOOLEAN)
SETTER(set_enumerations, int64_t, ENUMERATION, (double)value[i])
GETTER(get_enumerations, int64_t, ENUMERATION)

#define VALUES(call, function, type)                                                                                          \
  FMI(fmi3Status, call)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type value[], size_t n_values) {             \
    EXPANDED("fmi3" #call, vr, n, n_values, function(c, "fmi3" #call, all, n_values, value))                                  \
  }

VALUES(SetFloat64, set_reals, const fmi3Float64)
VALUES(GetInt32, get_integers, fmi3Int32)
VALUES(SetInt32, set_integers, const fmi3Int32)
VALUES(GetInt64, get_enumerations, int64_t)
VALUES(SetInt64, set_enumerations, const int64_t)
VALUES(GetBoolean, get_booleans, fmi3Boolean)
VALUES(SetBoolean, set_booleans, const fmi3Boolean)
VALUES(GetString, get_strings, fmi3String)
VALUES(SetString, set_strings, const fmi3String)

#define NO_VALUES(kind, type)                                                                                                 \
  FMI(fmi3Status, Get##kind)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type value[], size_t n_values) {        \
    (void)value, (void)n_values;                                                                                              \
    return (fmi3Status)none_such(c, "fmi3Get" #kind, GET_STATES, vr, n);                                                      \
  }                                                                                                                           \
  FMI(fmi3Status, Set##kind)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const type value[], size_t n_values) {  \
    (void)value, (void)n_values;                                                                                              \
    return (fmi3Status)none_such(c, "fmi3Set" #kind, SET_STATES, vr, n);                                                      \
  }

NO_VALUES(Float32, float)
NO_VALUES(Int8, int8_t)
NO_VALUES(UInt8, uint8_t)
NO_VALUES(Int16, int16_t)
NO_VALUES(UInt16, uint16_t)
NO_VALUES(UInt32, uint32_t)
NO_VALUES(UInt64, uint64_t)

FMI(fmi3Status, GetBinary)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary value[], size_t n_values) {
  (void)sizes, (void)value, (void)n_values;
  return (fmi3Status)none_such(c, "fmi3GetBinary", GET_STATES, vr, n);
}

FMI(fmi3Status, SetBinary)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const fmi3Binary value[], size_t n_values) {
  (void)sizes, (void)value, (void)n_values;
  return (fmi3Status)none_such(c, "fmi3SetBinary", SET_STATES, vr, n);
}

FMI(fmi3Status, GetClock)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock value[]) {
  (void)value;
  return (fmi3Status)none_such(c, "fmi3GetClock", GET_STATES, vr, n);
}

FMI(fmi3Status, SetClock)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock value[]) {
  (void)value;
  return (fmi3Status)none_such(c, "fmi3SetClock", SET_STATES, vr, n);
}

FMI(fmi3Status, GetDirectionalDerivative)
(fmi3Instance c, const fmi3ValueReference unknowns[], size_t n_unknown, const fmi3ValueReference knowns[], size_t n_known,
 const fmi3Float64 seed[], size_t n_seed, fmi3Float64 found[], size_t n_found) {
  static const char call[] = "fmi3GetDirectionalDerivative";
  bool first, second;
  unsigned *of = expanded(c, call, unknowns, n_unknown, n_found, &first);
  unsigned *in = first ? expanded(c, call, knowns, n_known, n_seed, &second) : NULL;
  const fmi3Status status =
      first && second ? (fmi3Status)derivative(c, call, of, n_found, in, n_seed, seed, found) : fmi3Error;
  free(of);
  free(in);
  return status;
}

FMI(fmi3Status, GetFMUState)(fmi3Instance c, fmi3FMUState *state) {
  return (fmi3Status)get_state(c, "fmi3GetFMUState", state);
}

FMI(fmi3Status, SetFMUState)(fmi3Instance c, fmi3FMUState state) {
  return (fmi3Status)set_state(c, "fmi3SetFMUState", state);
}

FMI(fmi3Status, FreeFMUState)(fmi3Instance c, fmi3FMUState *state) {
  if (state && !*state) return fmi3OK;
  return (fmi3Status)free_state(c, "fmi3FreeFMUState", state);
}

FMI(fmi3Status, SerializedFMUStateSize)(fmi3Instance c, fmi3FMUState state, size_t *size) {
  return (fmi3Status)state_size(c, "fmi3SerializedFMUStateSize", state, size);
}

FMI(fmi3Status, SerializeFMUState)(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  return (fmi3Status)state_to_bytes(c, "fmi3SerializeFMUState", state, bytes, size);
}

FMI(fmi3Status, DeserializeFMUState)(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  return (fmi3Status)state_from_bytes(c, "fmi3DeserializeFMUState", bytes, size, state);
}

/* Functions of other kinds of FMU: an importer that has read the model description does not call them. */
typedef const fmi3ValueReference *References;

#define NOT_PROVIDED_0(call)                                                                                                  \
  FMI(fmi3Status, call)(fmi3Instance c) {                                                                                     \
    return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3" #call " is not provided") : fmi3Error;                               \
  }
#define NOT_PROVIDED_1(call, A)                                                                                               \
  FMI(fmi3Status, call)(fmi3Instance c, A a) {                                                                                \
    (void)a;                                                                                                                  \
    return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3" #call " is not provided") : fmi3Error;                               \
  }
#define NOT_PROVIDED_2(call, A, B)                                                                                            \
  FMI(fmi3Status, call)(fmi3Instance c, A a, B b) {                                                                           \
    (void)a, (void)b;                                                                                                         \
    return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3" #call " is not provided") : fmi3Error;                               \
  }
#define NOT_PROVIDED_3(call, A, B, D)                                                                                         \
  FMI(fmi3Status, call)(fmi3Instance c, A a, B b, D d) {                                                                      \
    (void)a, (void)b, (void)d;                                                                                                \
    return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3" #call " is not provided") : fmi3Error;                               \
  }
#define NOT_PROVIDED_4(call, A, B, D, E)                                                                                      \
  FMI(fmi3Status, call)(fmi3Instance c, A a, B b, D d, E e) {                                                                 \
    (void)a, (void)b, (void)d, (void)e;                                                                                       \
    return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3" #call " is not provided") : fmi3Error;                               \
  }
#define NOT_PROVIDED_5(call, A, B, D, E, F)                                                                                   \
  FMI(fmi3Status, call)(fmi3Instance c, A a, B b, D d, E e, F f) {                                                            \
    (void)a, (void)b, (void)d, (void)e, (void)f;                                                                              \
    return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3" #call " is not provided") : fmi3Error;                               \
  }

NOT_PROVIDED_0(EnterEventMode)
NOT_PROVIDED_0(EnterStepMode)
NOT_PROVIDED_0(EnterConfigurationMode)
NOT_PROVIDED_0(ExitConfigurationMode)
NOT_PROVIDED_0(EnterContinuousTimeMode)
NOT_PROVIDED_0(EvaluateDiscreteStates)
NOT_PROVIDED_1(SetTime, fmi3Float64)
NOT_PROVIDED_1(GetNumberOfEventIndicators, size_t *)
NOT_PROVIDED_1(GetNumberOfContinuousStates, size_t *)
NOT_PROVIDED_2(GetNumberOfVariableDependencies, fmi3ValueReference, size_t *)
NOT_PROVIDED_2(SetContinuousStates, const fmi3Float64 *, size_t)
NOT_PROVIDED_2(GetContinuousStateDerivatives, fmi3Float64 *, size_t)
NOT_PROVIDED_2(GetEventIndicators, fmi3Float64 *, size_t)
NOT_PROVIDED_2(GetContinuousStates, fmi3Float64 *, size_t)
NOT_PROVIDED_2(GetNominalsOfContinuousStates, fmi3Float64 *, size_t)
NOT_PROVIDED_2(ActivateModelPartition, fmi3ValueReference, fmi3Float64)
NOT_PROVIDED_3(CompletedIntegratorStep, fmi3Boolean, fmi3Boolean *, fmi3Boolean *)
NOT_PROVIDED_3(GetShiftDecimal, References, size_t, fmi3Float64 *)
NOT_PROVIDED_3(SetIntervalDecimal, References, size_t, const fmi3Float64 *)
NOT_PROVIDED_3(SetShiftDecimal, References, size_t, const fmi3Float64 *)
NOT_PROVIDED_4(GetIntervalDecimal, References, size_t, fmi3Float64 *, fmi3IntervalQualifier *)
NOT_PROVIDED_4(GetShiftFraction, References, size_t, uint64_t *, uint64_t *)
NOT_PROVIDED_4(SetIntervalFraction, References, size_t, const uint64_t *, const uint64_t *)
NOT_PROVIDED_4(SetShiftFraction, References, size_t, const uint64_t *, const uint64_t *)
NOT_PROVIDED_5(GetIntervalFraction, References, size_t, uint64_t *, uint64_t *, fmi3IntervalQualifier *)
NOT_PROVIDED_5(GetOutputDerivatives, References, size_t, const fmi3Int32 *, fmi3Float64 *, size_t)

FMI(fmi3Status, GetVariableDependencies)
(fmi3Instance c, fmi3ValueReference dependent, size_t indices[], fmi3ValueReference independents[], size_t of[],
 fmi3DependencyKind kinds[], size_t n) {
  (void)dependent, (void)indices, (void)independents, (void)of, (void)kinds, (void)n;
  return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3GetVariableDependencies is not provided") : fmi3Error;
}

FMI(fmi3Status, UpdateDiscreteStates)
(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *defined,
 fmi3Float64 *next) {
  (void)again, (void)end, (void)nominals, (void)values, (void)defined, (void)next;
  return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3UpdateDiscreteStates is not provided") : fmi3Error;
}

FMI(fmi3Status, GetAdjointDerivative)
(fmi3Instance c, References unknowns, size_t n_unknown, References knowns, size_t n_known, const fmi3Float64 seed[],
 size_t n_seed, fmi3Float64 found[], size_t n_found) {
  (void)unknowns, (void)n_unknown, (void)knowns, (void)n_known, (void)seed, (void)n_seed, (void)found, (void)n_found;
  return c ? (fmi3Status)refuse(c, MODEL_NAME ": fmi3GetAdjointDerivative is not provided") : fmi3Error;
}
