/* A compiled model that continues from its present state at each call. Comes after the generated model and schedule.c. */

#include <stdlib.h>
#include <string.h>

/* A model settled at `inputs`; NULL without memory. */
Instance *begin(const double *parameters, const double *inputs) {
  Instance *m = calloc(1, sizeof *m + 2 * (size_t)SLOTS * N_DELAYED_OR_1 * sizeof(double));
  if (!m) return NULL;
  double *rings = (double *)(m + 1);
  memcpy(m->v + N_INPUTS + N_OUTPUTS, parameters, N_PARAMETERS * sizeof *parameters);
  memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
  for (int k = 0; k < N_DELAYED; k++) {
    m->lines[k].waits = rings + 2 * (size_t)SLOTS * k;
    m->lines[k].values = m->lines[k].waits + SLOTS;
    m->lines[k].slots = SLOTS;
    delay_start(&m->lines[k], m->v[DELAYED_INPUT[k]]);
  }
  start(m->v, m->d);
  return m;
}

/* `count` steps of dt [s] under held inputs; outputs: a row of N_OUTPUTS at the end of each. 0: a delay is full. */
int advance(Instance *m, const double *inputs, double dt, long count, double *outputs) {
  memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
  for (long row = 0; row < count; row++) {
    if (SAMPLED)
      run_sampled(m, dt);
    else if (!run_held(m, dt))
      return 0;
    memcpy(outputs + row * N_OUTPUTS, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
  }
  return 1;
}

void end(Instance *m) { free(m); }
