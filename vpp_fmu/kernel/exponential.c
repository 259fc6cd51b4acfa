/* exponential.py in C: the same arithmetic in the same order. It is explained there. Overflow is INFINITY. */

#include <string.h>

#ifdef __GNUC__
#define INLINED static inline __attribute__((always_inline))
#else
#define INLINED static inline
#endif

/* 2**k for a whole k of at most some 1000: the last bits of k + 1.5 * 2**52 are k in binary. */
INLINED double power_of_2(double k) {
  const double shifted = k + (6755399441055744.0 + 1023.0);
  unsigned long long bits;
  double two;
  memcpy(&bits, &shifted, sizeof bits);
  bits <<= 52;
  memcpy(&two, &bits, sizeof two);
  return two;
}

INLINED double split(double x, double *k) {
  *k = x * 1.4426950408889634 + 6755399441055744.0 - 6755399441055744.0;
  const double near = x - *k * 6.93147180369123816490e-01, rest = *k * 1.90821492927058770002e-10;
  const double r = near - rest, left = (near - r) - rest, s = r * r, t = s * s;
  const double low = 1.0 / 2.0 + r * (1.0 / 6.0) + s * (1.0 / 24.0 + r * (1.0 / 120.0));
  const double high = 1.0 / 720.0 + r * (1.0 / 5040.0) + s * (1.0 / 40320.0 + r * (1.0 / 362880.0));
  const double top = 1.0 / 3628800.0 + r * (1.0 / 39916800.0) + s * (1.0 / 479001600.0 + r * (1.0 / 6227020800.0));
  return r + (left + s * (low + t * (high + t * top)));
}

INLINED double exp_inlined(double x) {
  double k;
  const double q = split(x, &k), inside = (q + 1.0) * power_of_2(k);
  return x < -700.0 ? 0.0 : x > 700.0 ? INFINITY : inside;
}

INLINED double expm1_inlined(double x) {
  double k;
  const double q = split(x, &k), inside = (q + (1.0 - power_of_2(-k))) * power_of_2(k);
  return x < -700.0 ? -1.0 : x > 700.0 ? INFINITY : inside;
}

/* Where no vectors are made of them: a call is compiled faster. */
#define EXP exp_called
#define EXPM1 expm1_called

APART static double exp_called(double x) { return exp_inlined(x); }

APART static double expm1_called(double x) { return expm1_inlined(x); }
