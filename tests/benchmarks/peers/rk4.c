/* What an expert writes by hand for problem R1: classical Runge-Kutta of order 4 with a fixed number of steps,
   one design at a time, or with -DWIDTH=8 (or 4, 2) a vector register of designs at a time.

   w'' = (F0 amplitude sin(2 pi L / wavelength) + Fd gain (2 V0 + gain) - k w) / M,  gain = -w',  L = V0 t - z0 - w
   Every design: F0, Fd, M, k, z0. Results: mean of w, and its standard deviation. */
#include <math.h>
#include <stdint.h>

#ifndef WIDTH
#define WIDTH 1
typedef double V;
#define SINE sin
#define ROOT sqrt
#define AT(x, k) (x)
#else
typedef double V __attribute__((vector_size(8 * WIDTH)));
#if WIDTH == 8
V _ZGVeN8v_sin(V);
#define SINE _ZGVeN8v_sin
#elif WIDTH == 4
V _ZGVdN4v_sin(V);
#define SINE _ZGVdN4v_sin
#else
V _ZGVbN2v_sin(V);
#define SINE _ZGVbN2v_sin
#endif
static inline V ROOT(V x) { V r; for (int k = 0; k < WIDTH; k++) r[k] = sqrt(x[k]); return r; }
#define AT(x, k) (x)[k]
#endif

void run(int64_t n, const double *in, double *out, int64_t steps, double duration, double speed, double amplitude,
         double wavelength) {
  const double h = duration / steps, turn = 2.0 * M_PI / wavelength;
  for (int64_t first = 0; first < n; first += WIDTH) {
    V p[5];
    for (int j = 0; j < 5; j++) for (int k = 0; k < WIDTH; k++) AT(p[j], k) = in[j * n + first + k];
    const V strong = p[0] * amplitude / p[2], drag = p[1] / p[2], spring = p[3] / p[2], lead = turn * p[4];
    V w = 0.0 * p[0], v = w, sum = w, squares = w;
#define RATE(t, w, v) (strong * SINE(turn * (speed * (t) - (w)) - lead) + drag * (v) * ((v) - 2.0 * speed) - spring * (w))
    for (int64_t i = 0; i < steps; i++) {
      const double t = i * h, half = 0.5 * h;
      const V a1 = RATE(t, w, v);
      const V w2 = w + half * v, v2 = v + half * a1, a2 = RATE(t + half, w2, v2);
      const V w3 = w + half * v2, v3 = v + half * a2, a3 = RATE(t + half, w3, v3);
      const V w4 = w + h * v3, v4 = v + h * a3, a4 = RATE(t + h, w4, v4);
      sum += w + 2.0 * (w2 + w3) + w4;
      squares += w * w + 2.0 * (w2 * w2 + w3 * w3) + w4 * w4;
      w += h / 6.0 * (v + 2.0 * (v2 + v3) + v4);
      v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
    }
    const V mean = sum / (6.0 * steps), spread = ROOT(squares / (6.0 * steps) - mean * mean);
    for (int k = 0; k < WIDTH; k++) {
      out[first + k] = AT(mean, k);
      out[n + first + k] = AT(spread, k);
    }
  }
}
