/* Run a whole record with a compiled model. Comes after the generated model, schedule.c and rows.c. */

#include <stdlib.h>
#include <string.h>

#define DONE 0
#define DELAY_FULL 1

/* Constants by step length. Rows of a log differ in length, and the digits of its clock leave some hundred lengths. An entry begins
 * with its length. If there are more than MOST, the rest share the last entry. */
#define MOST 256
#define PLACES 1024 /* of the index, a power of two: few lengths share their first place */

typedef struct {
  char *entries;
  double *last; /* the last entry that was asked for */
  size_t size;
  int count, room;
  short index[PLACES]; /* 1 + number of the entry, 0: none */
} Table;

/* `empty`: zeros. 0: no memory. */
static int table_begins(Table *empty, size_t size) {
  empty->size = size;
  empty->room = 16;
  empty->entries = malloc(empty->room * size);
  if (!empty->entries) return 0;
  empty->last = (double *)empty->entries;
  *empty->last = NAN;
  return 1;
}

/* The entry of a length; or one that begins with NAN, for the caller to fill. */
static inline double *entry_of(Table *t, double dt) {
  if (*t->last == dt) return t->last;
  unsigned long long bits;
  memcpy(&bits, &dt, sizeof bits);
  unsigned place = (bits * 0x9E3779B97F4A7C15ull) >> 40 & (PLACES - 1);
  for (; t->index[place]; place = (place + 1) & (PLACES - 1)) {
    t->last = (double *)(t->entries + t->size * (t->index[place] - 1));
    if (*t->last == dt) return t->last;
  }
  if (t->count == t->room && t->room < MOST) {
    char *more = realloc(t->entries, 2 * t->room * t->size);
    if (more) t->entries = more, t->room *= 2;
  }
  if (t->count < t->room) t->index[place] = ++t->count;
  t->last = (double *)(t->entries + t->size * (t->count - 1));
  *t->last = NAN;
  return t->last;
}

#ifdef LANES
/* The widest vectors of the processor, from compiler.py: no fused operations, and so the same bits on each. */
#ifdef VECTORS
#define WIDEST __attribute__((target(VECTORS)))
/* Scalar code, as of sin(), takes four times as long while the upper halves of vector registers are in use. */
#define LEAVE_VECTORS __builtin_ia32_vzeroupper()
#else
#define WIDEST
#define LEAVE_VECTORS
#endif

WIDEST APART static void lanes_prepare(double (*v)[LANES], const double *dt, double (*c)[LANES]) { prepare_lanes(v, dt, c); }
#endif

typedef struct {
  Instance instance;
  Table constants;
  const double *steps; /* of the record; the present row of `rows` */
  long row, rows;
#ifdef LANES
  double v[N_VALUES][LANES], lengths[LANES], ahead[N_CONSTANTS][LANES]; /* constants of the next rows */
#endif
  double rings[2 * SLOTS * N_DELAYED_OR_1]; /* never touched, so not in memory, if nothing is delayed */
} Run;

/* The length of the model's own steps in `span` seconds. */
static double piece_of(double span, double largest, double *count) {
  *count = largest < INFINITY ? ceil(span / largest - NOW) : 1.0;
  if (*count < 1.0) *count = 1.0;
  return span / *count;
}

#ifdef LANES
/* The constants for `dt` and for the steps of the next rows. */
WIDEST static void look_ahead(Run *run, double dt) {
  const double largest = largest_step(run->instance.v);
  double count;
  for (int k = 0; k < LANES; k++)
    run->lengths[k] = k && run->row + k < run->rows - 1 ? piece_of(run->steps[run->row + k], largest, &count) : dt;
  lanes_prepare(run->v, run->lengths, run->ahead);
  LEAVE_VECTORS;
}
#endif

static inline Constants *constants_for(void *m, double dt) {
  Run *run = m;
  Constants *own = (Constants *)entry_of(&run->constants, dt);
#ifdef LANES
  if (!(own->dt == dt)) {
    int k = 0;
    while (k < LANES && !(run->lengths[k] == dt)) k++;
    if (k == LANES) look_ahead(run, dt), k = 0;
    for (int i = 0; i < N_CONSTANTS; i++) own->c[i] = run->ahead[i][k];
    own->dt = dt;
  }
#endif
  return own;
}

