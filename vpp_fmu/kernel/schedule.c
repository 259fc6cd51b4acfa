/* schedule.py in C: the same arithmetic in the same order. See there for what it does and why.
 *
 * Comes after the generated model, which defines the sizes N_INPUTS, N_DELAYED, N_WRT and the functions prepare(), step(),
 * largest_step(); `v` holds all values (inputs, outputs, parameters, states), `c` what prepare() made of parameters and dt,
 * `d` the tangents of states and outputs. With sensitivities a delay moves the ends of pieces: `ends[k]` is the tangent of
 * a piece's end, one-hot in the delay's parameter, and a step's length has the difference of its two ends' tangents. */

#define NOW 1e-9

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

static void delay_act(DelayLine *line) {
  while (line->count && line->waits[line->head] <= NOW) {
    const double left = line->waits[line->head];
    line->acting = line->values[line->head];
    line->head = (line->head + 1) % line->slots;
    line->count--;
    if (line->count) line->waits[line->head] += left;
  }
}

static void delay_pass_time(DelayLine *line, double piece) {
  if (line->count) {
    line->waits[line->head] -= piece;
    line->span -= piece;
  }
}

typedef struct {
  double v[N_VALUES];
  double c[N_CONSTANTS];
  double d[N_TANGENTS];
  double dt, dt_tangent[N_DELAYED_OR_1]; /* what `c` was prepared for */
  double wait;
  DelayLine lines[N_DELAYED_OR_1];
} Instance;

static void take_step(Instance *m, double dt, const double *dt_tangent) {
  int stale = !(dt == m->dt);
  for (int k = 0; k < N_DELAYED; k++) stale |= !(dt_tangent[k] == m->dt_tangent[k]);
  if (stale) {
    prepare(m->v, dt, dt_tangent, m->c);
    m->dt = dt;
    for (int k = 0; k < N_DELAYED; k++) m->dt_tangent[k] = dt_tangent[k];
  }
  step(m->v, m->c, m->d);
}

/* Advance by `span` under the inputs that stand in m->v. 1: done; 0: a delay has no room for more changes. */
static int run_held(Instance *m, double span) {
  double wanted[N_DELAYED_OR_1];
  double ends[N_DELAYED_OR_1] = {0}, tangent[N_DELAYED_OR_1] = {0};
  for (int k = 0; k < N_DELAYED; k++) {
    wanted[k] = m->v[DELAYED_INPUT[k]];
    if (!delay_push(&m->lines[k], wanted[k], m->v[DELAY_PARAMETER[k]])) return 0;
  }
  const double largest = largest_step(m->v);
  double left = span;
  for (;;) {
    double piece = left;
    int cut = -1;
    for (int k = 0; k < N_DELAYED; k++) {
      delay_act(&m->lines[k]);
      m->v[DELAYED_INPUT[k]] = m->lines[k].acting;
      if (m->lines[k].count && m->lines[k].waits[m->lines[k].head] < piece - NOW) {
        piece = m->lines[k].waits[m->lines[k].head];
        cut = k;
      }
    }
    double count = 1.0;
    if (!isinf(largest)) {
      count = ceil(piece / largest - NOW);
      if (count < 1.0) count = 1.0;
    }
    for (int k = 0; k < N_DELAYED; k++) {
      const double end = k == cut ? 1.0 : 0.0;
      tangent[k] = (end - ends[k]) / count;
      ends[k] = end;
    }
    for (double i = 0.0; i < count; i += 1.0) take_step(m, piece / count, tangent);
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
