/* Of columns (n, k), row after row: each value in units of `scale`, less for each span a factor times the sum over the rows, from
   the first to the last before it, that the span's `ends` name. `sums` (n + 1, k): room for running sums, where a span holds more
   than one row. The order of operations is that of ar_filter.py with numpy, and so are the bits. */

enum { PART = 512 };

void ar_residuals(const double *x, long n, long k, long order, long spans, const long (*ends)[2], const double *factor, double scale,
               double *sums, double *left) {
    if (sums) {
        for (long i = 0; i < k; i++) sums[i] = 0.0;
        for (long i = 0; i < n * k; i++) sums[i + k] = sums[i] + x[i];
    }
    long end = (n - order) * k;
    for (long from = 0; from < end; from += PART) {
        long count = end - from < PART ? end - from : PART;
        double *restrict part = left + from;
        const double *now = x + from + order * k;
        for (long i = 0; i < count; i++) part[i] = now[i] / scale;
        for (long s = 0; s < spans; s++) {
            long first = ends[s][0], last = ends[s][1];
            double by = factor[s];
            if (first == last) {
                const double *past = now - first * k;
                for (long i = 0; i < count; i++) part[i] -= past[i] * by;
            } else {
                const double *upper = sums + from + (order - first + 1) * k, *lower = sums + from + (order - last) * k;
                for (long i = 0; i < count; i++) part[i] -= (upper[i] - lower[i]) * by;
            }
        }
    }
}
