/* A compiled model as one part of a loop, moved from one communication point to the next. Comes after the generated model and
 * schedule.c; loop.c drives it. `memory` has part_size() bytes. */

typedef struct {
  Instance m;
  double rings[N_DELAYED ? 2 * SLOTS * N_DELAYED : 1];
} Part;

long part_size(void) { return sizeof(Part); }

/* At rest on `inputs`. */
void part_begin(void *memory, const double *parameters, const double *inputs, double *outputs) {
  Part *part = memory;
  Instance *m = &part->m;
  memset(m, 0, sizeof *m);
  memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
  memcpy(m->v + N_INPUTS + N_OUTPUTS, parameters, N_PARAMETERS * sizeof *parameters);
  for (int k = 0; k < N_DELAYED; k++) {
    m->lines[k].waits = part->rings + 2 * SLOTS * k;
    m->lines[k].values = m->lines[k].waits + SLOTS;
    m->lines[k].slots = SLOTS;
    delay_start(&m->lines[k], m->v[DELAYED_INPUT[k]]);
  }
  start(m->v, m->d);
  memcpy(outputs, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
}

/* Hold `inputs` for `span` seconds. 1: done; 0: a delay has no room for more changes. */
int part_advance(void *memory, const double *inputs, double span, double *outputs) {
  Instance *m = &((Part *)memory)->m;
  int done = 1;
  memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
  if (SAMPLED)
    run_sampled(m, span);
  else
    done = run_held(m, span);
  memcpy(outputs, m->v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
  return done;
}
