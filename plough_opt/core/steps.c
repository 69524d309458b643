/* Integrates n runs. `in` has a column for each: the state at time 0, the parameters, the number of steps, the number
   of steps before the kink, and the time of the kink as a fraction of the duration. For runs of one scene `times` may
   hold the ends of their steps, a row for each end; `in` then has one column, with the largest number of steps. Each
   output is read from ${ends} ends of steps, of which `from` is the first, with ${ends} weights of w and of its rate in
   w, and as many of w and of its rate in the rate. Otherwise `times` is NULL. `memory` has room for 4 vectors at each
   end of a step and ${ends} more. `out` has a row for each run: the states at the outputs, if there are any, the means,
   and the mean squares about these. */
typedef double Ends __attribute__((vector_size(8 * ${ends}), aligned(8)));
void steps(int64_t n, const double *in, int64_t outputs, const double *times, const int64_t *from, const double *weight,
           double *memory, double *out) {
  V *const room = (V *)(((uintptr_t)memory + sizeof(V) - 1) / sizeof(V) * sizeof(V));
  const int64_t size = (outputs ? 2 * (outputs + 1) : 0) + ${count} + ${squared};
  for (int64_t first = 0; first < n; first += LANES) {
    const int64_t columns = times ? 1 : n;
    int64_t which[LANES], column[LANES], most = 0;
    for (int l = 0; l < LANES; l++) which[l] = first + l < n ? first + l : n - 1, column[l] = times ? 0 : which[l];
    const V total = gather(in + (${given} + 2) * columns, column), kink = gather(in + (${given} + 4) * columns, column);
    const V early = gather(in + (${given} + 3) * columns, column);
    for (int l = 0; l < LANES; l++) if (total[l] > most) most = total[l];
    V *node = room, *ends = room + most + 2;
    /* Sizes of the steps before and after the kink, as fractions of the duration. */
    const V before = kink / v_max(early, (V){0} + 1.0), after = (1.0 - kink) / (total - early);
    for (int64_t k = 0; k <= most + 1; k++) {
      const V now = (V){0} + (double)k;
      node[k] = v_pick(now < early, now * before, v_pick(now < total, kink + (now - early) * after, (V){0} + 1.0));
      if (times) node[k] = gather(times + n * (k < most ? k : most), which);
    }
    V p[${given}], x[2], mean[${count}], square[${squared}], time;
    for (int j = 0; j < ${given}; j++) p[j] = gather(in + (j + 2) * columns, column);
$once
    for (int j = 0; j < 2; j++) x[j] = gather(in + j * columns, column);
    for (int j = 0; j < ${count}; j++) mean[j] = (V){0};
    for (int j = 0; j < ${squared}; j++) square[j] = (V){0};
    time = (V){0};
    /* A last step without length has the acceleration at the end, from which outputs are read. */
    for (int64_t k = 0; k < most + (outputs > 0); k++) {
      V s[2], y[${width}]; /* start and size of the step; a run that has ended takes steps without length */
      s[0] = node[k];
      s[1] = node[k + 1] - node[k];
$each
      /* The start of the step: w, w' and w''. */
      V *end = ends + 3 * k;
      if (outputs) end[0] = x[0], end[1] = x[1], end[2] = y[2];
      x[0] = y[0]; x[1] = y[1];
      /* Means and mean squares of this step are pooled with those of the steps before. */
      time += s[1];
      const V part = s[1] / time;
      for (int j = 0; j < ${count}; j++) {
        const V distance = y[3 + j] - mean[j];
        if (j < ${squared})
          square[j] = (1.0 - part) * (square[j] + part * distance * distance) + part * y[3 + ${count} + j];
        mean[j] += part * distance;
      }
    }
    for (int l = 0; l < LANES && first + l < n; l++) {
      double *to = out + size * which[l];
      const double duration = p[${given} - 1][l];
      double *w = (double *)(ends + 3 * (most + 1)), *rate = w + most + ${ends};
      for (int64_t k = 0; k < most + ${ends} && times; k++) {
        w[k] = k <= most ? ends[3 * k][l] : 0.0;
        rate[k] = k <= most ? duration * ends[3 * k + 1][l] : 0.0;
      }
      for (int64_t o = 0; o <= outputs && times; o++, to += 2, from++, weight += 4 * ${ends}) {
        const Ends *by = (const Ends *)weight, a = *(const Ends *)(w + *from), b = *(const Ends *)(rate + *from);
        const Ends value = by[0] * a + by[1] * b, slope = by[2] * a + by[3] * b;
        to[0] = to[1] = 0.0;
        for (int j = 0; j < ${ends}; j++) to[0] += value[j], to[1] += slope[j];
        to[1] /= duration;
      }
      int64_t k = 0;
      /* Each output is read from the polynomial of degree 5 through w, w' and w'' at both ends of its step. */
      for (int64_t o = 0; o <= outputs && outputs > 0 && !times; o++) {
        const double t = (double)o / outputs;
        while (k + 1 < total[l] && node[k + 1][l] <= t) k++;
        const double part = node[k + 1][l] - node[k][l], u = (t - node[k][l]) / part, h = part * duration;
        const V *a = ends + 3 * k, *b = a + 3;
        const double w = a[0][l], r = h * a[1][l], c = 0.5 * h * h * a[2][l];
        const double d = b[0][l] - w - r - c, e = h * b[1][l] - r - 2.0 * c, g = 0.5 * h * h * b[2][l] - c;
        const double c3 = 10.0 * d - 4.0 * e + g, c4 = -15.0 * d + 7.0 * e - 2.0 * g, c5 = 6.0 * d - 3.0 * e + g;
        *to++ = w + u * (r + u * (c + u * (c3 + u * (c4 + u * c5))));
        *to++ = (r + u * (2.0 * c + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h;
      }
      for (int j = 0; j < ${count}; j++) *to++ = mean[j][l];
      for (int j = 0; j < ${squared}; j++) *to++ = square[j][l];
    }
  }
}

/* Integrates a run and its check: see `steps`. Behind `in` are the parameters of `Equation.outputs`. `found` gets
   the rows of these for the run, and then a row for each of both: means, mean squares and, for the run, the largest
   magnitude of each output, for the check the largest difference. It returns whether all are finite. */
int pair(const double *in, int64_t outputs, const double *times, const int64_t *from, const double *weight,
         double *memory, double *found) {
  double *rows = found, *ends = found + ${rows} * (outputs + 1);
  const int64_t averages = ${count} + ${squared}, size = 2 * (outputs + 1) + averages;
  steps(2, in, outputs, times, from, weight, memory + 2 * size, memory);
  V p[${known} + 1], sizes[2][${rows}] = {0};
  M finite = ~(M){0};
  for (int j = 0; j < ${known}; j++) p[j] = (V){0} + in[${given} + 5 + j];
$observed_once
  for (int64_t o = 0; o <= outputs; o += LANES) {
    V x[3], y[${rows}], check[${rows}];
    for (int run = 1; run >= 0; run--) {
      for (int l = 0; l < LANES; l++) {
        const int64_t now = o + l < outputs ? o + l : outputs;
        x[0][l] = (double)now / outputs * in[${given} + 1];
        for (int j = 0; j < 2; j++) x[1 + j][l] = memory[run * size + 2 * now + j];
      }
$observed_each
      for (int j = 0; j < ${rows}; j++) {
        finite &= y[j] - y[j] == 0.0;
        if (run) check[j] = y[j];
      }
    }
    for (int j = 0; j < ${rows}; j++) {
      sizes[0][j] = v_max(sizes[0][j], v_fabs(y[j]));
      sizes[1][j] = v_max(sizes[1][j], v_fabs(y[j] - check[j]));
      for (int l = 0; l < LANES && o + l <= outputs; l++) rows[j * (outputs + 1) + o + l] = y[j][l];
    }
  }
  int sound = !any(~finite);
  for (int run = 0; run < 2; run++, ends += averages + ${rows}) {
    for (int j = 0; j < averages; j++) sound &= isfinite(ends[j] = memory[run * size + size - averages + j]) != 0;
    for (int j = 0; j < ${rows}; j++) {
      ends[averages + j] = 0.0;
      for (int l = 0; l < LANES; l++) ends[averages + j] = fmax(ends[averages + j], sizes[run][j][l]);
    }
  }
  return sound;
}
