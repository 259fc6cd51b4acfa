/* The calls of FMI 2.0 co-simulation on a traced model. The last of the texts that make an FMU's one source file.
 *
 * A call that can't be carried out returns fmi2Error after one message through the logger, in the Python flavour's words;
 * the instance is then in the standard's error state: values can still be read, and a reset or a saved state brings it
 * back. Errors are told unless the importer switches them off: `loggingOn` is about debugging, of which there is none. */

static const char *const CATEGORIES[N_CATEGORIES] = {"logStatusDiscard", "logStatusError", "logStatusFatal"};

/* One message to the importer; `%` doubled, since it becomes a format there. */
static void tell(fmi2CallbackLogger logger, fmi2ComponentEnvironment environment, const char *name, fmi2Status status,
                 const char *format, va_list values) {
  char text[MESSAGE], safe[2 * MESSAGE], *at = safe;
  if (!logger) return;
  vsnprintf(text, sizeof text, format, values);
  for (const char *c = text; *c; c++) {
    if (*c == '%') *at++ = '%';
    *at++ = *c;
  }
  *at = '\0';
  logger(environment, name, status, CATEGORIES[status == fmi2Discard ? DISCARD : ERROR], safe);
}

static fmi2Status refuse(Slave *s, const char *format, ...) {
  va_list values;
  va_start(values, format);
  s->state = FAILED;
  if (s->tells[ERROR]) tell(s->logger, s->environment, s->name, fmi2Error, format, values);
  va_end(values);
  return fmi2Error;
}

/* The standard's answer to questions that an importer may ask but that have no answer here; the instance goes on. */
static fmi2Status discard(Slave *s, const char *format, ...) {
  va_list values;
  va_start(values, format);
  if (s->tells[DISCARD]) tell(s->logger, s->environment, s->name, fmi2Discard, format, values);
  va_end(values);
  return fmi2Discard;
}

static bool allowed(Slave *s, const char *call, int states) {
  if (!s) return false;
  if (s->state & states) return true;
  const char *now = s->state == INSTANTIATED   ? "before fmi2EnterInitializationMode"
                    : s->state == INITIALISING ? "in initialization mode"
                    : s->state == STEPPING     ? "after fmi2ExitInitializationMode"
                    : s->state == TERMINATED   ? "after fmi2Terminate"
                                               : "after an error; fmi2Reset or fmi2SetFMUstate mends it";
  refuse(s, MODEL_NAME ": %s is not allowed %s", call, now);
  return false;
}

static bool given(Slave *s, const char *call, size_t n, const void *references, const void *values) {
  if (n == 0 || (references && values)) return true;
  refuse(s, MODEL_NAME ": %s was given a null pointer", call);
  return false;
}

static bool is_finite(double x) { return x - x == 0.0; }

/* A number as Python writes it: the shortest digits that read back to the same. */
static const char *number(char *text, double x) {
  if (x != x) return "nan";
  if (!is_finite(x)) return x < 0.0 ? "-inf" : "inf";
  int digits = 0, exponent = 0;
  do snprintf(text, 32, "%.*e", digits, x);
  while (strtod(text, NULL) != x && digits++ < 16);
  exponent = atoi(strchr(text, 'e') + 1);
  if (-5 < exponent && exponent < 16) snprintf(text, 32, "%.*f", digits - exponent < 1 ? 1 : digits - exponent, x);
  return text;
}

static bool unknown(Slave *s, fmi2ValueReference r) {
  refuse(s, MODEL_NAME ": value reference %u is unknown, allowed is 0 to %d", r, N_VALUES - 1);
  return true;
}

static bool set_value(Slave *s, fmi2ValueReference r, double x) {
  char text[32];
  if (r >= N_VALUES) return !unknown(s, r);
  if (r >= N_INPUTS && (r < FIRST_PARAMETER || r >= FIRST_STATE))
    refuse(s, MODEL_NAME ": %s is computed, it can't be set", NAMES[r]);
  else if (r >= N_INPUTS && s->state == STEPPING)
    refuse(s, MODEL_NAME ": %s is fixed, it can't be set after initialisation", NAMES[r]);
  else if (!is_finite(x))
    refuse(s, MODEL_NAME ": %s can't be set to %s, a finite number is needed", NAMES[r], number(text, x));
  else {
    s->m.v[r] = x;
    return true;
  }
  return false;
}

