/* vpp_fmu/loop.py for two FMI 2.0 instances, called through their entry points: in Python most of a step is overhead. */

#include <stddef.h>

typedef struct {
  void *instance;
  int (*set)(void *instance, const unsigned *references, size_t count, const double *values);
  int (*step)(void *instance, double time, double size, int no_return);
  int (*get)(void *instance, const unsigned *references, size_t count, double *values);
  const unsigned *inputs, *outputs;
  size_t n_inputs, n_outputs;
  double *given, *shown; /* values of inputs and of present outputs */
} Side;

#define WARNING 1

static int take(const Side *side, double time, double dt) {
  int status = side->set(side->instance, side->inputs, side->n_inputs, side->given);
  if (status <= WARNING) status = side->step(side->instance, time, dt, 1);
  if (status <= WARNING) status = side->get(side->instance, side->outputs, side->n_outputs, side->shown);
  return status;
}

/* Communication points `from` to `to` of `count`. sides: controller (wanted, thrust -> commands), plant (commands -> thrust ...).
 * rows: commands and plant outputs at each point. `side`: the one that failed; returns its status, or 0. The point
 * reached is written to `at`. */
int run_master(const Side *sides, const double *wanted, double dt, long from, long to, long count, double *rows, long *at,
               int *side) {
  const Side *controller = sides, *plant = sides + 1;
  const size_t width = controller->n_outputs + plant->n_outputs;
  for (long k = from; k < to; k++) {
    double *row = rows + width * k;
    *at = k;
    *side = 0;
    controller->given[0] = wanted[k];
    controller->given[1] = plant->shown[0];
    int status = take(controller, k * dt, dt);
    if (status > WARNING) return status;
    for (size_t i = 0; i < controller->n_outputs; i++) row[i] = plant->given[i] = controller->shown[i];
    for (size_t i = 0; i < plant->n_outputs; i++) row[controller->n_outputs + i] = plant->shown[i];
    if (k + 1 == count) break;
    *side = 1;
    status = take(plant, k * dt, dt);
    if (status > WARNING) return status;
  }
  return 0;
}
