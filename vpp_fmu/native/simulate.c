/* Run a whole record with a compiled model. Comes after the generated model, schedule.c and rows.c. */

#include <stdlib.h>
#include <string.h>

#define DONE 0
#define DELAY_FULL 1
#define APART 2

/* Constants by step length. Rows of a log differ in length, and the digits of its clock leave some hundred lengths: a table begins
 * with FEW places, and gets MANY when lengths replace each other. An entry begins with its length. */
#define FEW 16
#define MANY 2048

typedef struct {
  char *entries;
  double *last; /* the last entry that was asked for */
  size_t size;
  int places, missed;
} Table;

static int table_begins(Table *t, size_t size) {
  t->entries = calloc(FEW, size);
  t->last = (double *)t->entries;
  t->size = size;
  t->places = FEW;
  t->missed = 0;
  return t->entries != NULL;
}

static double *place_of(const Table *t, double dt) {
  unsigned long long bits;
  memcpy(&bits, &dt, sizeof bits);
  return (double *)(t->entries + t->size * (((bits * 0x9E3779B97F4A7C15ull) >> 40) & (unsigned)(t->places - 1)));
}

/* The entry of a length, or one of another length that it replaces. */
static double *entry_of(Table *t, double dt) {
  if (*t->last == dt) return t->last;
  t->last = place_of(t, dt);
  if (*t->last != dt && t->places < MANY && ++t->missed > 2 * FEW) {
    char *more = calloc(MANY, t->size);
    if (more) {
      free(t->entries);
      t->entries = more;
      t->places = MANY;
      t->last = place_of(t, dt);
    }
  }
  return t->last;
}

typedef struct {
  Instance instance;
  Table constants;
  double rings[2 * SLOTS * N_DELAYED_OR_1]; /* never touched, so not in memory, if nothing is delayed */
} Run;

static Constants *constants_for(void *m, double dt) { return (Constants *)entry_of(&((Run *)m)->constants, dt); }

/* A run settled on the first row of inputs, without tangents where it is `plain`; NULL: no memory. */
void *begin(const double *parameters, const double *first, int plain) {
  Run *run = calloc(1, sizeof *run);
  if (!run) return NULL;
  if (!table_begins(&run->constants, sizeof(Constants))) {
    free(run);
    return NULL;
  }
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

/* The rows from `first` to before `end` of `count`. inputs: rows of N_INPUTS; steps: the lengths [s] from row to row, under the
 * inputs of the row, one less than rows; late: as run_row(); outputs: from `first`, rows of N_OUTPUTS, sampled at each row before
 * its inputs act; tangents: of each output rows of N_WRT, or NULL. */
int proceed(void *of, const double *inputs, const double *steps, double late, long first, long end, long count, double *outputs,
            double *const *tangents) {
  Instance *m = &((Run *)of)->instance;
  for (long row = first; row < end; row++) {
    memcpy(outputs + (row - first) * N_OUTPUTS, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
    for (int i = 0; i < N_OUTPUTS; i++)
      if (tangents[i]) memcpy(tangents[i] + (row - first) * N_WRT, m->d + i * N_WRT, N_WRT * sizeof *m->d);
    if (row == count - 1) break;
    if (!run_row(m, inputs + row * N_INPUTS, steps[row], row ? late : 0.0)) return DELAY_FULL;
  }
  return DONE;
}

void end(void *run) {
  free(((Run *)run)->constants.entries);
  free(run);
}

#ifdef LANES
/* Constants of LANES runs, for the step length `dt`. */
typedef struct {
  double dt, c[N_CONSTANTS][LANES];
} LaneConstants;

/* The widest vectors of the processor, from compiler.py: no fused operations, and so the same bits on each. */
#ifdef VECTORS
#define WIDEST __attribute__((target(VECTORS)))
/* Scalar code, as of exp(), takes four times as long while the upper halves of vector registers are in use. */
#define LEAVE_VECTORS __builtin_ia32_vzeroupper()
#else
#define WIDEST
#define LEAVE_VECTORS
#endif

/* Advance LANES sets of values by `span` seconds. */
WIDEST static void advance_lanes(double (*v)[LANES], Table *kept, double largest, double span) {
  static const double no_tangent[N_DELAYED_OR_1] = {0};
  double count = 1.0, own[N_VALUES], constants[N_CONSTANTS];
  if (largest < INFINITY) {
    count = ceil(span / largest - NOW);
    if (count < 1.0) count = 1.0;
  }
  const double piece = span / count;
  LaneConstants *at = (LaneConstants *)entry_of(kept, piece);
  if (!(at->dt == piece)) {
    at->dt = piece;
    LEAVE_VECTORS;
    for (int k = 0; k < LANES; k++) {
      for (int i = 0; i < N_VALUES; i++) own[i] = v[i][k];
      prepare(own, piece, no_tangent, constants);
      for (int i = 0; i < N_CONSTANTS; i++) at->c[i][k] = constants[i];
    }
  }
  for (double i = 0.0; i < count; i += 1.0) step_lanes(v, at->c);
}

/* A whole record for LANES sets of parameters (LANES x N_PARAMETERS) side by side, as proceed() runs each. inputs, steps: of n rows.
 * outputs: N_OUTPUTS x n rows of LANES, `stride` numbers from row to row. APART: their largest steps differ, so they would take
 * different steps; or there is no memory. */
WIDEST int alike(const double *parameters, const double *inputs, const double *steps, double late, long n, long stride,
                 double *outputs) {
  double v[N_VALUES][LANES], own[N_VALUES] = {0}, tangents[N_TANGENTS], largest = INFINITY;
  for (int k = 0; k < LANES; k++) {
    memcpy(own, inputs, N_INPUTS * sizeof *inputs);
    memcpy(own + N_INPUTS + N_OUTPUTS, parameters + k * N_PARAMETERS, N_PARAMETERS * sizeof *parameters);
    start(own, tangents);
    for (int i = 0; i < N_VALUES; i++) v[i][k] = own[i];
    if (k && largest_step(own) != largest) return APART;
    largest = largest_step(own);
  }
  Table kept;
  if (!table_begins(&kept, sizeof(LaneConstants))) return APART;
  for (long row = 0; row < n; row++) {
    for (int i = 0; i < N_OUTPUTS; i++) memcpy(outputs + (i * n + row) * stride, v[N_INPUTS + i], sizeof v[0]);
    if (row == n - 1) break;
    const double *held = inputs + row * N_INPUTS;
    double span = steps[row];
    int moved = 0;
    if (late > 0.0 && row)
      for (int i = 0; i < N_INPUTS; i++) moved |= COMMANDED[i] && held[i] != held[i - N_INPUTS];
    if (moved) {
      for (int i = 0; i < N_INPUTS; i++)
        for (int k = 0; k < LANES; k++) v[i][k] = held[COMMANDED[i] ? i - N_INPUTS : i];
      advance_lanes(v, &kept, largest, late * span);
      span *= 1.0 - late;
    }
    for (int i = 0; i < N_INPUTS; i++)
      for (int k = 0; k < LANES; k++) v[i][k] = held[i];
    advance_lanes(v, &kept, largest, span);
  }
  free(kept.entries);
  LEAVE_VECTORS;
  return DONE;
}
#endif
