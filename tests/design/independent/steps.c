/* Steps of order 8 for 16 designs at once. motion.py replaces @...@ by code with the method's weights. */
#include <math.h>
#define LANES 16
#define STRUT(l, t, path, speed, extra) \
  double u = (t)*inv[l] + off[l]; u = u < 1.0 ? u : 1.0; double past = (t) - ramp[l]; past = past > 0.0 ? past : 0.0; \
  double cube = u*u*u; \
  path = v_0[l]*(ramp[l]*cube*u*(2.5 + u*(u - 3.0)) + past); speed = v_0[l]*cube*(10.0 + u*(6.0*u - 15.0)); \
  extra = v_0[l]*inv[l]*30.0*u*u*(1.0 - u)*(1.0 - u);
/* Stage i at the fraction c of a step. place and rate: weighted sums of earlier accelerations; weight: of the averages. */
#define STAGE(i, c, place, rate, weight) \
    for (int l = 0; l < LANES; l++) { \
      double h = hh[l], t = time[l] + c*h; \
      double w = w0[l] + c*h*v0[l] + h*h*(place); \
      double v = v0[l] + h*(rate); \
      double path, speed, extra; \
      STRUT(l, t, path, speed, extra) \
      double gone = speed - v; \
      acc[i][l] = fd[l]*(gone - v_0[l])*(gone + v_0[l]) + extra - om[l]*w - cm[l]*v \
        + fw[l]*sin(nu[l]*(path - zs[l] - w)); \
      double f = k0[l]*w + c0[l]*v, b = h*weight; \
      s0[l] += b*w; s1[l] += b*w*w; s2[l] += b*f; s3[l] += b*f*f; s4[l] += b*(pull[l] + f)*speed; \
      at[i][l] = v; \
    }
/* rows of p: F0 eps/M, Fd/M, k0/M, c/M, 2 pi/ell, V0, ramp, z_s, k0, c, F_s, w, w', h in the ramp, h behind it,
   steps in the ramp, all steps, 1/ramp or 0, 0 or 1 without a ramp */
static void slopes(const double *p, long n, long i, double t, double w, double v, double *acc) {
  double v_0[1] = {p[5*n+i]}, ramp[1] = {p[6*n+i]}, inv[1] = {p[17*n+i]}, off[1] = {p[18*n+i]}, path, speed, extra;
  STRUT(0, t, path, speed, extra)
  double gone = speed - v;
  *acc = p[n+i]*(gone - v_0[0])*(gone + v_0[0]) + extra - p[2*n+i]*w - p[3*n+i]*v
    + p[i]*sin(p[4*n+i]*(path - p[7*n+i] - w));
}
void advance(long n, const double *p, double duration, int outputs, double *sums, double *course) {
  for (long block = 0; block < n; block += LANES) {
    double fw[LANES], fd[LANES], om[LANES], cm[LANES], nu[LANES], v_0[LANES], ramp[LANES], zs[LANES], k0[LANES],
      c0[LANES], pull[LANES], w0[LANES], v0[LANES], h1[LANES], h2[LANES], n1[LANES], n2[LANES], inv[LANES],
      off[LANES], hh[LANES], time[LANES], s0[LANES], s1[LANES], s2[LANES], s3[LANES], s4[LANES],
      acc[12][LANES], at[12][LANES];
    double *rows[19] = {fw, fd, om, cm, nu, v_0, ramp, zs, k0, c0, pull, w0, v0, h1, h2, n1, n2, inv, off};
    int next[LANES]; double most = 0.0;
    for (int l = 0; l < LANES; l++) {
      long i = block + l < n ? block + l : n - 1;
      for (int r = 0; r < 19; r++) rows[r][l] = p[r*n + i];
      s0[l] = s1[l] = s2[l] = s3[l] = s4[l] = 0.0; next[l] = 0;
      if (n2[l] > most) most = n2[l];
    }
    for (long k = 0; k < (long)most; k++) {
      for (int l = 0; l < LANES; l++) {
        int late = k >= n1[l];
        hh[l] = k >= n2[l] ? 0.0 : late ? h2[l] : h1[l];
        time[l] = late ? ramp[l] + (k - n1[l])*h2[l] : k*h1[l];
      }
@STAGES@
      double w1[LANES], v1[LANES];
      for (int l = 0; l < LANES; l++) {
        w1[l] = w0[l] + hh[l]*(@SPEEDS@);
        v1[l] = v0[l] + hh[l]*(@RATES@);
      }
      if (outputs) for (int l = 0; l < LANES; l++) {
        long i = block + l;
        double h = hh[l];
        if (i >= n || h == 0.0) continue;
        double end = k + 1 >= (long)n2[l] ? 2.0*duration : time[l] + h, after;
        slopes(p, n, i, time[l] + h, w1[l], v1[l], &after);
        double a = w0[l], b = h*v0[l], c = h*h*acc[0][l];
        double rest = w1[l] - a - b - c/2.0, steep = h*v1[l] - b - c, bend = h*h*after - c;
        double d = 10.0*rest - 4.0*steep + bend/2.0, e = -15.0*rest + 7.0*steep - bend;
        double f = 6.0*rest - 3.0*steep + bend/2.0;
        for (; next[l] <= outputs && next[l]*duration/outputs <= end; next[l]++) {
          double x = (next[l]*duration/outputs - time[l])/h;
          double w = a + x*(b + x*(c/2.0 + x*(d + x*(e + x*f))));
          double v = (b + x*(c + x*(3.0*d + x*(4.0*e + x*5.0*f))))/h;
          course[next[l]*n + i] = zs[l] + w;
          course[(outputs + 1 + next[l])*n + i] = k0[l]*(zs[l] + w) + c0[l]*v;
        }
      }
      for (int l = 0; l < LANES; l++) { w0[l] = w1[l]; v0[l] = v1[l]; }
    }
    for (int l = 0; l < LANES && block + l < n; l++) {
      long i = block + l;
      sums[i] = s0[l]; sums[n+i] = s1[l]; sums[2*n+i] = s2[l]; sums[3*n+i] = s3[l]; sums[4*n+i] = s4[l];
    }
  }
}
