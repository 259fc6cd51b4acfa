/* Run a whole record with a compiled model. Comes after the generated model and schedule.c. */

#include <stdlib.h>
#include <string.h>

#define DONE 0
#define DELAY_FULL 1
#define APART 2

typedef struct {
  Instance instance;
  double rings[2 * SLOTS * N_DELAYED_OR_1]; /* never touched, so not in memory, if nothing is delayed */
} Run;

/* A run settled on the first row of inputs, without tangents where it is `plain`; NULL: no memory. */
void *begin(const double *parameters, const double *first, int plain) {
  Run *run = calloc(1, sizeof *run);
  if (!run) return NULL;
  Instance *m = &run->instance;
  memcpy(m->v + N_INPUTS + N_OUTPUTS, parameters, N_PARAMETERS * sizeof *parameters);
  memcpy(m->v, first, N_INPUTS * sizeof *first);
  for (int k = 0; k < N_DELAYED; k++) {
    m->lines[k].waits = run->rings + 2 * (size_t)SLOTS * k;
    m->lines[k].values = m->lines[k].waits + SLOTS;
    m->lines[k].slots = SLOTS;
    delay_start(&m->lines[k], m->v[DELAYED_INPUT[k]]);
  }
  start(m->v, m->d);
  m->plain = plain;
  return run;
}

/* The next n rows. inputs: n rows of N_INPUTS; steps: the n lengths [s] from row to row, under the inputs of the row, of which
 * the `last` piece has one less; outputs: n rows of N_OUTPUTS, sampled at each row before its inputs act; tangents: of each
 * output n rows of N_WRT, or NULL. */
int proceed(void *of, const double *inputs, const double *steps, long n, int last, double *outputs, double *const *tangents) {
  Instance *m = &((Run *)of)->instance;
  for (long row = 0; row < n; row++) {
    memcpy(outputs + row * N_OUTPUTS, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
    for (int i = 0; i < N_OUTPUTS; i++)
      if (tangents[i]) memcpy(tangents[i] + row * N_WRT, m->d + i * N_WRT, N_WRT * sizeof *m->d);
    if (last && row == n - 1) break;
    memcpy(m->v, inputs + row * N_INPUTS, N_INPUTS * sizeof *inputs);
    if (SAMPLED)
      run_sampled(m, steps[row]);
    else if (!run_held(m, steps[row]))
      return DELAY_FULL;
  }
  return DONE;
}

void end(void *run) { free(run); }

#ifdef LANES
/* Number of step lengths whose constants are kept: of a row and its parts before and after a late command, each with two
 * lengths because of the clock's rounding. */
#define PREPARED 6

/* The widest vectors of the processor, from compiler.py: no fused operations, and so the same bits on each. */
#ifdef VECTORS
#define WIDEST __attribute__((target(VECTORS)))
#else
#define WIDEST
#endif

/* A whole record for LANES sets of parameters (LANES x N_PARAMETERS) side by side, as proceed() runs each. inputs, steps: of n rows.
 * outputs: N_OUTPUTS x n rows of LANES, `stride` numbers from row to row. APART: their largest steps differ, so they would take
 * different steps. */
WIDEST int alike(const double *parameters, const double *inputs, const double *steps, long n, long stride, double *outputs) {
  static const double no_tangent[N_DELAYED_OR_1] = {0};
  double v[N_VALUES][LANES], c[PREPARED][N_CONSTANTS][LANES], own[N_VALUES] = {0}, constants[N_CONSTANTS], tangents[N_TANGENTS];
  double dt[PREPARED] = {0}, largest = INFINITY;
  int oldest = 0;
  for (int k = 0; k < LANES; k++) {
    memcpy(own, inputs, N_INPUTS * sizeof *inputs);
    memcpy(own + N_INPUTS + N_OUTPUTS, parameters + k * N_PARAMETERS, N_PARAMETERS * sizeof *parameters);
    start(own, tangents);
    for (int i = 0; i < N_VALUES; i++) v[i][k] = own[i];
    if (k && largest_step(own) != largest) return APART;
    largest = largest_step(own);
  }
  for (long row = 0; row < n; row++) {
    for (int i = 0; i < N_OUTPUTS; i++) memcpy(outputs + (i * n + row) * stride, v[N_INPUTS + i], sizeof v[0]);
    if (row == n - 1) break;
    for (int i = 0; i < N_INPUTS; i++)
      for (int k = 0; k < LANES; k++) v[i][k] = inputs[row * N_INPUTS + i];
    double count = 1.0;
    if (largest < INFINITY) {
      count = ceil(steps[row] / largest - NOW);
      if (count < 1.0) count = 1.0;
    }
    const double piece = steps[row] / count;
    int at = 0;
    while (at < PREPARED && !(dt[at] == piece)) at++;
    if (at == PREPARED) {
      at = oldest;
      oldest = (oldest + 1) % PREPARED;
      dt[at] = piece;
      for (int k = 0; k < LANES; k++) {
        for (int i = 0; i < N_VALUES; i++) own[i] = v[i][k];
        prepare(own, piece, no_tangent, constants);
        for (int i = 0; i < N_CONSTANTS; i++) c[at][i][k] = constants[i];
      }
    }
    for (double i = 0.0; i < count; i += 1.0) step_lanes(v, c[at]);
  }
  return DONE;
}
#endif
