/* A saved FMU state: all data of an instance in one block of doubles.
 *
 *   tag of the model, checksum, state of the call sequence, settled, time, wait for the next sample, are tangents carried,
 *   which states were chosen, all values, for each delay: acting, latest, span, count, waits..., values..., all tangents if carried
 *
 * The constants of prepare() are not saved: they follow from the values. */

enum { TAG, CHECKSUM, STATE, SETTLED, TIME, WAIT, CARRIED, HEAD };

typedef struct {
  size_t count;
  double data[];
} Saved;

static size_t saved_count(const Slave *s) {
  size_t count = HEAD + N_STATES + N_VALUES + (s->carried ? N_CARRIED * N_VALUES : 0);
  for (int k = 0; k < N_DELAYED; k++) count += 4 + 2 * (size_t)s->m.lines[k].count;
  return count;
}

/* Adler-32 of the bytes after the checksum. It is checked only in deserialisation, since bytes from a file may be anything.
 * A host that rolls back restores a state at every step, without the cost of a check. */
static double checksum(const double *data, size_t count) {
  const unsigned char *at = (const unsigned char *)(data + CHECKSUM + 1), *end = (const unsigned char *)(data + count);
  unsigned long a = 1, b = 0;
  for (; at < end; at++) {
    a = (a + *at) % 65521;
    b = (b + a) % 65521;
  }
  return b * 65536.0 + a;
}

static void save(const Slave *s, Saved *saved) {
  double *at = saved->data + HEAD;
  saved->count = saved_count(s);
  saved->data[TAG] = MODEL_TAG;
  saved->data[STATE] = s->state;
  saved->data[SETTLED] = s->settled;
  saved->data[TIME] = s->time;
  saved->data[WAIT] = s->m.wait;
  saved->data[CARRIED] = s->carried != NULL;
  for (int i = 0; i < N_STATES; i++) *at++ = s->chosen[i];
  memcpy(at, s->m.v, sizeof s->m.v);
  at += N_VALUES;
  for (int k = 0; k < N_DELAYED; k++) {
    const DelayLine *line = &s->m.lines[k];
    *at++ = line->acting;
    *at++ = line->latest;
    *at++ = line->span;
    *at++ = line->count;
    for (int i = 0; i < line->count; i++) {
      at[i] = line->waits[(line->head + i) % line->slots];
      at[line->count + i] = line->values[(line->head + i) % line->slots];
    }
    at += 2 * line->count;
  }
  if (s->carried) memcpy(at, s->carried, N_CARRIED * sizeof *s->carried);
  saved->data[CHECKSUM] = checksum(saved->data, saved->count);
}

static bool is_whole(const double *data, size_t count) {
  return count >= HEAD + N_STATES + N_VALUES && data[TAG] == MODEL_TAG && data[CHECKSUM] == checksum(data, count);
}

/* Restore an instance from a saved state. False: out of memory. */
static bool restore(Slave *s, const Saved *saved) {
  const double *at = saved->data + HEAD;
  if (saved->data[CARRIED] != 0.0 && !carry_sensitivities(s)) return false;
  if (saved->data[CARRIED] == 0.0) {
    free(s->carried);
    s->carried = NULL;
  }
  s->state = (int)saved->data[STATE];
  s->settled = saved->data[SETTLED] != 0.0;
  s->time = saved->data[TIME];
  for (int i = 0; i < N_STATES; i++) s->chosen[i] = *at++ != 0.0;
  memcpy(s->m.v, at, sizeof s->m.v);
  at += N_VALUES;
  start_schedule(s);
  s->m.wait = saved->data[WAIT];
  for (int k = 0; k < N_DELAYED; k++) {
    DelayLine *line = &s->m.lines[k];
    line->acting = *at++;
    line->latest = *at++;
    line->span = *at++;
    line->count = (int)*at++;
    memcpy(line->waits, at, line->count * sizeof *at);
    memcpy(line->values, at + line->count, line->count * sizeof *at);
    at += 2 * line->count;
  }
  if (s->carried) memcpy(s->carried, at, N_CARRIED * sizeof *s->carried);
  return true;
}
