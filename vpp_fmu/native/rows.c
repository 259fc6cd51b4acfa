/* Advance by a row of a record, for models whose commands may act after a share of the row. Comes after schedule.c.
 * COMMANDED: whether each input is a command. */

#include <string.h>

static int advance(Instance *m, double span) {
  if (!SAMPLED) return run_held(m, span);
  run_sampled(m, span);
  return 1;
}

/* Advance by a row of `span` seconds under its `inputs`. If a command differs from that of the row before, which is before it in
 * memory, the previous commands act for the share `late` of the row. 1: done; 0: a delay has no room for more changes. */
static int run_row(Instance *m, const double *inputs, double span, double late) {
  memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
  if (late > 0.0) {
    int moved = 0;
    for (int i = 0; i < N_INPUTS; i++)
      if (COMMANDED[i]) {
        m->v[i] = inputs[i - N_INPUTS];
        moved |= m->v[i] != inputs[i];
      }
    if (moved) {
      if (!advance(m, late * span)) return 0;
      memcpy(m->v, inputs, N_INPUTS * sizeof *inputs);
      return advance(m, (1.0 - late) * span);
    }
  }
  return advance(m, span);
}
