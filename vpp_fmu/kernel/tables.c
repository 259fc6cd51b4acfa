/* tables.py in C: the same arithmetic in the same order. It is explained there. */

static double piece(double d, double h, double y0, double y1, double m0, double m1, int cubic, int order) {
  const double rise = (y1 - y0) / h;
  if (!cubic) return order == 0 ? y0 + d * rise : order == 1 ? rise : 0.0;
  const double c2 = (3.0 * rise - 2.0 * m0 - m1) / h;
  const double c3 = (m0 + m1 - 2.0 * rise) / (h * h);
  if (order == 0) return y0 + d * (m0 + d * (c2 + d * c3));
  if (order == 1) return m0 + d * (2.0 * c2 + 3.0 * d * c3);
  return order == 2 ? 2.0 * c2 + 6.0 * d * c3 : order == 3 ? 6.0 * c3 : 0.0;
}

/* The interval of x, as Python's bisect_right(xs, x, 1, n - 1) - 1 finds it. */
static int interval(double x, int n, const double *xs) {
  int low = 1, high = n - 1;
  while (low < high) {
    const int middle = (low + high) / 2;
    if (x < xs[middle])
      high = middle;
    else
      low = middle + 1;
  }
  return low - 1;
}

static double look_up(double x, int n, const double *xs, const double *ys, const double *slopes, int order) {
  if (x < xs[0] || x > xs[n - 1]) return order ? 0.0 : x < xs[0] ? ys[0] : ys[n - 1];
  const int i = interval(x, n, xs);
  return piece(x - xs[i], xs[i + 1] - xs[i], ys[i], ys[i + 1], slopes ? slopes[i] : 0.0, slopes ? slopes[i + 1] : 0.0,
               slopes != 0, order);
}

static double look_up_2(double x, double y, int n, const double *xs, int m, const double *ys, const double *grid, int cubic,
                        int order_x, int order_y) {
  if ((order_x && (x < xs[0] || x > xs[n - 1])) || (order_y && (y < ys[0] || y > ys[m - 1]))) return 0.0;
  x = x < xs[0] ? xs[0] : x > xs[n - 1] ? xs[n - 1] : x;
  y = y < ys[0] ? ys[0] : y > ys[m - 1] ? ys[m - 1] : y;
  const int i = interval(x, n, xs), j = interval(y, m, ys), size = n * m;
  double along[2][2] = {{0.0, 0.0}, {0.0, 0.0}}; /* values, and their slopes in x, at both ends of the interval of x */
  for (int first = 0; first <= cubic; first++)
    for (int k = 0; k < 2; k++) {
      const double *at = grid + first * size + (i + k) * m + j;
      along[first][k] = piece(y - ys[j], ys[j + 1] - ys[j], at[0], at[1], cubic ? at[2 * size] : 0.0,
                              cubic ? at[2 * size + 1] : 0.0, cubic, order_y);
    }
  return piece(x - xs[i], xs[i + 1] - xs[i], along[0][0], along[0][1], along[1][0], along[1][1], cubic, order_x);
}