static void begin(Slave *s) {
  memcpy(s->m.v, START, sizeof s->m.v);
  free(s->carried);
  s->carried = NULL;
  s->settled = false;
  s->state = INSTANTIATED;
  start_schedule(s);
}

/* During initialisation what is read must follow what was set; from then on steps alone move outputs and states. */
static void settle(Slave *s) {
  if (s->state != INITIALISING || s->settled) return;
  start(s->m.v, s->m.d);
  s->settled = true;
}

FMI(const char *, GetTypesPlatform)(void) { return "default"; }

FMI(const char *, GetVersion)(void) { return "2.0"; }

static fmi2Component no_instance(const fmi2CallbackFunctions *functions, const char *name, const char *format, ...) {
  va_list values;
  va_start(values, format);
  if (functions) tell(functions->logger, functions->componentEnvironment, name ? name : "", fmi2Error, format, values);
  va_end(values);
  return NULL;
}

FMI(fmi2Component, Instantiate)
(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources, const fmi2CallbackFunctions *functions,
 fmi2Boolean visible, fmi2Boolean logging) {
  (void)resources, (void)visible, (void)logging;
  if (type != fmi2CoSimulation) return no_instance(functions, name, MODEL_NAME ": is for co-simulation only");
  if (!guid || strcmp(guid, MODEL_GUID) != 0)
    return no_instance(functions, name, MODEL_NAME ": guid is %s, allowed is " MODEL_GUID, guid ? guid : "missing");
  if (!name || !*name) return no_instance(functions, name, MODEL_NAME ": instance name is missing");
  Slave *s = calloc(1, sizeof *s);
  if (s) s->name = malloc(strlen(name) + 1);
  if (!s || !s->name) {
    free(s);
    return no_instance(functions, name, MODEL_NAME ": out of memory");
  }
  strcpy(s->name, name);
  if (functions) { /* copied, for importers that drop theirs */
    s->logger = functions->logger;
    s->environment = functions->componentEnvironment;
  }
  for (int i = 0; i < N_CATEGORIES; i++) s->tells[i] = true;
  begin(s);
  return s;
}

FMI(void, FreeInstance)(fmi2Component c) {
  Slave *s = c;
  if (!s) return;
  free(s->carried);
  free(s->name);
  free(s);
}

FMI(fmi2Status, SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
  Slave *s = c;
  if (!allowed(s, "fmi2SetDebugLogging", ANY) || !given(s, "fmi2SetDebugLogging", n, categories, categories)) return fmi2Error;
  for (int i = 0; i < N_CATEGORIES && n == 0; i++) s->tells[i] = on != 0;
  for (size_t k = 0; k < n; k++) {
    int i = 0;
    while (i < N_CATEGORIES && categories[k] && strcmp(categories[k], CATEGORIES[i]) != 0) i++;
    if (!categories[k] || i == N_CATEGORIES)
      return refuse(s, MODEL_NAME ": log category %s is unknown", categories[k] ? categories[k] : "NULL");
    s->tells[i] = on != 0;
  }
  return fmi2OK;
}

FMI(fmi2Status, SetupExperiment)
(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start_time, fmi2Boolean stop_defined,
 fmi2Real stop_time) {
  (void)tolerance_defined, (void)tolerance, (void)stop_time, (void)stop_defined; /* steps are exact, and time plays no part */
  char text[32];
  Slave *s = c;
  if (!allowed(s, "fmi2SetupExperiment", INSTANTIATED)) return fmi2Error;
  if (!is_finite(start_time))
    return refuse(s, MODEL_NAME ": start time is %s s, a finite number is needed", number(text, start_time));
  return fmi2OK;
}

