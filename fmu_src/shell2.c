/* The functions of FMI 2.0 co-simulation. The last part of an FMU's single source file. */

FMI(const char *, GetTypesPlatform)(void) { return "default"; }

FMI(const char *, GetVersion)(void) { return "2.0"; }

FMI(fmi2Component, Instantiate)
(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *functions,
 fmi2Boolean visible, fmi2Boolean logging) {
  (void)resources, (void)visible;
  if (!functions || !functions->logger) return NULL; /* the standard requires both; without a logger there is no message */
  return new_slave(functions->logger, functions->componentEnvironment, name, guid, logging != 0,
                   type == fmi2CoSimulation ? NULL : "type: found another one, expected co-simulation");
}

FMI(void, FreeInstance)(fmi2Component c) { free_slave(c); }

FMI(fmi2Status, SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  return (fmi2Status)set_logging(c, "fmi2SetDebugLogging", on != 0, n, categories);
}

FMI(fmi2Status, SetupExperiment)
(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start_time, fmi2Boolean stop_defined,
 fmi2Real stop_time) {
  /* steps are exact and may pass the stop time */
  (void)tolerance_defined, (void)tolerance, (void)stop_time, (void)stop_defined;
  return (fmi2Status)setup(c, "fmi2SetupExperiment", SETUP_STATES, start_time);
}

FMI(fmi2Status, EnterInitializationMode)(fmi2Component c) { return (fmi2Status)enter(c, "fmi2EnterInitializationMode"); }

FMI(fmi2Status, ExitInitializationMode)(fmi2Component c) {
  return (fmi2Status)leave_initialisation(c, "fmi2ExitInitializationMode");
}

FMI(fmi2Status, Terminate)(fmi2Component c) { return (fmi2Status)terminate(c, "fmi2Terminate"); }

FMI(fmi2Status, Reset)(fmi2Component c) { return (fmi2Status)reset(c, "fmi2Reset"); }

FMI(fmi2Status, DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_return) {
  (void)no_return;
  return (fmi2Status)do_step(c, "fmi2DoStep", time, size);
}

SETTER(set_booleans, fmi2Boolean, BOOLEAN, value[i] != 0)

#define VALUES(call, function, type)                                                                                          \
  FMI(fmi2Status, call)(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) {                             \
    return (fmi2Status)function(c, "fmi2" #call, vr, n, value);                                                               \
  }

GETTER(get_booleans, fmi2Boolean, BOOLEAN)
VALUES(GetReal, get_reals, fmi2Real)
VALUES(SetReal, set_reals, const fmi2Real)
VALUES(GetInteger, get_integers, fmi2Integer)
VALUES(SetInteger, set_integers, const fmi2Integer)
VALUES(GetBoolean, get_booleans, fmi2Boolean)
VALUES(SetBoolean, set_booleans, const fmi2Boolean)

FMI(fmi2Status, GetString)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) {
  return (fmi2Status)get_strings(c, "fmi2GetString", vr, n, value);
}

FMI(fmi2Status, SetString)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) {
  return (fmi2Status)set_strings(c, "fmi2SetString", vr, n, value);
}

FMI(fmi2Status, GetDirectionalDerivative)
(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknown, const fmi2ValueReference knowns[], size_t n_known,
 const fmi2Real moved[], fmi2Real found[]) {
  return (fmi2Status)derivative(c, "fmi2GetDirectionalDerivative", unknowns, n_unknown, knowns, n_known, moved, found);
}

FMI(fmi2Status, GetFMUstate)(fmi2Component c, fmi2FMUstate *state) {
  return (fmi2Status)get_state(c, "fmi2GetFMUstate", state);
}

FMI(fmi2Status, SetFMUstate)(fmi2Component c, fmi2FMUstate state) {
  return (fmi2Status)set_state(c, "fmi2SetFMUstate", state);
}

FMI(fmi2Status, FreeFMUstate)(fmi2Component c, fmi2FMUstate *state) {
  return (fmi2Status)free_state(c, "fmi2FreeFMUstate", state);
}

FMI(fmi2Status, SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size) {
  return (fmi2Status)state_size(c, "fmi2SerializedFMUstateSize", state, size);
}

FMI(fmi2Status, SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  return (fmi2Status)state_to_bytes(c, "fmi2SerializeFMUstate", state, bytes, size);
}

FMI(fmi2Status, DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  return (fmi2Status)state_from_bytes(c, "fmi2DeSerializeFMUstate", bytes, size, state);
}

FMI(fmi2Status, SetRealInputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) {
  (void)vr, (void)order, (void)value;
  if (!allowed(c, "fmi2SetRealInputDerivatives", INPUT_DERIVATIVES_STATES)) return fmi2Error;
  if (n == 0) return fmi2OK;
  return (fmi2Status)refuse(c, MODEL_NAME ": inputs are held between communication points, they have no derivatives");
}

FMI(fmi2Status, GetRealOutputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
  (void)vr, (void)order, (void)value;
  if (!allowed(c, "fmi2GetRealOutputDerivatives", OUTPUT_DERIVATIVES_STATES)) return fmi2Error;
  if (n == 0) return fmi2OK;
  return (fmi2Status)refuse(c, MODEL_NAME ": derivatives of outputs in time are not provided");
}

FMI(fmi2Status, CancelStep)(fmi2Component c) { return allowed(c, "fmi2CancelStep", CANCEL_STATES), fmi2Error; }

FMI(fmi2Status, GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
  Slave *s = c;
  if (!allowed(s, "fmi2GetRealStatus", STATUS_STATES) || !given(s, "fmi2GetRealStatus", 1, value, value)) return fmi2Error;
  if (kind != fmi2LastSuccessfulTime)
    return (fmi2Status)discard(s, MODEL_NAME ": fmi2GetRealStatus knows the last successful time alone");
  *value = s->time;
  return fmi2OK;
}

#define NO_STATUS(call, type)                                                                                                 \
  FMI(fmi2Status, call)(fmi2Component c, const fmi2StatusKind kind, type *value) {                                            \
    (void)kind, (void)value;                                                                                                  \
    if (!allowed(c, "fmi2" #call, STATUS_STATES)) return fmi2Error;                                                           \
    return (fmi2Status)discard(c, MODEL_NAME ": fmi2" #call " has nothing to tell, steps are neither pending nor discarded"); \
  }

NO_STATUS(GetStatus, fmi2Status)
NO_STATUS(GetIntegerStatus, fmi2Integer)
NO_STATUS(GetBooleanStatus, fmi2Boolean)
NO_STATUS(GetStringStatus, fmi2String)
