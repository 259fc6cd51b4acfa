/* The part of FMI 3.0's C interface that co-simulation needs: types, callbacks, exported names.
 *
 * Included here so that an FMU's sources compile without other files. Names are the standard's. */

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

/* If the sources of several FMUs are linked into one program, each has a prefix. A shared library has none. */
#ifdef FMI3_FUNCTION_PREFIX
#define PASTE(a, b) a##b
#define PREFIXED(a, b) PASTE(a, b)
#define FMI(type, name) EXPORT type PREFIXED(FMI3_FUNCTION_PREFIX, fmi3##name)
#else
#define FMI(type, name) EXPORT type fmi3##name
#endif

typedef void *fmi3Instance;
typedef void *fmi3FMUState;
typedef uint32_t fmi3ValueReference;
typedef double fmi3Float64;
typedef int32_t fmi3Int32;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef bool fmi3Clock;

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum { fmi3Independent, fmi3Constant, fmi3Fixed, fmi3Tunable, fmi3Discrete, fmi3Dependent } fmi3DependencyKind;
typedef enum { fmi3IntervalNotYetKnown, fmi3IntervalUnchanged, fmi3IntervalChanged } fmi3IntervalQualifier;

typedef void (*fmi3LogMessageCallback)(void *environment, fmi3Status status, fmi3String category, fmi3String message);

typedef fmi3LogMessageCallback Logger;

#define ENUMERATIONS_AS ENUMERATION /* they have the calls of 64-bit integers */

/* Send one message to the importer. FMI 3.0 passes no instance name: the environment identifies the instance. */
static void deliver(Logger logger, void *environment, const char *name, int status, const char *category, const char *text) {
  (void)name;
  logger(environment, (fmi3Status)status, category, text);
}
