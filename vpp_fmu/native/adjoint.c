/* The gradient of a weighted sum of a record's outputs, in all parameters at once: record_tape() runs the record and stores
 * the data of every step, pull_back() is the reverse sweep. Comes after the generated model, its adjoints, schedule.c and rows.c.
 *
 * gradient = sum over rows and outputs of cotangent x d output / d parameter. In the reverse sweep `b` holds the cotangents of
 * the present values, `g` those of the constants of prepare(). Consecutive steps of one length share these constants, so their
 * cotangents are summed and pass back through prepare() once. That also gives the cotangent of the length, which contributes
 * to the sample time and, in a nudge (see schedule.c), to a delay. */

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#define NO_MEMORY (-1)
#define DELAY_FULL (-2)

#define FIRST_PARAMETER (N_INPUTS + N_OUTPUTS)
#define FIRST_STATE (FIRST_PARAMETER + N_PARAMETERS)
#define SEEN (N_INPUTS + N_STATES)   /* values that a step reads beside parameters and constants */
#define ENTRY (SEEN + 1 + N_DELAYED) /* and its length, with the length's tangent in each delay */

typedef struct {
  Instance m;
  double *tape;
  long room, entries;
} Recorder;

_Static_assert(offsetof(Recorder, m) == 0, "a pointer to the instance is one to the recorder");

static int is_observed(const Instance *m) {
  (void)m;
  return 1;
}

/* Counts also when the tape is full, so that the caller learns its required length. */
static void before_step(Instance *m, double dt, const double *dt_tangent) {
  Recorder *r = (Recorder *)m;
  if (r->entries < r->room) {
    double *entry = r->tape + r->entries * ENTRY;
    memcpy(entry, m->v, N_INPUTS * sizeof *entry);
    memcpy(entry + N_INPUTS, m->v + FIRST_STATE, N_STATES * sizeof *entry);
    entry[SEEN] = m->nudging ? -dt : dt;
    memcpy(entry + SEEN + 1, dt_tangent, N_DELAYED * sizeof *entry);
  }
  r->entries++;
}

/* inputs, steps, late, outputs as in simulate.c; tape: room for `room` entries; taken (n): entries before each row.
 * Returns how many entries there are, which may be more than there was room for; or NO_MEMORY, DELAY_FULL. */
long record_tape(const double *parameters, const double *inputs, const double *steps, double late, long n, double *outputs,
                 double *tape, long room, long *taken) {
  Recorder r = {.tape = tape, .room = room};
  Instance *m = &r.m;
  double *rings = N_DELAYED ? malloc(2 * (size_t)SLOTS * N_DELAYED_OR_1 * sizeof *rings) : NULL;
  if (N_DELAYED && !rings) return NO_MEMORY;
  memcpy(m->v + FIRST_PARAMETER, parameters, N_PARAMETERS * sizeof *parameters);
  memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
  for (int k = 0; k < N_DELAYED; k++) {
    m->lines[k].waits = rings + 2 * (size_t)SLOTS * k;
    m->lines[k].values = m->lines[k].waits + SLOTS;
    m->lines[k].slots = SLOTS;
    delay_start(&m->lines[k], m->v[DELAYED_INPUT[k]]);
  }
  start(m->v, m->d);
  int done = 1;
  for (long row = 0; done; row++) {
    memcpy(outputs + row * N_OUTPUTS, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
    taken[row] = r.entries;
    if (row == n - 1) break;
    done = run_row(m, inputs + row * N_INPUTS, steps[row], row ? late : 0.0);
  }
  free(rings);
  return done ? r.entries : DELAY_FULL;
}

typedef struct {
  double v[N_VALUES], b[N_VALUES];
  double c[N_CONSTANTS], g[N_CONSTANTS];
  const double *length; /* of the steps whose cotangents `g` sums: dt and its tangents, on the tape; NULL: none yet */
} Way;

static void settle(Way *w) {
  if (!w->length) return;
  const double b_dt = prepare_back(w->v, w->length[0], w->g, w->b);
  for (int k = 0; k < N_DELAYED; k++) w->b[DELAY_PARAMETER[k]] += b_dt * w->length[1 + k];
  memset(w->g, 0, sizeof w->g);
}

/* Half of a nudge, marked by a negative length. It contributes to the delay only, because it is not part of the run. */
static void back_over_nudge(const Way *w, const double *entry, double *b) {
  Way alone = *w;
  const double *along = entry + SEEN + 1;
  const double dt = -entry[SEEN];
  prepare(alone.v, dt, along, alone.c);
  memset(alone.g, 0, sizeof alone.g);
  memset(alone.b, 0, FIRST_STATE * sizeof *alone.b);
  memcpy(alone.v, entry, N_INPUTS * sizeof *entry);
  memcpy(alone.v + FIRST_STATE, entry + N_INPUTS, N_STATES * sizeof *entry);
  step_back(alone.v, alone.c, alone.b, alone.g);
  const double b_dt = prepare_back(alone.v, dt, alone.g, alone.b);
  for (int k = 0; k < N_DELAYED; k++) b[DELAY_PARAMETER[k]] += b_dt * along[k];
}

static void back_over(Way *w, const double *entry) {
  const double *length = entry + SEEN;
  if (length[0] < 0.0) {
    back_over_nudge(w, entry, w->b);
    return;
  }
  if (!w->length || memcmp(length, w->length, (1 + N_DELAYED) * sizeof *length)) {
    settle(w);
    prepare(w->v, length[0], length + 1, w->c);
    w->length = length;
  }
  memcpy(w->v, entry, N_INPUTS * sizeof *entry);
  memcpy(w->v + FIRST_STATE, entry + N_INPUTS, N_STATES * sizeof *entry);
  step_back(w->v, w->c, w->b, w->g);
}

/* inputs: the first row's; tape, taken: as record_tape() left them; cotangents: n rows of N_OUTPUTS;
 * gradient (N_PARAMETERS). */
void pull_back(const double *parameters, const double *inputs, long n, const double *tape, const long *taken,
               const double *cotangents, double *gradient) {
  Way w = {.length = NULL};
  memcpy(w.v + FIRST_PARAMETER, parameters, N_PARAMETERS * sizeof *parameters);
  long entry = taken[n - 1];
  for (long row = n - 1; row >= 0; row--) {
    while (entry > taken[row]) back_over(&w, tape + --entry * ENTRY);
    for (int i = 0; i < N_OUTPUTS; i++) w.b[N_INPUTS + i] += cotangents[row * N_OUTPUTS + i];
  }
  settle(&w);
  memcpy(w.v, inputs, N_INPUTS * sizeof *inputs);
  start_back(w.v, w.b);
  memcpy(gradient, w.b + FIRST_PARAMETER, N_PARAMETERS * sizeof *gradient);
}
