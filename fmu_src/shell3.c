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

/* All variables are scalar: as many values as references. */
static bool scalar(Slave *s, const char *call, size_t n, size_t n_values) {
  if (!s) return false;
  if (n == n_values) return true;
  refuse(s, MODEL_NAME ": %s: found %zu references and %zu values, expected as many", call, n, n_values);
  return false;
}

/* Time may be read alone or with other variables. */
FMI(fmi3Status, GetFloat64)
(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 value[], size_t n_values) {
  static const char call[] = "fmi3GetFloat64";
  Slave *s = c;
  if (!scalar(s, call, n, n_values) || get_values(s, call, vr, n, value) != OK) return fmi3Error;
  for (size_t i = 0; i < n; i++) {
    if (vr[i] == TIME_REFERENCE)
      value[i] = s->time;
    else if (get_reals(s, call, vr + i, 1, value + i) != OK)
      return fmi3Error;
  }
  return fmi3OK;
}

SETTER(set_booleans, fmi3Boolean, BOOLEAN, value[i])
GETTER(get_booleans, fmi3Boolean, BOOLEAN)

#define VALUES(call, function, type)                                                                                          \
  FMI(fmi3Status, call)(fmi3Instance c, const fmi3ValueReference vr[], size_t n, type value[], size_t n_values) {             \
    if (!scalar(c, "fmi3" #call, n, n_values)) return fmi3Error;                                                              \
    return (fmi3Status)function(c, "fmi3" #call, vr, n, value);                                                               \
  }

VALUES(SetFloat64, set_reals, const fmi3Float64)
VALUES(GetInt32, get_integers, fmi3Int32)
VALUES(SetInt32, set_integers, const fmi3Int32)
VALUES(GetBoolean, get_booleans, fmi3Boolean)
VALUES(SetBoolean, set_booleans, const fmi3Boolean)

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
NO_VALUES(Int64, int64_t)
NO_VALUES(UInt64, uint64_t)
NO_VALUES(String, fmi3String)

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
  if (!scalar(c, call, n_known, n_seed) || !scalar(c, call, n_unknown, n_found)) return fmi3Error;
  return (fmi3Status)derivative(c, call, unknowns, n_unknown, knowns, n_known, seed, found);
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
