/* Evaluates a function. Arrays have a column for each of n designs. */
void $name(int64_t n, const double *in, double *out) {
  for (int64_t first = 0; first < n; first += LANES) {
    const int64_t many = n - first < LANES ? n - first : LANES;
    V x[$inputs], y[$results];
    for (int j = 0; j < $inputs; j++) for (int k = 0; k < LANES; k++)
      x[j][k] = in[j * n + first + (k < many ? k : many - 1)];
$body
    for (int j = 0; j < $results; j++) for (int k = 0; k < many; k++) out[j * n + first + k] = y[j][k];
  }
}
/* ---- */
/* Integrates designs in the given order, LANES at a time. Arrays have a column for each of n designs. */
void run(int64_t n, int64_t count, const int64_t *order, const double *in, double *states, double *steps,
         double most) {
  for (int64_t first = 0; first < count; first += LANES) {
    int64_t which[LANES];
    choose(count, order, first, which);
    V p[$parameters], x[$state], y[$state], taken = {0};
    for (int j = 0; j < $parameters; j++) p[j] = gather(in + j * n, which);
    for (int j = 0; j < $state; j++) x[j] = gather(states + j * n, which);
$phases
    for (int k = 0; k < LANES && first + k < count; k++) {
      for (int j = 0; j < $state; j++) states[j * n + which[k]] = x[j][k];
      steps[which[k]] = taken[k];
    }
  }
}
/* ---- */
    {
$once
    for (;;) {
      const M open = (x[0] < p[$end]) & (taken < most);
      if (!any(open)) break;
$each
      for (int j = 0; j < $state; j++) x[j] = v_pick(open, y[j], x[j]);
      taken += v_one(open);
    }
    }
