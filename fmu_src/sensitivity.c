/* Derivatives of the outputs, for fmi2GetDirectionalDerivative. Comes after schedule.c, whose steps call `before_step`.
 *
 * A tangent `a` has the shape of the values `v`. It holds a direction in inputs and parameters; the generated start_along()
 * and step_along() fill in the derivatives of outputs and states along it. One direction costs about as much as the model
 * itself. The tangents of all parameters and inputs, one each, are carried only if an importer has queried a parameter's. Those of
 * parameters are since the start, those of inputs over the last communication step, whose input they hold. */

/* Allocates, if not there yet, a tangent for each parameter and input. */
static bool carry_sensitivities(Slave *s) {
  if (!s->carried) s->carried = calloc(N_CARRIED_OR_1, sizeof *s->carried);
  return s->carried != NULL;
}

static void settle_along(Slave *s, double *along);

/* The tangents at the start, for the settled values. */
static void start_sensitivities(Slave *s) {
  memset(s->carried, 0, N_CARRIED * sizeof *s->carried);
  for (int j = 0; j < N_PARAMETERS; j++) {
    s->carried[j][FIRST_PARAMETER + j] = 1.0;
    settle_along(s, s->carried[j]);
  }
}

/* Before a communication step: nothing depends on the inputs of this step yet. */
static void begin_inputs(Slave *s) {
  if (!s->carried) return;
  memset(s->carried + N_PARAMETERS, 0, N_INPUTS * sizeof *s->carried);
  for (int j = 0; j < N_INPUTS; j++) s->carried[N_PARAMETERS + j][j] = 1.0;
  for (int k = 0; k < N_DELAYED; k++) s->carried[N_PARAMETERS + DELAYED_INPUT[k]][DELAYED_INPUT[k]] = 0.0; /* it acts later */
}

static int is_observed(const Instance *m) { return ((const Slave *)m)->carried != NULL; }

/* Half of a nudge (see schedule.c), a trial step: only the delay's tangent gains its effect on the states. */
static void nudge_sensitivities(Slave *s, double dt, const double *dt_tangent) {
  for (int k = 0; k < N_DELAYED; k++) {
    if (dt_tangent[k] == 0.0) continue;
    double alone[N_VALUES] = {0};
    step_along(s->m.v, dt, dt_tangent[k], alone);
    double *carried = s->carried[DELAY_PARAMETER[k] - FIRST_PARAMETER];
    for (int i = FIRST_STATE; i < N_VALUES; i++) carried[i] += alone[i];
  }
}

/* Advance the tangents by a step of dt, from the states before it. A sampled law's step is its sample time. */
static void before_step(Instance *m, double dt, const double *dt_tangent) {
  Slave *s = (Slave *)m; /* m is the first of a slave's members */
  if (!s->carried) return;
  if (m->nudging) {
    nudge_sensitivities(s, dt, dt_tangent);
    return;
  }
  for (int j = 0; j < N_CARRIED; j++)
    step_along(m->v, dt, SAMPLED && SAMPLE_TIME == FIRST_PARAMETER + j ? 1.0 : 0.0, s->carried[j]);
}
