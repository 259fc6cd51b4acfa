/* A whole record through a compiled model. Comes after the generated model and schedule.c. */

#include <stdlib.h>
#include <string.h>

#define DONE 0
#define NO_MEMORY 1
#define DELAY_FULL 2

/* inputs: n rows of N_INPUTS; steps: n - 1 lengths [s], steps[k] from row k to row k + 1, under the inputs of row k;
 * outputs: n rows of N_OUTPUTS, sampled at each row before its inputs act; tangents: n rows of N_OUTPUTS x N_WRT, or NULL. */
int simulate(const double *parameters, const double *inputs, const double *steps, long n, double *outputs, double *tangents) {
  Instance *m = calloc(1, sizeof *m);
  double *rings = N_DELAYED ? malloc(2 * (size_t)SLOTS * N_DELAYED_OR_1 * sizeof *rings) : NULL;
  int code = m && (rings || !N_DELAYED) ? DONE : NO_MEMORY;
  if (code == DONE) {
    memcpy(m->v + N_INPUTS + N_OUTPUTS, parameters, N_PARAMETERS * sizeof *parameters);
    memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
    for (int k = 0; k < N_DELAYED; k++) {
      m->lines[k].waits = rings + 2 * (size_t)SLOTS * k;
      m->lines[k].values = m->lines[k].waits + SLOTS;
      m->lines[k].slots = SLOTS;
      delay_start(&m->lines[k], m->v[DELAYED_INPUT[k]]);
    }
    start(m->v, m->d);
  }
  for (long row = 0; code == DONE; row++) {
    memcpy(outputs + row * N_OUTPUTS, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
    if (tangents) memcpy(tangents + row * N_OUTPUTS * N_WRT, m->d, N_OUTPUTS * N_WRT * sizeof *tangents);
    if (row == n - 1) break;
    memcpy(m->v, inputs + row * N_INPUTS, N_INPUTS * sizeof *inputs);
    if (SAMPLED)
      run_sampled(m, steps[row]);
    else if (!run_held(m, steps[row]))
      code = DELAY_FULL;
  }
  free(rings);
  free(m);
  return code;
}
