/* One instance of an FMU. Comes after the generated model and its tables, and after schedule.c. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FIRST_PARAMETER (N_INPUTS + N_OUTPUTS)
#define FIRST_STATE (FIRST_PARAMETER + N_PARAMETERS)
#define MESSAGE 512

/* Instances share nothing, so nothing that befalls one can harm another, and each can be reset: there is no fatal state. */
typedef enum { OK, WARNED, DISCARDED, REFUSED } Status; /* numbered as both versions of the standard do */

typedef struct {
  Instance m; /* first: schedule.c's steps know no more of a slave */
  int state;
  bool settled;                  /* outputs and states are those of the inputs and parameters that stand now */
  bool chosen[N_STATES_OR_1];    /* this state begins where it was set to, not where the inputs settle it */
  double time;                   /* the communication point reached, s */
  double (*carried)[N_VALUES];   /* the tangent of each parameter, or NULL */
  Logger logger;
  void *environment;
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
