/* Derivatives of the outputs, for fmi2GetDirectionalDerivative. Comes after schedule.c, whose steps call `before_step`.
 *
 * A tangent `a` has the shape of the values `v`. It holds a direction in inputs and parameters; the generated start_along()
 * and step_along() fill in the derivatives of outputs and states along it. One direction costs about as much as the model
 * itself. The tangents of all parameters, one each, are carried only if an importer has queried one of them. */

/* Allocates, if not there yet, a tangent for each parameter. */
static bool carry_sensitivities(Slave *s) {
  if (!s->carried) s->carried = calloc(N_PARAMETERS_OR_1, sizeof *s->carried);
  return s->carried != NULL;
}

static void settle_along(Slave *s, double *along);

/* The tangents at the start, for the settled values. */
static void start_sensitivities(Slave *s) {
  memset(s->carried, 0, sizeof(double[N_PARAMETERS_OR_1][N_VALUES]));
  for (int j = 0; j < N_PARAMETERS; j++) {
    s->carried[j][FIRST_PARAMETER + j] = 1.0;
    settle_along(s, s->carried[j]);
  }
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
  for (int j = 0; j < N_PARAMETERS; j++)
    step_along(m->v, dt, SAMPLED && SAMPLE_TIME == FIRST_PARAMETER + j ? 1.0 : 0.0, s->carried[j]);
}
