/* One instance of an FMU. Comes after the generated model and schedule.c. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FIRST_PARAMETER (N_INPUTS + N_OUTPUTS)
#define FIRST_STATE (FIRST_PARAMETER + N_PARAMETERS)
#define MESSAGE 512

/* The state machine of the standard (2.0.4, section 4.2.4), as bits so that a set of states is a number. There is no fatal
 * one: instances share nothing, so nothing that befalls one can harm another, and each can be reset. */
enum { INSTANTIATED = 1, INITIALISING = 2, STEPPING = 4, TERMINATED = 8, FAILED = 16, ANY = 31 };

enum { DISCARD, ERROR, FATAL, N_CATEGORIES };

typedef struct {
  Instance m; /* first: schedule.c's steps know no more of a slave */
  int state;
  bool settled; /* outputs and states are those of the inputs and parameters that stand now */
  double (*carried)[N_VALUES]; /* the tangent of each parameter, or NULL */
  fmi2CallbackLogger logger;
  fmi2ComponentEnvironment environment;
  bool tells[N_CATEGORIES];
  char *name;
#if N_DELAYED
  double rings[N_DELAYED][2][SLOTS];
#endif
} Slave;

static void start_schedule(Slave *s) {
#if N_DELAYED
  for (int k = 0; k < N_DELAYED; k++) {
    s->m.lines[k].waits = s->rings[k][0];
    s->m.lines[k].values = s->rings[k][1];
    s->m.lines[k].slots = SLOTS;
    delay_start(&s->m.lines[k], s->m.v[DELAYED_INPUT[k]]);
  }
#endif
  s->m.wait = 0.0;
  s->m.dt = NAN; /* nothing is prepared */
}
