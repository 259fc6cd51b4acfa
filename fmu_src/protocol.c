/* The part of an instance that all versions of the standard share: order of calls, checks of arguments, messages.
 *
 * A refused call logs one message, with the same text as in the Python flavour. The instance is then in its error state:
 * values can still be read, and a reset or a saved state restores it. `call`: the standard's name of the call. */

static void tell(Slave *s, int category, Status status, const char *format, va_list values) {
  char text[MESSAGE];
  if (!s->logger || !s->tells[category]) return;
  vsnprintf(text, sizeof text, format, values);
  deliver(s->logger, s->environment, s->name, status, CATEGORIES[category], text);
}

#define TELLING(name, result, category, status, after)                                                                        \
  static result name(Slave *s, const char *format, ...) {                                                                     \
    va_list values;                                                                                                           \
    va_start(values, format);                                                                                                 \
    tell(s, category, status, format, values);                                                                                \
    va_end(values);                                                                                                           \
    after;                                                                                                                    \
  }

TELLING(refuse, Status, ERROR, REFUSED, s->state = FAILED; return REFUSED)
/* For queries that the standard allows but that have no answer here. The instance remains usable. */
TELLING(discard, Status, DISCARD, DISCARDED, return DISCARDED)
TELLING(warn, void, WARNING, WARNED, return)
TELLING(report, void, EVENTS, OK, return)

static bool allowed(Slave *s, const char *call, int states) {
  if (!s) return false;
  if (s->state & states) return true;
  refuse(s, MODEL_NAME ": %s: found a call %s, expected one that is allowed then", call, IN_WORDS[s->state]);
  return false;
}