/* A run settled on the first row of inputs, without tangents where it is `plain`; NULL: no memory. */
ONCE void *begin(const double *parameters, const double *first, int plain) {
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
#ifdef LANES
  for (int k = 0; k < LANES; k++) {
    for (int i = 0; i < N_VALUES; i++) run->v[i][k] = m->v[i];
    run->lengths[k] = NAN;
  }
#endif
  return run;
}

/* The rows from `first` to before `end` of `count`. inputs: rows of N_INPUTS; steps: the lengths [s] from row to row, under the
 * inputs of the row, one less than rows; late: as run_row(); outputs: from `first`, rows of N_OUTPUTS, sampled at each row before
 * its inputs act; tangents: of each output rows of N_WRT, or NULL. */
int proceed(void *of, const double *inputs, const double *steps, double late, long first, long end, long count, double *outputs,
            double *const *tangents) {
  Run *run = of;
  Instance *m = &run->instance;
  run->steps = steps;
  run->rows = count;
  for (long row = first; row < end; row++) {
    run->row = row;
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

/* LANES runs side by side, which take the same steps. */
typedef struct {
  double v[N_VALUES][LANES], largest;
  Table constants;
} Lanes;

/* Rows that all runs do before the next rows: their outputs, a strip of each row's, fit into a core's cache. */
#define STRETCH 32

/* Start from parameters (LANES x N_PARAMETERS). 0: the largest steps differ, so the runs would take different steps; or there is no
 * memory. */
ONCE static int lanes_begin(Lanes *m, const double *parameters, const double *first) {
  double own[N_VALUES] = {0}, tangents[N_TANGENTS];
  for (int k = 0; k < LANES; k++) {
    memcpy(own, first, N_INPUTS * sizeof *first);
    memcpy(own + N_INPUTS + N_OUTPUTS, parameters + k * N_PARAMETERS, N_PARAMETERS * sizeof *parameters);
    start(own, tangents);
    for (int i = 0; i < N_VALUES; i++) m->v[i][k] = own[i];
    if (k && largest_step(own) != m->largest) return 0;
    m->largest = largest_step(own);
  }
  return table_begins(&m->constants, sizeof(LaneConstants));
}

/* Advance by `span` seconds. */
WIDEST static void lanes_advance(Lanes *m, double (*v)[LANES], double span) {
  double count;
  const double piece = piece_of(span, m->largest, &count);
  LaneConstants *at = (LaneConstants *)entry_of(&m->constants, piece);
  if (!(at->dt == piece)) {
    double lengths[LANES];
    for (int k = 0; k < LANES; k++) lengths[k] = piece;
    lanes_prepare(v, lengths, at->c);
    at->dt = piece;
  }
  for (double i = 0.0; i < count; i += 1.0) step_lanes(v, at->c);
}

/* The rows from `first` to before `end` of n. outputs: of all rows, N_OUTPUTS x n rows of LANES, `stride` numbers from row to row. */
WIDEST static void lanes_proceed(Lanes *m, const double *inputs, const double *steps, double late, long first, long end, long n,
                                 long stride, double *outputs) {
  _Alignas(64) double v[N_VALUES][LANES]; /* vectors that span two cache lines take twice as long */
  memcpy(v, m->v, sizeof v);
  for (long row = first; row < end; row++) {
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
      lanes_advance(m, v, late * span);
      span *= 1.0 - late;
    }
    for (int i = 0; i < N_INPUTS; i++)
      for (int k = 0; k < LANES; k++) v[i][k] = held[i];
    lanes_advance(m, v, span);
  }
  memcpy(m->v, v, sizeof v);
  LEAVE_VECTORS;
}

/* A whole record for groups x LANES sets of parameters, as proceed() runs each. inputs, steps: of n rows. outputs: N_OUTPUTS x n
 * rows of groups x LANES. done (groups): whether the group's outputs are there; see lanes_begin(). */
ONCE void side_by_side(const double *parameters, long groups, const double *inputs, const double *steps, double late, long n,
                  double *outputs, char *done) {
  Lanes *all = calloc(groups, sizeof *all);
  for (long g = 0; g < groups; g++) done[g] = all && lanes_begin(all + g, parameters + g * LANES * N_PARAMETERS, inputs);
  for (long first = 0; first < n; first += STRETCH)
    for (long g = 0; g < groups; g++)
      if (done[g])
        lanes_proceed(all + g, inputs, steps, late, first, first + STRETCH < n ? first + STRETCH : n, n, groups * LANES,
                      outputs + g * LANES);
  for (long g = 0; all && g < groups; g++) free(all[g].constants.entries);
  free(all);
}
#endif
