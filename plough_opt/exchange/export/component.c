#include <float.h>
#include <math.h>
#include <stdlib.h>

#include "$name.h"

/* All functions that CasADi generates have the same parameters, whether they use them or not. */
#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

$graph
$tables

/* Whether an input is not a number, or lies outside its bounds by more than optimisers relax them. */
static int ${name}_outside(const double *inputs) {
  int k;
  for (k = 0; k < $inputs; ++k) {
    double slack = $beyond * (${name}_input_upper[k] - ${name}_input_lower[k]);
    if (!(inputs[k] >= ${name}_input_lower[k] - slack && inputs[k] <= ${name}_input_upper[k] + slack)) return 1;
  }
  return 0;
}

/* Checks the inputs, and calls one of CasADi's functions, of count results, with as many numbers of memory as work. */
static int ${name}_call(int (*function)(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int),
                        size_t work, int count, const double *inputs, double *results) {
  const casadi_real *arg[$arg];
  casadi_real *res[$res];
  casadi_int iw[$iw];
  casadi_real *w;
  int k, failed = ${name}_outside(inputs) ? 2 : 0;
  if (!failed) {
    w = (casadi_real *) malloc(work * sizeof *w);
    arg[0] = inputs;
    res[0] = results;
    failed = w && !function(arg, res, iw, w, 0) ? 0 : 1;
    free(w);
  }
  for (k = 0; k < count && !failed; ++k)
    if (!(fabs(results[k]) <= DBL_MAX)) failed = 3;
  for (k = 0; k < count && failed; ++k) results[k] = NAN;
  return failed;
}

int ${name}_evaluate(const double *inputs, double *results) {
  return ${name}_call(${name}_values, $work_values, $count_values, inputs, results);
}

int ${name}_jacobian(const double *inputs, double *results) {
  return ${name}_call(${name}_slopes, $work_slopes, $count_slopes, inputs, results);
}