FMI(fmi2Status, EnterInitializationMode)(fmi2Component c) {
  Slave *s = c;
  if (!allowed(s, "fmi2EnterInitializationMode", INSTANTIATED)) return fmi2Error;
  s->state = INITIALISING;
  return fmi2OK;
}

/* From here on at rest on the inputs that stand now. */
FMI(fmi2Status, ExitInitializationMode)(fmi2Component c) {
  char text[32];
  Slave *s = c;
  if (!allowed(s, "fmi2ExitInitializationMode", INITIALISING)) return fmi2Error;
  for (int i = 0; i < N_PARAMETERS; i++) {
    const double x = s->m.v[FIRST_PARAMETER + i];
    if (!(RANGES[i].minimum <= x && x <= RANGES[i].maximum))
      return refuse(s, MODEL_NAME ": %s is %s %s, allowed is %s", NAMES[FIRST_PARAMETER + i], number(text, x), RANGES[i].unit,
                    RANGES[i].text);
  }
  settle(s);
  start_schedule(s);
  if (s->carried) start_sensitivities(s);
  s->state = STEPPING;
  return fmi2OK;
}

FMI(fmi2Status, Terminate)(fmi2Component c) {
  Slave *s = c;
  if (!allowed(s, "fmi2Terminate", STEPPING)) return fmi2Error;
  s->state = TERMINATED;
  return fmi2OK;
}

FMI(fmi2Status, Reset)(fmi2Component c) {
  Slave *s = c;
  if (!allowed(s, "fmi2Reset", ANY)) return fmi2Error;
  begin(s);
  return fmi2OK;
}

FMI(fmi2Status, DoStep)(fmi2Component c, fmi2Real time, fmi2Real size, fmi2Boolean no_return) {
  (void)time, (void)no_return;
  Slave *s = c;
  if (!s || s->state != STEPPING) return allowed(s, "fmi2DoStep", STEPPING), fmi2Error;
  if ((size != s->m.dt || !EXACT) && !(size > 0.0 && is_finite(size))) {
    char text[32];
    return refuse(s, MODEL_NAME ": communication step is %s s, a positive number is needed", number(text, size));
  }
#if EXACT
  take_step(&s->m, size, NULL); /* one step of the chain is one communication step */
#elif SAMPLED
  run_sampled(&s->m, size);
#else
  if (!run_held(&s->m, size))
    return refuse(s, MODEL_NAME ": more than %d command changes wait in one delay: take longer communication steps", SLOTS);
#endif
  return fmi2OK;
}

#define READABLE (INITIALISING | STEPPING | TERMINATED | FAILED)
#define SETTABLE (INSTANTIATED | INITIALISING | STEPPING)

FMI(fmi2Status, GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
  Slave *s = c;
  if (!allowed(s, "fmi2GetReal", READABLE) || !given(s, "fmi2GetReal", n, vr, value)) return fmi2Error;
  settle(s);
  for (size_t i = 0; i < n; i++) {
    if (vr[i] >= N_VALUES && unknown(s, vr[i])) return fmi2Error;
    value[i] = s->m.v[vr[i]];
  }
  return fmi2OK;
}

FMI(fmi2Status, SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
  Slave *s = c;
  if (!allowed(s, "fmi2SetReal", SETTABLE) || !given(s, "fmi2SetReal", n, vr, value)) return fmi2Error;
  for (size_t i = 0; i < n; i++)
    if (!set_value(s, vr[i], value[i])) return fmi2Error;
  s->settled = false;
  return fmi2OK;
}

