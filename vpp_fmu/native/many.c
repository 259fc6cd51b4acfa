/* Many instances of a compiled plant, moved together by one call. Comes after the generated model, schedule.c and part.c.
 *
 * Without delays, LANES instances share a block: their values lie side by side, so that one operation serves all of them. With
 * delays each instance is a Part. Both do the arithmetic of run_held(), so an instance's numbers do not depend on its
 * neighbours, to the bit. */

#ifdef LANES
typedef struct {
  double v[N_VALUES][LANES], c[N_CONSTANTS][LANES];
  double count[LANES]; /* the model's own steps in one communication step */
} Block;

long many_size(long count) { return (count + LANES - 1) / LANES * (long)sizeof(Block); }

static void gather(const Block *block, int k, double *v) {
  for (int i = 0; i < N_VALUES; i++) v[i] = block->v[i][k];
}

static void scatter(Block *block, int k, const double *v) {
  for (int i = 0; i < N_VALUES; i++) block->v[i][k] = v[i];
}

static void begin_one(void *memory, long n, const double *parameters, const double *inputs, double dt, double *outputs) {
  static const double no_tangent[N_DELAYED_OR_1] = {0};
  Block *block = (Block *)memory + n / LANES;
  const int k = n % LANES;
  double v[N_VALUES] = {0}, c[N_CONSTANTS] = {0}, d[N_TANGENTS];
  memcpy(v, inputs, N_INPUTS * sizeof *v);
  memcpy(v + N_INPUTS + N_OUTPUTS, parameters, N_PARAMETERS * sizeof *v);
  start(v, d);
  const double largest = largest_step(v);
  double count = largest < INFINITY ? ceil(dt / largest - NOW) : 1.0;
  if (count < 1.0) count = 1.0;
  prepare(v, dt / count, no_tangent, c);
  scatter(block, k, v);
  for (int i = 0; i < N_CONSTANTS; i++) block->c[i][k] = c[i];
  block->count[k] = count;
  memcpy(outputs, v + N_INPUTS, N_OUTPUTS * sizeof *outputs);
}

static void step_alone(Block *block, int k) {
  double v[N_VALUES], c[N_CONSTANTS], d[N_TANGENTS];
  gather(block, k, v);
  for (int i = 0; i < N_CONSTANTS; i++) c[i] = block->c[i][k];
  for (double i = 0.0; i < block->count[k]; i += 1.0) step(v, c, d);
  scatter(block, k, v);
}

/* `hold` communication steps under the inputs (count x N_INPUTS); outputs: count x N_OUTPUTS at their end. */
long many_advance(void *memory, long count, const double *inputs, double dt, long hold, double *outputs) {
  for (long first = 0; first < count; first += LANES) {
    Block *block = (Block *)memory + first / LANES;
    const int lanes = count - first < LANES ? (int)(count - first) : LANES;
    int alike = lanes == LANES;
    for (int k = 0; k < lanes; k++) {
      for (int i = 0; i < N_INPUTS; i++) block->v[i][k] = inputs[(first + k) * N_INPUTS + i];
      alike &= block->count[k] == block->count[0];
    }
    for (long h = 0; h < hold; h++)
      if (alike)
        for (double i = 0.0; i < block->count[0]; i += 1.0)
          step_lanes(block->v, (const double(*)[LANES])block->c);
      else
        for (int k = 0; k < lanes; k++) step_alone(block, k);
    for (int k = 0; k < lanes; k++)
      for (int i = 0; i < N_OUTPUTS; i++) outputs[(first + k) * N_OUTPUTS + i] = block->v[N_INPUTS + i][k];
  }
  return count;
}
#else
long many_size(long count) { return count * (long)sizeof(Part); }

static void begin_one(void *memory, long n, const double *parameters, const double *inputs, double dt, double *outputs) {
  (void)dt;
  part_begin((Part *)memory + n, parameters, inputs, outputs);
}

long many_advance(void *memory, long count, const double *inputs, double dt, long hold, double *outputs) {
  for (long n = 0; n < count; n++)
    for (long h = 0; h < hold; h++)
      if (!part_advance((Part *)memory + n, inputs + n * N_INPUTS, dt, outputs + n * N_OUTPUTS)) return n;
  return count;
}
#endif

/* Start the instances `which` (some) at rest. parameters: some x N_PARAMETERS; inputs: some x N_INPUTS; outputs: some x
 * N_OUTPUTS. */
void many_begin(void *memory, const long *which, long some, const double *parameters, const double *inputs, double dt,
                double *outputs) {
  for (long n = 0; n < some; n++)
    begin_one(memory, which[n], parameters + n * N_PARAMETERS, inputs + n * N_INPUTS, dt, outputs + n * N_OUTPUTS);
}
