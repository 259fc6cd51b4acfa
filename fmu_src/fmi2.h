/* The part of FMI 2.0's C interface that co-simulation needs: types, statuses, callbacks, exported names.
 *
 * Included here so that an FMU's sources compile without other files. Names are the standard's. */

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

/* If the sources of several FMUs are linked into one program, each has a prefix. A shared library has none. */
#ifdef FMI2_FUNCTION_PREFIX
#define PASTE(a, b) a##b
#define PREFIXED(a, b) PASTE(a, b)
#define FMI(type, name) EXPORT type PREFIXED(FMI2_FUNCTION_PREFIX, fmi2##name)
#else
#define FMI(type, name) EXPORT type fmi2##name
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

/* `message` is a format for printf. */
typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                                   fmi2String category, fmi2String message, ...);

typedef struct {
  fmi2CallbackLogger logger;
  void *(*allocateMemory)(size_t count, size_t size);
  void (*freeMemory)(void *memory);
  void (*stepFinished)(fmi2ComponentEnvironment environment, fmi2Status status);
  fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

typedef fmi2CallbackLogger Logger;

#define ENUMERATIONS_AS INTEGER /* they have no calls of their own */

/* Send one message to the importer. `%` is doubled, because the logger reads the message as a format. */
static void deliver(Logger logger, void *environment, const char *name, int status, const char *category, const char *text) {
  char safe[2 * 512], *at = safe;
  for (const char *c = text; *c && at < safe + sizeof safe - 2; c++) {
    if (*c == '%') *at++ = '%';
    *at++ = *c;
  }
  *at = '\0';
  logger(environment, name, (fmi2Status)status, category, safe);
}