/* All variables are Real; asking for none of another type is no mistake. */
#define NO_SUCH(call, states, type)                                                                                      \
  FMI(fmi2Status, call)(fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) {                        \
    (void)value;                                                                                                         \
    if (!allowed(c, "fmi2" #call, states) || !given(c, "fmi2" #call, n, vr, vr)) return fmi2Error;                       \
    return n == 0 ? fmi2OK : refuse(c, MODEL_NAME ": fmi2" #call ": value reference %u is not of this type", vr[0]);     \
  }

NO_SUCH(GetInteger, READABLE, fmi2Integer)
NO_SUCH(GetBoolean, READABLE, fmi2Boolean)
NO_SUCH(GetString, READABLE, fmi2String)
NO_SUCH(SetInteger, SETTABLE, const fmi2Integer)
NO_SUCH(SetBoolean, SETTABLE, const fmi2Boolean)
NO_SUCH(SetString, SETTABLE, const fmi2String)

/* The derivative of outputs and states (unknowns) along a move of knowns.
 *
 * In initialization mode the knowns are inputs and parameters, as listed under InitialUnknowns. At a communication point the
 * standard knows inputs only, and there no output depends on them: held inputs act over the next step. Parameters are fixed
 * by then, so an importer that keeps to the standard won't ask; who does gets what the outputs owe to them since the start,
 * provided the instance was told to carry that along by a question about any parameter in initialization mode. */
FMI(fmi2Status, GetDirectionalDerivative)
(fmi2Component c, const fmi2ValueReference unknowns[], size_t n_unknown, const fmi2ValueReference knowns[], size_t n_known,
 const fmi2Real moved[], fmi2Real found[]) {
  static const char call[] = "fmi2GetDirectionalDerivative";
  double along[N_VALUES] = {0};
  Slave *s = c;
  if (!allowed(s, call, READABLE) || !given(s, call, n_unknown, unknowns, found) || !given(s, call, n_known, knowns, moved))
    return fmi2Error;
  const bool starting = s->state == INITIALISING;
  for (size_t j = 0; j < n_known; j++) {
    const fmi2ValueReference r = knowns[j];
    if (r >= N_VALUES && unknown(s, r)) return fmi2Error;
    if (r < N_INPUTS) {
      if (starting) along[r] += moved[j];
      continue;
    }
    if (r < FIRST_PARAMETER || r >= FIRST_STATE)
      return refuse(s, MODEL_NAME ": %s: %s is no known, allowed are inputs and parameters", call, NAMES[r]);
    if (starting && !carry_sensitivities(s)) return refuse(s, MODEL_NAME ": out of memory");
    if (!s->carried)
      return refuse(s, MODEL_NAME ": %s: ask for %s in initialization mode first, sensitivities are carried from there on",
                    call, NAMES[r]);
    along[r] += moved[j];
    for (int i = 0; i < N_VALUES && !starting; i++)
      if (i < FIRST_PARAMETER || i >= FIRST_STATE) along[i] += moved[j] * s->carried[r - FIRST_PARAMETER][i];
  }
  if (starting) settle(s), start_along(s->m.v, along);
  for (size_t i = 0; i < n_unknown; i++) {
    const fmi2ValueReference r = unknowns[i];
    if (r >= N_VALUES && unknown(s, r)) return fmi2Error;
    if (r < N_INPUTS || (r >= FIRST_PARAMETER && r < FIRST_STATE))
      return refuse(s, MODEL_NAME ": %s: %s is no unknown, allowed are outputs and states", call, NAMES[r]);
    found[i] = along[r];
  }
  return fmi2OK;
}

FMI(fmi2Status, GetFMUstate)(fmi2Component c, fmi2FMUstate *state) {
  Slave *s = c;
  if (!allowed(s, "fmi2GetFMUstate", ANY) || !given(s, "fmi2GetFMUstate", 1, state, state)) return fmi2Error;
  Saved *saved = realloc(*state, sizeof *saved + saved_count(s) * sizeof(double)); /* one that is handed in is used again */
  if (!saved) return refuse(s, MODEL_NAME ": out of memory");
  save(s, saved);
  *state = saved;
  return fmi2OK;
}

FMI(fmi2Status, SetFMUstate)(fmi2Component c, fmi2FMUstate state) {
  Slave *s = c;
  if (!allowed(s, "fmi2SetFMUstate", ANY) || !given(s, "fmi2SetFMUstate", 1, state, state)) return fmi2Error;
  if (((Saved *)state)->data[TAG] != MODEL_TAG) return refuse(s, MODEL_NAME ": this is no state of this FMU");
  return restore(s, state) ? fmi2OK : refuse(s, MODEL_NAME ": out of memory");
}

FMI(fmi2Status, FreeFMUstate)(fmi2Component c, fmi2FMUstate *state) {
  Slave *s = c;
  if (!allowed(s, "fmi2FreeFMUstate", ANY) || !given(s, "fmi2FreeFMUstate", 1, state, state)) return fmi2Error;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

FMI(fmi2Status, SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size) {
  static const char call[] = "fmi2SerializedFMUstateSize";
  if (!allowed(c, call, ANY) || !given(c, call, 1, state, size)) return fmi2Error;
  *size = ((Saved *)state)->count * sizeof(double);
  return fmi2OK;
}

FMI(fmi2Status, SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
  Saved *saved = state;
  if (!allowed(c, "fmi2SerializeFMUstate", ANY) || !given(c, "fmi2SerializeFMUstate", 1, state, bytes)) return fmi2Error;
  if (size < saved->count * sizeof(double))
    return refuse(c, MODEL_NAME ": the state needs %zu bytes, given are %zu", saved->count * sizeof(double), size);
  saved->data[CHECKSUM] = checksum(saved->data, saved->count);
  memcpy(bytes, saved->data, saved->count * sizeof(double));
  return fmi2OK;
}

FMI(fmi2Status, DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
  Slave *s = c;
  if (!allowed(s, "fmi2DeSerializeFMUstate", ANY) || !given(s, "fmi2DeSerializeFMUstate", 1, bytes, state)) return fmi2Error;
  Saved *saved = malloc(sizeof *saved + size);
  if (!saved) return refuse(s, MODEL_NAME ": out of memory");
  saved->count = size / sizeof(double);
  memcpy(saved->data, bytes, size);
  if (size % sizeof(double) || !is_whole(saved->data, saved->count)) {
    free(saved);
    return refuse(s, MODEL_NAME ": these %zu bytes are no serialised state of this FMU", size);
  }
  free(*state);
  *state = saved;
  return fmi2OK;
}

FMI(fmi2Status, SetRealInputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) {
  (void)vr, (void)order, (void)value;
  if (!allowed(c, "fmi2SetRealInputDerivatives", SETTABLE)) return fmi2Error;
  return n == 0 ? fmi2OK : refuse(c, MODEL_NAME ": inputs are held between communication points, they have no derivatives");
}

FMI(fmi2Status, GetRealOutputDerivatives)
(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
  (void)vr, (void)order, (void)value;
  if (!allowed(c, "fmi2GetRealOutputDerivatives", READABLE & ~INITIALISING)) return fmi2Error;
  return n == 0 ? fmi2OK : refuse(c, MODEL_NAME ": derivatives of outputs in time are not provided");
}

FMI(fmi2Status, CancelStep)(fmi2Component c) {
  return allowed(c, "fmi2CancelStep", 0), fmi2Error; /* a step is done when fmi2DoStep returns: none is ever in progress */
}

#define NO_STATUS(call, type)                                                                                              \
  FMI(fmi2Status, call)(fmi2Component c, const fmi2StatusKind kind, type *value) {                                         \
    (void)kind, (void)value;                                                                                               \
    if (!allowed(c, "fmi2" #call, STEPPING | TERMINATED | FAILED)) return fmi2Error;                                       \
    return discard(c, MODEL_NAME ": fmi2" #call " has nothing to tell, steps are neither pending nor discarded");          \
  }

NO_STATUS(GetStatus, fmi2Status)
NO_STATUS(GetRealStatus, fmi2Real)
NO_STATUS(GetIntegerStatus, fmi2Integer)
NO_STATUS(GetBooleanStatus, fmi2Boolean)
NO_STATUS(GetStringStatus, fmi2String)
