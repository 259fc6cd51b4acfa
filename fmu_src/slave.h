/* One instance of an FMU. Comes after the generated model and its tables, and after schedule.c. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define FIRST_PARAMETER (N_INPUTS + N_OUTPUTS)
#define FIRST_STATE (FIRST_PARAMETER + N_PARAMETERS)
#define N_CARRIED (N_PARAMETERS + N_INPUTS)
#define N_CARRIED_OR_1 (N_CARRIED ? N_CARRIED : 1)
#define MESSAGE 512

/* Instances share no data and each can be reset, so there is no fatal state. */
typedef enum { OK, WARNED, DISCARDED, REFUSED } Status; /* numbered as both versions of the standard do */

typedef struct {
  Instance m; /* first: schedule.c's functions get a pointer to it only */
  int state;
  bool settled;                  /* outputs and states correspond to the present inputs and parameters */
  bool chosen[N_STATES_OR_1];    /* the importer has set this state; it is not settled on the inputs */
  double time, last;             /* the communication point reached, the step to it, s */
  double (*carried)[N_VALUES];   /* the tangent of each parameter, then of each input, or NULL */
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
  s->m.kept[0].dt = NAN; /* nothing is prepared */
}
