/* Written by plough_opt ${version}.
${comment}
 *
 * Inputs and outputs are in this order. The values of a column follow each other without gaps.
 * Compile with -ffp-contract=off to get the same numbers as in Python.
 */
#ifndef ${upper}_H
#define ${upper}_H

#ifdef __cplusplus
extern "C" {
#endif

#define ${upper}_INPUTS ${inputs}
#define ${upper}_OUTPUTS ${outputs}

extern const char *const ${name}_input_names[${upper}_INPUTS];
extern const char *const ${name}_input_units[${upper}_INPUTS];
extern const double ${name}_input_lower[${upper}_INPUTS];
extern const double ${name}_input_upper[${upper}_INPUTS];
extern const double ${name}_input_values[${upper}_INPUTS];
extern const char *const ${name}_output_names[${upper}_OUTPUTS];
extern const char *const ${name}_output_units[${upper}_OUTPUTS];

/* Computes ${upper}_OUTPUTS outputs from ${upper}_INPUTS inputs. Safe in threads.
 * Returns 0 on success, 1 if memory is short, 2 if an input lies outside its bounds, for which steps and checks were
 * not chosen, and 3 if a result is not finite. Unless it returns 0 all results are NaN. */
int ${name}_evaluate(const double *inputs, double *outputs);

/* Derivatives of all outputs by all inputs, row by row: jacobian[i * ${upper}_INPUTS + j] = d output i / d input j.
 * Returns the same codes. */
int ${name}_jacobian(const double *inputs, double *jacobian);

#ifdef __cplusplus
}
#endif
#endif
