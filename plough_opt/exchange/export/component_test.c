/* Compares the compiled component with the values that Python computed when this file was written. */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "${name}.h"

#define POINTS ${count}
#define SLOPES (${upper}_OUTPUTS * ${upper}_INPUTS)

static const double inputs[POINTS][${upper}_INPUTS] = {
${points}
};
static const double outputs[POINTS][${upper}_OUTPUTS] = {
${evaluate}
};
static const double slopes[POINTS][SLOPES] = {
${jacobian}
};

/* Number of doubles from one to the other. */
static uint64_t ulps(double a, double b) {
  uint64_t one, other;
  const uint64_t sign = (uint64_t) 1 << 63;
  memcpy(&one, &a, sizeof one);
  memcpy(&other, &b, sizeof other);
  one = one & sign ? sign - (one & ~sign) : sign + one;
  other = other & sign ? sign - (other & ~sign) : sign + other;
  return one > other ? one - other : other - one;
}

static void compare(const char *what, int point, int count, const double *found, const double *wanted,
                    uint64_t *worst) {
  int k;
  for (k = 0; k < count; ++k) {
    uint64_t apart = ulps(found[k], wanted[k]);
    if (apart > ${most})
      printf("%s %d at point %d: %.17g, and %.17g in Python\n", what, k, point, found[k], wanted[k]);
    if (apart > *worst) *worst = apart;
  }
}

int main(void) {
  static double found[SLOPES];
  uint64_t worst = 0;
  int k;
  for (k = 0; k < POINTS; ++k) {
    if (${name}_evaluate(inputs[k], found)) return 2;
    compare("output", k, ${upper}_OUTPUTS, found, outputs[k], &worst);
    if (${name}_jacobian(inputs[k], found)) return 2;
    compare("derivative", k, SLOPES, found, slopes[k], &worst);
  }
  printf("%d values, %d derivatives: at most %.0f ulp from Python\n", POINTS * ${upper}_OUTPUTS, POINTS * SLOPES,
         (double) worst);
  return worst > ${most};
}
