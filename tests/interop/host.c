/* A host without Python: one instance of an FMU for FMI 2.0, stepped with its first input at VALUE (nan: it has none); prints
 * the Real variables of these references as they are at the end, and if TIMED is set the time of a step.
 *
 *   host LIBRARY GUID RESOURCES VALUE STEPS STEP REFERENCE... */

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

typedef struct {
  void (*logger)(void *, const char *, int, const char *, const char *, ...);
  void *(*allocate)(size_t, size_t);
  void (*release)(void *);
  void *finished, *environment;
} Callbacks;

static void say(void *environment, const char *name, int status, const char *category, const char *text, ...) {
  (void)environment, (void)name, (void)category;
  if (status > 1) fprintf(stderr, "%s\n", text);
}

static void *library;

static void *function(const char *name) {
  void *found = dlsym(library, name);
  if (!found) fprintf(stderr, "%s\n", dlerror()), exit(3);
  return found;
}

#define CALL(name, types, ...)                                                 \
  do {                                                                         \
    int (*call) types;                                                         \
    *(void **)&call = function("fmi2" name);                                   \
    if (call(__VA_ARGS__)) fprintf(stderr, "fmi2" name " failed\n"), exit(4);  \
  } while (0)

int main(int count, char **given) {
  if (count < 7) return 1;
  const double value = atof(given[4]), step = atof(given[6]);
  const Callbacks callbacks = {say, calloc, free, NULL, NULL};
  void *(*instantiate)(const char *, int, const char *, const char *, const Callbacks *, int, int);
  void (*release)(void *);
  library = dlopen(given[1], RTLD_NOW);
  if (!library) return fprintf(stderr, "%s\n", dlerror()), 2;
  *(void **)&instantiate = function("fmi2Instantiate");
  *(void **)&release = function("fmi2FreeInstance");
  void *c = instantiate("a", 1, given[2], given[3], &callbacks, 0, 1);
  if (!c) return 5;
  CALL("SetupExperiment", (void *, int, double, double, int, double), c, 0, 0.0, 0.0, 0, 0.0);
  CALL("EnterInitializationMode", (void *), c);
  CALL("ExitInitializationMode", (void *), c);
  const unsigned first = 0;
  struct timespec began, ended;
  clock_gettime(CLOCK_MONOTONIC, &began);
  for (int k = 0; k < atoi(given[5]); k++) {
    if (value == value) CALL("SetReal", (void *, const unsigned *, size_t, const double *), c, &first, 1, &value);
    CALL("DoStep", (void *, double, double, int), c, k * step, step, 1);
  }
  clock_gettime(CLOCK_MONOTONIC, &ended);
  if (getenv("TIMED")) fprintf(stderr, "%g us a step\n", (1e6 * (ended.tv_sec - began.tv_sec) + 1e-3 * (ended.tv_nsec - began.tv_nsec)) / atoi(given[5]));
  for (int i = 7; i < count; i++) {
    const unsigned r = (unsigned)strtoul(given[i], NULL, 10);
    double x;
    CALL("GetReal", (void *, const unsigned *, size_t, double *), c, &r, 1, &x);
    printf("%.17g\n", x);
  }
  CALL("Terminate", (void *), c);
  release(c);
  dlclose(library);
  return 0;
}