static bool given(Slave *s, const char *call, size_t n, const void *references, const void *values) {
  if (n == 0 || (references && values)) return true;
  refuse(s, MODEL_NAME ": %s: found a null pointer, expected data", call);
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

static bool unknown(Slave *s, unsigned r) {
  refuse(s, MODEL_NAME ": value reference: found %u, expected 0 to %d", r, N_VALUES - 1);
  return true;
}

/* Whether the reference is that of a variable of this type. */
static bool is_of(Slave *s, const char *call, unsigned r, int type) {
  if (r >= N_VALUES) return !unknown(s, r);
  if (TYPES[r] == type || (TYPES[r] == ENUMERATION && type == ENUMERATIONS_AS)) return true;
  refuse(s, MODEL_NAME ": %s: found %s of type %s, expected the call's own type", call, NAMES[r], TYPE_NAMES[TYPES[r]]);
  return false;
}

/* Whether x is the number of one of the variable's items, if it has any. */
static bool is_item(Slave *s, unsigned r, double x) {
  char text[32];
  int n = 0;
  if (!ITEMS[r]) return true;
  while (ITEMS[r][n]) n++;
  if (1.0 <= x && x <= n && x == (int)x) return true;
  return refuse(s, MODEL_NAME ": %s: found item %s, expected 1 to %d", NAMES[r], number(text, x), n), false;
}

static bool in_range(Slave *s, int parameter) {
  char text[32];
  const double x = s->m.v[FIRST_PARAMETER + parameter];
  if (RANGES[parameter].minimum <= x && x <= RANGES[parameter].maximum) return true;
  refuse(s, MODEL_NAME ": %s: found %s%s, expected %s", NAMES[FIRST_PARAMETER + parameter], number(text, x),
         RANGES[parameter].unit, RANGES[parameter].text);
  return false;
}

static bool set_value(Slave *s, const char *call, unsigned r, int type, double x) {
  char text[32];
  if (!is_of(s, call, r, type)) return false;
  const bool is_parameter = r >= FIRST_PARAMETER && r < FIRST_STATE, is_state = r >= FIRST_STATE;
  if (r >= N_INPUTS && !is_parameter && !is_state)
    refuse(s, MODEL_NAME ": %s: found a value, expected none: it is computed", NAMES[r]);
  else if (is_state && s->state == STEPPING)
    refuse(s, MODEL_NAME ": %s: found a value after initialisation, expected it before: it is computed", NAMES[r]);
  else if (is_parameter && s->state == STEPPING && !TUNABLE[r - FIRST_PARAMETER])
    refuse(s, MODEL_NAME ": %s: found a value after initialisation, expected it before: it is fixed", NAMES[r]);
  else if (!is_finite(x))
    refuse(s, MODEL_NAME ": %s: found %s, expected a finite number", NAMES[r], number(text, x));
  else if (is_item(s, r, x)) {
    s->m.v[r] = x;
    if (is_state) s->chosen[r - FIRST_STATE] = true;
    if (is_parameter && s->state == STEPPING) {
      if (!in_range(s, r - FIRST_PARAMETER)) return false;
      s->m.kept[0].dt = NAN; /* the prepared constants are stale */
      report(s, MODEL_NAME ": %s set to %s", NAMES[r], number(text, x));
    }
    return true;
  }
  return false;
}

static void begin(Slave *s) {
  memcpy(s->m.v, START, sizeof s->m.v);
  memset(s->chosen, 0, sizeof s->chosen);
  free(s->carried);
  s->carried = NULL;
  s->settled = false;
  s->time = 0.0;
  s->state = INSTANTIATED;
  start_schedule(s);
}

/* Two partial sums are faster: in a single sum each addition waits for the last one. */
static double sum(const double *v, int first, int last) {
  double even = 0.0, odd = 0.0;
  for (int i = first; i + 1 < last; i += 2) even += v[i], odd += v[i + 1];
  return (last - first) % 2 ? even + odd + v[last - 1] : even + odd;
}

static inline bool has_numbers(const Slave *s) {
  if (is_finite(sum(s->m.v, N_INPUTS, FIRST_PARAMETER) + sum(s->m.v, FIRST_STATE, N_VALUES))) return true;
  for (int i = N_INPUTS; i < N_VALUES; i++)
    if (!is_finite(s->m.v[i])) return false;
  return true; /* each is finite, though their sum is not */
}

/* Refuse a result that is not finite: an input is far outside the model's range. */
static Status no_numbers(Slave *s, double time) {
  char text[MESSAGE], at[32], one[32];
  size_t used = 0;
  text[0] = '\0';
  for (int i = 0; i < N_INPUTS && used < sizeof text; i++)
    used += snprintf(text + used, sizeof text - used, "%s%s = %s", i ? ", " : "", NAMES[i], number(one, s->m.v[i]));
  return refuse(s, MODEL_NAME ": step at %s s: found no finite numbers from %s, expected finite ones", number(at, time), text);
}

/* During initialisation outputs and states follow from the values set; after it only steps change them. Refused if a result
 * is not finite: all values then stay as they were. */
static bool settle(Slave *s) {
  double kept[N_VALUES];
  bool any = false;
  if (s->state != INITIALISING || s->settled) return true;
  memcpy(kept, s->m.v, sizeof kept);
  start(s->m.v, s->m.d);
  for (int i = FIRST_STATE; i < N_VALUES; i++)
    if (s->chosen[i - FIRST_STATE]) s->m.v[i] = kept[i], any = true;
  if (any && !SAMPLED) show(s->m.v); /* a sampled law has not run yet: its outputs keep their start values */
  s->settled = has_numbers(s);
  if (s->settled) return true;
  no_numbers(s, s->time);
  memcpy(s->m.v, kept, sizeof kept);
  return false;
}

/* Directional derivatives of the settled outputs and states at the start, along the direction in `along`. */
static void settle_along(Slave *s, double *along) {
  bool any = false;
  start_along(s->m.v, along);
  for (int i = 0; i < N_STATES; i++)
    if (s->chosen[i]) along[FIRST_STATE + i] = 0.0, any = true;
  if (any && !SAMPLED) show_along(s->m.v, along);
}

/* Set the start time [s]. */
static Status setup(Slave *s, const char *call, int states, double time) {
  char text[32];
  if (!allowed(s, call, states)) return REFUSED;
  if (!is_finite(time)) return refuse(s, MODEL_NAME ": start time: found %s s, expected a finite number", number(text, time));
  s->time = time;
  return OK;
}

static Status enter(Slave *s, const char *call) {
  if (!allowed(s, call, ENTER_STATES)) return REFUSED;
  s->state = INITIALISING;
  return OK;
}

/* End the initialisation, at rest on the present inputs. */
static Status leave_initialisation(Slave *s, const char *call) {
  char text[32];
  if (!allowed(s, call, EXIT_STATES)) return REFUSED;
  for (int i = 0; i < N_PARAMETERS; i++)
    if (!in_range(s, i)) return REFUSED;
  if (!settle(s)) return REFUSED;
  start_schedule(s);
  if (s->carried) start_sensitivities(s);
  s->state = STEPPING;
  report(s, MODEL_NAME ": initialised at %s s", number(text, s->time));
  return OK;
}

static Status terminate(Slave *s, const char *call) {
  char text[32];
  if (!allowed(s, call, TERMINATE_STATES)) return REFUSED;
  s->state = TERMINATED;
  report(s, MODEL_NAME ": terminated at %s s", number(text, s->time));
  return OK;
}

static Status reset(Slave *s, const char *call) {
  if (!allowed(s, call, RESET_STATES)) return REFUSED;
  begin(s);
  return OK;
}

/* The longest allowed communication step, s. */
static double longest(const Slave *s) {
  if (EXACT) return LONGEST_EXACT;
  double own = SAMPLED ? s->m.v[SAMPLE_TIME] : largest_step(s->m.v);
  for (int k = 0; k < N_SAMPLED; k++)
    if (s->m.v[SAMPLE_PERIOD[k]] < own) own = s->m.v[SAMPLE_PERIOD[k]];
  return PIECES * own;
}

static Status do_step(Slave *s, const char *call, double time, double size) {
  char one[32], other[32];
  double kept[N_VALUES];
  if (!s || s->state != STEPPING) return allowed(s, call, STEP_STATES), REFUSED;
  if (!(size > 0.0 && is_finite(size)))
    return refuse(s, MODEL_NAME ": communication step: found %s s, expected a positive number", number(one, size));
  if (size > longest(s))
    return refuse(s, MODEL_NAME ": communication step: found %s s, expected up to %s s", number(one, size),
                  number(other, longest(s)));
  if (time != s->time && !(fabs(time - s->time) <= SLACK * size + NOW * fabs(time)))
    return refuse(s, MODEL_NAME ": start of the step: found %s s, expected the instance's time, %s s", number(one, time),
                  number(other, s->time));
  memcpy(kept, s->m.v, sizeof kept);
  begin_inputs(s);
#if EXACT
  take_step(&s->m, size, NULL); /* one step of the chain is one communication step */
#elif SAMPLED
  run_sampled(&s->m, size);
#else
  if (!run_held(&s->m, size))
    return refuse(s, MODEL_NAME ": delay: found more than %d waiting command changes, expected fewer. "
                     "Try: longer communication steps", SLOTS);
#endif
  if (!has_numbers(s)) {
    no_numbers(s, time);
    memcpy(s->m.v, kept, sizeof kept); /* after a failed step the values are those from before it */
    return REFUSED;
  }
  s->time = time + size;
  s->last = size;
  return OK;
}

static Status get_values(Slave *s, const char *call, const unsigned *references, size_t n, const void *values) {
  if (!allowed(s, call, GET_STATES) || !given(s, call, n, references, values)) return REFUSED;
  return settle(s) ? OK : REFUSED;
}

/* The standard's functions differ only in the type of a value. */
#define GETTER(name, c_type, type)                                                                                            \
  static Status name(Slave *s, const char *call, const unsigned r[], size_t n, c_type value[]) {                              \
    if (get_values(s, call, r, n, value) != OK) return REFUSED;                                                               \
    for (size_t i = 0; i < n; i++) {                                                                                          \
      if (!is_of(s, call, r[i], type)) return REFUSED;                                                                        \
      value[i] = (c_type)s->m.v[r[i]];                                                                                        \
    }                                                                                                                         \
    return OK;                                                                                                                \
  }
#define SETTER(name, c_type, type, converted)                                                                                 \
  static Status name(Slave *s, const char *call, const unsigned r[], size_t n, const c_type value[]) {                        \
    if (!allowed(s, call, SET_STATES) || !given(s, call, n, r, value)) return REFUSED;                                        \
    for (size_t i = 0; i < n; i++)                                                                                            \
      if (!set_value(s, call, r[i], type, converted)) return REFUSED;                                                         \
    s->settled = false;                                                                                                       \
    return OK;                                                                                                                \
  }

GETTER(get_reals, double, REAL)
SETTER(set_reals, double, REAL, value[i])
GETTER(get_integers, int, INTEGER)
SETTER(set_integers, int, INTEGER, value[i])

/* A string is one of its variable's items; the model has its number. */
static Status get_strings(Slave *s, const char *call, const unsigned r[], size_t n, const char *value[]) {
  if (get_values(s, call, r, n, value) != OK) return REFUSED;
  for (size_t i = 0; i < n; i++) {
    if (!is_of(s, call, r[i], STRING) || !is_item(s, r[i], s->m.v[r[i]])) return REFUSED;
    value[i] = ITEMS[r[i]][(int)s->m.v[r[i]] - 1];
  }
  return OK;
}

static Status set_strings(Slave *s, const char *call, const unsigned r[], size_t n, const char *const value[]) {
  if (!allowed(s, call, SET_STATES) || !given(s, call, n, r, value)) return REFUSED;
  for (size_t i = 0; i < n; i++) {
    int k = 0;
    if (!is_of(s, call, r[i], STRING)) return REFUSED;
    if (!value[i]) return refuse(s, MODEL_NAME ": %s: found a null pointer, expected data", call);
    while (ITEMS[r[i]][k] && strcmp(ITEMS[r[i]][k], value[i]) != 0) k++;
    if (!ITEMS[r[i]][k]) return refuse(s, MODEL_NAME ": %s: found %s, expected one of its items", NAMES[r[i]], value[i]);
    if (!set_value(s, call, r[i], STRING, k + 1.0)) return REFUSED;
  }
  s->settled = false;
  return OK;
}

/* For types without variables: only a call without references is accepted. */
static Status none_such(Slave *s, const char *call, int states, const unsigned r[], size_t n) {
  if (!allowed(s, call, states) || !given(s, call, n, r, r)) return REFUSED;
  if (n == 0) return OK;
  if (r[0] >= N_VALUES) return unknown(s, r[0]), REFUSED;
  return refuse(s, MODEL_NAME ": %s: found %s of type %s, expected the call's own type", call, NAMES[r[0]],
                TYPE_NAMES[TYPES[r[0]]]);
}

/* The directional derivative of outputs and states (unknowns) with respect to knowns.
 *
 * In initialization mode the knowns are inputs and parameters, as listed under InitialUnknowns. At a communication point the
 * standard has inputs only, and no output depends on them there: held inputs act over the next step. Beyond the standard, after
 * a query for any parameter in initialization mode, the instance carries derivatives along: those in parameters since the start,
 * those in inputs over the last communication step. */
static Status derivative(Slave *s, const char *call, const unsigned unknowns[], size_t n_unknown, const unsigned knowns[],
                         size_t n_known, const double moved[], double found[]) {
  double along[N_VALUES] = {0};
  if (!allowed(s, call, DERIVATIVE_STATES) || !given(s, call, n_unknown, unknowns, found) ||
      !given(s, call, n_known, knowns, moved))
    return REFUSED;
  const bool starting = s->state == INITIALISING;
  if (!settle(s)) return REFUSED;
  for (size_t j = 0; j < n_known; j++) {
    const unsigned r = knowns[j];
    if (r >= N_VALUES && unknown(s, r)) return REFUSED;
    if (r < N_INPUTS) {
      if (starting) along[r] += moved[j];
      for (int k = 0; k < N_DELAYED; k++)
        if (s->carried && !starting && DELAYED_INPUT[k] == (int)r && s->m.v[DELAY_PARAMETER[k]] < s->last - NOW)
          return refuse(s, MODEL_NAME ": %s: found the known %s, which acts within the step, expected one without a delay", call, NAMES[r]);
      for (int i = N_INPUTS; i < N_VALUES && s->carried && !starting; i++)
        if (i < FIRST_PARAMETER || i >= FIRST_STATE) along[i] += moved[j] * s->carried[N_PARAMETERS + r][i];
      continue;
    }
    if (r < FIRST_PARAMETER || r >= FIRST_STATE)
      return refuse(s, MODEL_NAME ": %s: found the known %s, expected an input or a parameter", call, NAMES[r]);
    if (starting && !carry_sensitivities(s)) return refuse(s, MODEL_NAME ": out of memory");
    if (!s->carried)
      return refuse(s, MODEL_NAME ": %s: found the known %s after initialisation, expected it in initialization mode first",
                    call, NAMES[r]);
    along[r] += moved[j];
    for (int i = 0; i < N_VALUES && !starting; i++)
      if (i < FIRST_PARAMETER || i >= FIRST_STATE) along[i] += moved[j] * s->carried[r - FIRST_PARAMETER][i];
  }
  if (starting) settle_along(s, along);
  for (size_t i = 0; i < n_unknown; i++) {
    const unsigned r = unknowns[i];
    if (r >= N_VALUES && unknown(s, r)) return REFUSED;
    if (r < N_INPUTS || (r >= FIRST_PARAMETER && r < FIRST_STATE))
      return refuse(s, MODEL_NAME ": %s: found the unknown %s, expected an output or a state", call, NAMES[r]);
    found[i] = along[r];
  }
  return OK;
}

static Status set_logging(Slave *s, const char *call, bool on, size_t n, const char *const categories[]) {
  if (!allowed(s, call, LOG_STATES) || !given(s, call, n, categories, categories)) return REFUSED;
  for (int i = 0; i < N_CATEGORIES && n == 0; i++) s->tells[i] = on;
  for (size_t k = 0; k < n; k++) {
    if (!categories[k]) return refuse(s, MODEL_NAME ": %s: found a null pointer, expected data", call);
    const bool all = strcmp(categories[k], "logAll") == 0;
    bool known = all;
    for (int i = 0; i < N_CATEGORIES; i++)
      if (all || strcmp(categories[k], CATEGORIES[i]) == 0) s->tells[i] = on, known = true;
    if (!known) warn(s, MODEL_NAME ": log category %s is unknown", categories[k]);
  }
  return OK;
}

static Status get_state(Slave *s, const char *call, void **state) {
  if (!allowed(s, call, STATE_STATES) || !given(s, call, 1, state, state)) return REFUSED;
  Saved *saved = realloc(*state, sizeof *saved + saved_count(s) * sizeof(double)); /* an existing state is overwritten */
  if (!saved) return refuse(s, MODEL_NAME ": out of memory");
  save(s, saved);
  *state = saved;
  return OK;
}

static Status set_state(Slave *s, const char *call, void *state) {
  if (!allowed(s, call, STATE_STATES) || !given(s, call, 1, state, state)) return REFUSED;
  if (((Saved *)state)->data[TAG] != MODEL_TAG)
    return refuse(s, MODEL_NAME ": state: found one of another FMU, expected one of this FMU");
  return restore(s, state) ? OK : refuse(s, MODEL_NAME ": out of memory");
}

static Status free_state(Slave *s, const char *call, void **state) {
  if (!allowed(s, call, STATE_STATES) || !given(s, call, 1, state, state)) return REFUSED;
  free(*state);
  *state = NULL;
  return OK;
}

static Status state_size(Slave *s, const char *call, void *state, size_t *size) {
  if (!allowed(s, call, STATE_STATES) || !given(s, call, 1, state, size)) return REFUSED;
  *size = ((Saved *)state)->count * sizeof(double);
  return OK;
}

static Status state_to_bytes(Slave *s, const char *call, void *state, void *bytes, size_t size) {
  Saved *saved = state;
  if (!allowed(s, call, STATE_STATES) || !given(s, call, 1, state, bytes)) return REFUSED;
  if (size < saved->count * sizeof(double))
    return refuse(s, MODEL_NAME ": state: found room for %zu bytes, expected %zu", size, saved->count * sizeof(double));
  saved->data[CHECKSUM] = checksum(saved->data, saved->count);
  memcpy(bytes, saved->data, saved->count * sizeof(double));
  return OK;
}

static Status state_from_bytes(Slave *s, const char *call, const void *bytes, size_t size, void **state) {
  if (!allowed(s, call, STATE_STATES) || !given(s, call, 1, bytes, state)) return REFUSED;
  Saved *saved = malloc(sizeof *saved + size);
  if (!saved) return refuse(s, MODEL_NAME ": out of memory");
  saved->count = size / sizeof(double);
  memcpy(saved->data, bytes, size);
  if (size % sizeof(double) || !is_whole(saved->data, saved->count)) {
    free(saved);
    return refuse(s, MODEL_NAME ": state: found %zu bytes that hold none, expected a serialised state of this FMU", size);
  }
  free(*state);
  *state = saved;
  return OK;
}

/* A new instance, or NULL after one message. */
static Slave *new_slave(Logger logger, void *environment, const char *name, const char *guid, bool logging, const char *why) {
  Slave nameless = {.logger = logger, .environment = environment, .name = (char *)(name ? name : "")};
  for (int i = 0; i < N_CATEGORIES; i++) nameless.tells[i] = i != EVENTS || logging;
  if (why)
    refuse(&nameless, MODEL_NAME ": %s", why);
  else if (!guid || strcmp(guid, MODEL_GUID) != 0)
    refuse(&nameless, MODEL_NAME ": guid: found %s, expected " MODEL_GUID, guid ? guid : "none");
  else if (!name || !*name)
    refuse(&nameless, MODEL_NAME ": instance name: found none, expected a text");
  else {
    Slave *s = malloc(sizeof *s);
    char *own = malloc(strlen(name) + 1);
    if (s && own) {
      memset(s, 0, sizeof *s);
      s->logger = logger, s->environment = environment;
      memcpy(s->tells, nameless.tells, sizeof s->tells);
      s->name = strcpy(own, name);
      begin(s);
      return s;
    }
    free(s);
    free(own);
    refuse(&nameless, MODEL_NAME ": out of memory");
  }
  return NULL;
}

static void free_slave(Slave *s) {
  if (!s) return;
  free(s->carried);
  free(s->name);
  free(s);
}
