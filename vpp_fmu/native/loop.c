/* vpp_fmu/loop.py for compiled parts: plant, measurement chain and controller over a profile, for many sets of parameters. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define DONE 0
#define NO_MEMORY 1
#define DELAY_FULL 2

#define SAMPLE 3 /* thrust, omega, beta */

typedef struct {
  long (*size)(void);
  void (*begin)(void *memory, const double *parameters, const double *inputs, double *outputs);
  int (*advance)(void *memory, const double *inputs, double span, double *outputs);
} Part;

typedef struct {
  long points;          /* communication points */
  double dt, scale;     /* s between them; N that errors are divided by */
  double jump;          /* N; smaller changes of `wanted` are no steps */
  const double *wanted; /* (points) N */
  const double *noise;  /* (points) N */
  const double *rest;   /* the plant's inputs at rest; constant from the third on */
  long inputs;          /* number of the plant's inputs */
} Profile;

/* One loop. `rows`: points x (omega_ref, beta_ref, thrust, omega, beta), or NULL. `merits`: the integral of the squared error
 * over `scale`, and the largest overshoot of a step of the wanted thrust as a share of it. */
static int run_loop(const Part *parts, void *const *memory, const double *const *sets, const Profile *p, double *merits,
                    double *rows) {
  const Part *plant = parts, *chain = parts + 1, *controller = parts + 2;
  double held[p->inputs], sample[SAMPLE], seen[2], reading, given[2];
  double sum = 0.0, change = 0.0, over = 0.0;
  memcpy(held, p->rest, p->inputs * sizeof *held);
  plant->begin(memory[0], sets[0], held, sample);
  seen[0] = sample[0], seen[1] = 0.0;
  chain->begin(memory[1], sets[1], seen, &reading);
  given[0] = p->wanted[0], given[1] = reading;
  controller->begin(memory[2], sets[2], given, held); /* its first sample replaces them before they act */
  for (long k = 0; k < p->points; k++) {
    seen[0] = sample[0], seen[1] = p->noise[k];
    chain->advance(memory[1], seen, p->dt, &reading);
    given[0] = p->wanted[k], given[1] = reading;
    controller->advance(memory[2], given, p->dt, held);
    if (rows) {
      memcpy(rows, held, 2 * sizeof *rows);
      memcpy(rows + 2, sample, SAMPLE * sizeof *rows);
      rows += 2 + SAMPLE;
    }
    if (k && p->wanted[k] != p->wanted[k - 1]) {
      change = p->wanted[k] - p->wanted[k - 1];
      if (fabs(change) < p->jump) change = 0.0;
    }
    if (change != 0.0 && (sample[0] - p->wanted[k]) / change > over) over = (sample[0] - p->wanted[k]) / change;
    if (k + 1 == p->points) break;
    const double e = (p->wanted[k] - sample[0]) / p->scale;
    sum += e * e;
    if (!isfinite(sum) && !rows) break;
    if (!plant->advance(memory[0], held, p->dt, sample)) return DELAY_FULL;
  }
  merits[0] = isfinite(sum) ? sum * p->dt : INFINITY;
  merits[1] = isfinite(sum) ? over : INFINITY;
  return DONE;
}

/* `count` loops. sets: of plant, chain, controller; strides: numbers from one loop's set to the next's, 0: all share it.
 * merits: a pair a loop; rows: as in run_loop, for one loop alone. */
int run_loops(const Part *parts, const double *const *sets, const long *strides, long count, const Profile *profile,
              double *merits, double *rows) {
  void *memory[3] = {NULL, NULL, NULL};
  int code = DONE;
  for (int i = 0; i < 3; i++)
    if (!(memory[i] = malloc(parts[i].size()))) code = NO_MEMORY;
  for (long n = 0; n < count && code == DONE; n++) {
    const double *own[3];
    for (int i = 0; i < 3; i++) own[i] = sets[i] + n * strides[i];
    code = run_loop(parts, memory, own, profile, merits + 2 * n, rows);
  }
  for (int i = 0; i < 3; i++) free(memory[i]);
  return code;
}
