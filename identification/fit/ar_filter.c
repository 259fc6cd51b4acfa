/* Residuals of columns (n, k), row by row: each value is divided by `scale`; for each span, `factor` times the sum over earlier
   rows is subtracted. `ends`: first and last lag of each span. `sums` (n + 1, k): room for running sums, NULL if each span has one
   row. The operations have the same order as by_numpy in ar_filter.py, so the bits are the same. */

enum { PART = 512 };

void ar_residuals(const double *x, long n, long k, long order, long spans, const long (*ends)[2], const double *factor, double scale,
               double *sums, double *residuals) {
    if (sums) {
        for (long i = 0; i < k; i++) sums[i] = 0.0;
        for (long i = 0; i < n * k; i++) sums[i + k] = sums[i] + x[i];
    }
    long end = (n - order) * k;
    for (long from = 0; from < end; from += PART) {
        long count = end - from < PART ? end - from : PART;
        double *restrict part = residuals + from;
        const double *now = x + from + order * k;
        for (long i = 0; i < count; i++) part[i] = now[i] / scale;
        for (long s = 0; s < spans; s++) {
            long first = ends[s][0], last = ends[s][1];
            double by = factor[s];
            if (first == last) {
                const double *earlier = now - first * k;
                for (long i = 0; i < count; i++) part[i] -= earlier[i] * by;
            } else {
                const double *upper = sums + from + (order - first + 1) * k, *lower = sums + from + (order - last) * k;
                for (long i = 0; i < count; i++) part[i] -= (upper[i] - lower[i]) * by;
            }
        }
    }
}
