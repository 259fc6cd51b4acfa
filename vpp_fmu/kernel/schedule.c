/* schedule.py in C: the same arithmetic in the same order. It is explained there.
 *
 * Comes after the generated model, which defines the sizes N_INPUTS, N_DELAYED, N_SAMPLED, N_WRT and the functions prepare(), step(),
 * largest_step() and, with tangents, step_values(). `v` holds all values (inputs, outputs, parameters, states), `c` the
 * constants that prepare() computes from parameters and dt, `d` the tangents of states and outputs. */

#include <string.h>

#define NOW 1e-9
#define SLOTS 4096
#define PIECES 100000
#define LONGEST_EXACT 1e5
#define NUDGE 1e-7 /* s; short enough for a derivative at an instant, long enough to keep its digits */

typedef struct {
  double *waits, *values; /* a ring of `slots` changes, the oldest at `head` */
  int slots, head, count;
  double acting, latest, span;
} DelayLine;

static void delay_start(DelayLine *line, double value) {
  line->acting = line->latest = value;
  line->head = line->count = 0;
  line->span = 0.0;
}

/* 1: done; 0: no room */
static int delay_push(DelayLine *line, double value, double delay) {
  if (value == line->latest) return 1;
  if (line->count == line->slots) return 0;
  const int at = (line->head + line->count) % line->slots;
  line->waits[at] = line->count ? delay - line->span : delay;
  line->values[at] = value;
  line->count++;
  line->latest = value;
  line->span = delay;
  return 1;
}

static int delay_act(DelayLine *line) {
  int changed = 0;
  while (line->count && line->waits[line->head] <= NOW) {
    const double left = line->waits[line->head];
    line->acting = line->values[line->head];
    line->head = (line->head + 1) % line->slots;
    line->count--;
    if (line->count) line->waits[line->head] += left;
    changed = 1;
  }
  return changed;
}

static void delay_pass_time(DelayLine *line, double piece) {
  if (line->count) {
    line->waits[line->head] -= piece;
    line->span -= piece;
  }
}

/* The constants that prepare() computes for a step length and its tangents. */
typedef struct {
  double dt, dt_tangent[N_DELAYED_OR_1];
  double c[N_CONSTANTS];
} Constants;

#ifdef KEEPS_LENGTHS /* where the constants of a step length are kept: simulate.c has a table, an FMU keeps the last ones */
static Constants *constants_for(void *m, double dt);
#else
#define constants_for(m, dt) ((m)->kept)
#endif

typedef struct {
  double v[N_VALUES];
  double d[N_TANGENTS];
  double wait;
  int nudging; /* the present step is half of a nudge, not part of the run */
  int plain;   /* only values are computed, no tangents */
  DelayLine lines[N_DELAYED_OR_1];
  Constants kept[1];
} Instance;

#ifdef OBSERVED /* before_step() is called before every step, to advance the caller's own tangents or to record the step */
static int is_observed(const Instance *m);
static void before_step(Instance *m, double dt, const double *dt_tangent);
#else
#define is_observed(m) (N_WRT && !(m)->plain)
#define before_step(m, dt, dt_tangent)
#endif

static void take_step(Instance *m, double dt, const double *dt_tangent) {
  Constants *own = constants_for(m, dt);
  int stale = !(dt == own->dt);
  for (int k = 0; k < N_DELAYED; k++) stale |= !(dt_tangent[k] == own->dt_tangent[k]);
  if (stale) {
    prepare(m->v, dt, dt_tangent, own->c);
    own->dt = dt;
    for (int k = 0; k < N_DELAYED; k++) own->dt_tangent[k] = dt_tangent[k];
  }
  before_step(m, dt, dt_tangent);
#if N_WRT
  if (m->plain) {
    step_values(m->v, own->c);
    return;
  }
#endif
  step(m->v, own->c, m->d);
}

/* The delay k determines when the input changes from `old` to the acting one. Its tangents gain the difference between the
 * time derivatives under the two inputs, from trial steps of NUDGE seconds. Values do not change. */
static void nudge(Instance *m, int k, double old) {
#if N_DELAYED && (N_WRT || defined(OBSERVED))
  const double acting = m->v[DELAYED_INPUT[k]];
  double kept[N_VALUES], tangents[N_TANGENTS], gained[N_TANGENTS] = {0}, along[N_DELAYED] = {0};
  memcpy(kept, m->v, sizeof kept);
  memcpy(tangents, m->d, sizeof tangents);
  m->nudging = 1;
  for (int after = 0; after < 2; after++) {
    memset(m->d, 0, sizeof m->d);
    m->v[DELAYED_INPUT[k]] = after ? acting : old;
    along[k] = after ? -1.0 : 1.0;
    take_step(m, NUDGE, along);
    for (int i = 0; i < N_TANGENTS; i++) gained[i] += m->d[i];
    memcpy(m->v, kept, sizeof kept);
  }
  m->nudging = 0;
  memcpy(m->d, tangents, sizeof tangents);
#if N_WRT
  if (DELAY_COLUMN[k] >= 0)
    for (int i = DELAY_COLUMN[k]; i < N_TANGENTS; i += N_WRT) m->d[i] += gained[i];
#endif
#else
  (void)m, (void)k, (void)old;
#endif
}

/* Advance by `span` under the inputs in m->v. 1: done; 0: a delay has no room for more changes. */
static int run_held(Instance *m, double span) {
  static const double no_tangent[N_DELAYED_OR_1] = {0};
  double wanted[N_DELAYED_OR_1], before[N_DELAYED_OR_1];
  int began[N_DELAYED_OR_1];
  for (int k = 0; k < N_DELAYED; k++) {
    wanted[k] = m->v[DELAYED_INPUT[k]];
    if (!delay_push(&m->lines[k], wanted[k], m->v[DELAY_PARAMETER[k]])) return 0;
  }
  const double largest = largest_step(m->v);
  double left = span;
  for (;;) {
    double piece = left;
    for (int k = 0; k < N_DELAYED; k++) {
      before[k] = m->lines[k].acting;
      began[k] = delay_act(&m->lines[k]);
      m->v[DELAYED_INPUT[k]] = m->lines[k].acting;
      if (m->lines[k].count && m->lines[k].waits[m->lines[k].head] < piece - NOW)
        piece = m->lines[k].waits[m->lines[k].head];
    }
    for (int k = 0; k < N_SAMPLED; k++) {
      const double wait = m->v[SAMPLE_STATE[k]];
      const double next = wait < NOW ? wait + m->v[SAMPLE_PERIOD[k]] : wait;
      if (next < piece - NOW) piece = next;
    }
    for (int k = 0; k < N_DELAYED; k++)
      if (began[k] && is_observed(m)) nudge(m, k, before[k]);
    double count = 1.0;
    if (largest < INFINITY) {
      count = ceil(piece / largest - NOW);
      if (count < 1.0) count = 1.0;
    }
    for (double i = 0.0; i < count; i += 1.0) take_step(m, piece / count, no_tangent);
    for (int k = 0; k < N_DELAYED; k++) delay_pass_time(&m->lines[k], piece);
    left -= piece;
    if (left <= NOW) break;
  }
  for (int k = 0; k < N_DELAYED; k++) m->v[DELAYED_INPUT[k]] = wanted[k];
  return 1;
}

static void run_sampled(Instance *m, double span) {
  static const double no_tangent[N_DELAYED_OR_1] = {0};
  const double period = m->v[SAMPLE_TIME];
  while (m->wait < span - NOW) {
    take_step(m, period, no_tangent);
    m->wait += period;
  }
  m->wait -= span;
  if (fabs(m->wait) <= NOW) m->wait = 0.0;
}
