/* FMI 3.0 model exchange for the equations above, those of a share on its mount.

   Value reference 0 is the time. The others follow without gaps: states, rates, outputs, event indicators, calculated
   parameters, inputs, parameters, and discrete variables. The types are those of the FMI 3.0 standard. */

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(FMI3_FUNCTION_PREFIX) && !defined(FMI3_OVERRIDE_FUNCTION_PREFIX)
#define FMI3_ACTUAL_FUNCTION_PREFIX FMI3_FUNCTION_PREFIX
#endif
#ifdef FMI3_ACTUAL_FUNCTION_PREFIX
#define JOIN(A, B) A##B
#define JOINED(A, B) JOIN(A, B)
#define NAME(FUNCTION) JOINED(FMI3_ACTUAL_FUNCTION_PREFIX, FUNCTION)
#else
#define NAME(FUNCTION) FUNCTION
#endif
#ifndef FMI3_Export
#if defined(_WIN32) || defined(__CYGWIN__)
#define FMI3_Export __declspec(dllexport)
#elif defined(__GNUC__)
#define FMI3_Export __attribute__((visibility("default")))
#else
#define FMI3_Export
#endif
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Status;
typedef uint32_t Reference;
typedef void (*Log)(void *environment, Status status, const char *category, const char *message);
typedef enum { INSTANTIATED, INITIALIZATION, EVENT, CONTINUOUS, TERMINATED } Phase;

enum {
  STATES = 1,
  RATES = STATES + NX,
  OUTPUTS = RATES + NX,
  INDICATORS = OUTPUTS + NY,
  CALCULATED = INDICATORS + NZ,
  INPUTS = CALCULATED + NC,
  PARAMETERS = INPUTS + NU,
  DISCRETE = PARAMETERS + NP,
  REFERENCES = DISCRETE + ND,
  UNKNOWNS = NX + NX + NY + NZ + NC,
  KNOWNS = NX + NU + NP
};

/* Everything that a run depends on, without pointers, so that a copy is the FMU's state. The extra element of an array
   allows it to be empty. */
typedef struct {
  Phase phase;
  bool derived, retreats;
  double time;
  double value[REFERENCES];
  double q[NQ + 1];
} Core;

typedef struct {
  Core core;
  void *environment;
  Log log;
  double work[NW + 1];
} Instance;

static Status report(const Instance *self, Status status, const char *format, ...) {
  char text[400];
  va_list values;
  va_start(values, format);
  vsnprintf(text, sizeof text, format, values);
  va_end(values);
  if (self->log) self->log(self->environment, status, status == WARNING ? "logStatusWarning" : "logStatusError", text);
  return status;
}

/* ---- Equations ---- */

static bool finite_all(const double *x, size_t n) {
  for (size_t k = 0; k < n; k++)
    if (!isfinite(x[k])) return false;
  return true;
}

/* Reports a parameter outside its domain; otherwise computes the numbers that the equations need. */
static Status derived(Instance *self) {
  Core *c = &self->core;
  const double *p = c->value + PARAMETERS;
  if (c->derived) return OK;
  for (size_t k = 0; k < NP; k++) {
    const Limits *l = &limits[k];
    const bool low = l->above ? p[k] > l->low : p[k] >= l->low, high = l->below ? p[k] < l->high : p[k] <= l->high;
    if (!low)
      return report(self, ERROR, "%s = %.17g must be %s %.6g", l->name, p[k], l->above ? "above" : "at least", l->low);
    if (!high)
      return report(self, ERROR, "%s = %.17g must be %s %.6g", l->name, p[k], l->below ? "below" : "at most", l->high);
  }
  const double *from[] = {p};
  double *into[] = {c->q, c->value + CALCULATED};
  if (derive(from, into, NULL, self->work, 0) || !finite_all(c->q, NQ) || !finite_all(into[1], NC))
    return report(self, ERROR, "the soil has no finite reaction to the share with these parameters");
  c->derived = true;
  return OK;
}

/* Computes the states at the start from inputs and parameters. */
static Status begun(Instance *self) {
  double *v = self->core.value;
  if (derived(self) != OK) return ERROR;
  if (NEEDS_SPEED && !(v[INPUTS] >= 0.0))
    return report(self, ERROR, "strut_speed = %.17g must be at least 0 at the start", v[INPUTS]);
  const double *from[] = {v + INPUTS, self->core.q};
  double *into[] = {v + STATES, v + DISCRETE};
  begin(from, into, NULL, self->work, 0);
  return OK;
}

static Status evaluated(Instance *self) {
  Core *c = &self->core;
  double *v = c->value;
  if ((c->phase <= INITIALIZATION ? begun(self) : derived(self)) != OK) return ERROR;
  const double *from[] = {&c->time, v + STATES, v + INPUTS, v + DISCRETE, c->q};
  double *into[] = {v + RATES, v + OUTPUTS, v + INDICATORS};
  evaluate(from, into, NULL, self->work, 0);
  if (!finite_all(v + RATES, INDICATORS - RATES))
    return report(self, DISCARD, "the share's motion is not finite at %.6g s", c->time);
  return OK;
}

/* ---- Instances and modes ---- */

static Status moved(Instance *self, bool allowed, const char *what, Phase to) {
  if (!allowed) return report(self, ERROR, "%s is not allowed now", what);
  self->core.phase = to;
  return OK;
}

static void set_up(Instance *self) {
  memset(&self->core, 0, sizeof self->core);
  memcpy(self->core.value + INPUTS, starts, (NU + NP) * sizeof(double));
}

FMI3_Export const char *NAME(fmi3GetVersion)(void) { return "3.0"; }

FMI3_Export void *NAME(fmi3InstantiateModelExchange)(const char *name, const char *token, const char *resources,
                                                     bool visible, bool logging, void *environment, Log log) {
  (void)name, (void)resources, (void)visible, (void)logging;
  Instance *self = calloc(1, sizeof(Instance));
  if (!self) return NULL;
  self->environment = environment;
  self->log = log;
  if (!token || strcmp(token, TOKEN)) {
    report(self, ERROR, "the instantiation token is not that of this FMU: %s", TOKEN);
    free(self);
    return NULL;
  }
  set_up(self);
  return self;
}

FMI3_Export void NAME(fmi3FreeInstance)(void *instance) { free(instance); }

FMI3_Export Status NAME(fmi3SetDebugLogging)(void *instance, bool on, size_t n, const char *const categories[]) {
  (void)instance, (void)on, (void)n, (void)categories;
  return OK;
}

FMI3_Export Status NAME(fmi3EnterInitializationMode)(void *instance, bool has_tolerance, double tolerance, double start,
                                                     bool has_stop, double stop) {
  Instance *self = instance;
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
  self->core.time = start;
  return moved(self, self->core.phase == INSTANTIATED, "fmi3EnterInitializationMode", INITIALIZATION);
}

FMI3_Export Status NAME(fmi3ExitInitializationMode)(void *instance) {
  Instance *self = instance;
  if (self->core.phase == INITIALIZATION && evaluated(self) != OK) return ERROR;
  return moved(self, self->core.phase == INITIALIZATION, "fmi3ExitInitializationMode", EVENT);
}

FMI3_Export Status NAME(fmi3EnterEventMode)(void *instance) {
  Instance *self = instance;
  return moved(self, self->core.phase == CONTINUOUS, "fmi3EnterEventMode", EVENT);
}

FMI3_Export Status NAME(fmi3EnterContinuousTimeMode)(void *instance) {
  Instance *self = instance;
  return moved(self, self->core.phase == EVENT, "fmi3EnterContinuousTimeMode", CONTINUOUS);
}

FMI3_Export Status NAME(fmi3Terminate)(void *instance) {
  Instance *self = instance;
  const Phase phase = self->core.phase;
  return moved(self, phase == EVENT || phase == CONTINUOUS, "fmi3Terminate", TERMINATED);
}

FMI3_Export Status NAME(fmi3Reset)(void *instance) {
  set_up(instance);
  return OK;
}

FMI3_Export Status NAME(fmi3UpdateDiscreteStates)(void *instance, bool *again, bool *terminate, bool *nominals,
                                                  bool *states, bool *has_next, double *next) {
  Instance *self = instance;
  Core *c = &self->core;
  double *v = c->value, x[NX], d[ND + 1];
  *again = *terminate = *nominals = *states = *has_next = false;
  *next = 0.0;
  if (c->phase != EVENT) return report(self, ERROR, "fmi3UpdateDiscreteStates is not allowed now");
  if (derived(self) != OK) return ERROR;
  const double *from[] = {&c->time, v + STATES, v + INPUTS, v + DISCRETE, c->q};
  double *into[] = {x, d};
  happen(from, into, NULL, self->work, 0);
  *states = memcmp(x, v + STATES, sizeof x) != 0;
  memcpy(v + STATES, x, sizeof x);
  memcpy(v + DISCRETE, d, ND * sizeof(double));
  return OK;
}

/* ---- Values ---- */

FMI3_Export Status NAME(fmi3GetFloat64)(void *instance, const Reference which[], size_t n, double values[],
                                        size_t count) {
  Instance *self = instance;
  const double *v = self->core.value;
  bool stale = false;
  if (count != n) return report(self, ERROR, "%zu values for %zu scalar variables", count, n);
  for (size_t k = 0; k < n; k++) {
    if (which[k] >= REFERENCES) return report(self, ERROR, "no variable has the value reference %u", which[k]);
    stale = stale || (which[k] >= STATES && which[k] < INPUTS) || which[k] >= DISCRETE;
  }
  const Status status = stale && self->core.phase != TERMINATED ? evaluated(self) : OK;
  if (status > WARNING) return status;
  for (size_t k = 0; k < n; k++) values[k] = which[k] == 0 ? self->core.time : v[which[k]];
  return OK;
}

FMI3_Export Status NAME(fmi3SetFloat64)(void *instance, const Reference which[], size_t n, const double values[],
                                        size_t count) {
  Instance *self = instance;
  Core *c = &self->core;
  if (count != n) return report(self, ERROR, "%zu values for %zu scalar variables", count, n);
  for (size_t k = 0; k < n; k++) {
    const bool input = which[k] >= INPUTS && which[k] < PARAMETERS;
    const bool parameter = which[k] >= PARAMETERS && which[k] < DISCRETE;
    if (!input && !parameter)
      return report(self, ERROR, "the variable of value reference %u cannot be set", which[k]);
    if (c->phase == TERMINATED || (parameter && c->phase == CONTINUOUS))
      return report(self, ERROR, "the variable of value reference %u cannot be set now", which[k]);
    if (!isfinite(values[k]))
      return report(self, ERROR, "the value of value reference %u must be finite", which[k]);
    c->derived = c->derived && !(parameter && c->value[which[k]] != values[k]);
    c->value[which[k]] = values[k];
  }
  return OK;
}

/* ---- Integration ---- */

FMI3_Export Status NAME(fmi3SetTime)(void *instance, double time) {
  ((Instance *)instance)->core.time = time;
  return OK;
}

FMI3_Export Status NAME(fmi3SetContinuousStates)(void *instance, const double states[], size_t n) {
  Instance *self = instance;
  if (n != NX || self->core.phase != CONTINUOUS)
    return report(self, ERROR, "the %d states can be set in continuous time mode only", NX);
  memcpy(self->core.value + STATES, states, NX * sizeof(double));
  return OK;
}

/* Copies some of the evaluated values. */
static Status handed(Instance *self, Reference first, size_t n, size_t expected, double values[]) {
  if (n != expected) return report(self, ERROR, "%zu values requested, but there are %zu", n, expected);
  const Status status = evaluated(self);
  if (status == OK) memcpy(values, self->core.value + first, n * sizeof(double));
  return status;
}

FMI3_Export Status NAME(fmi3GetContinuousStateDerivatives)(void *instance, double rates[], size_t n) {
  return handed(instance, RATES, n, NX, rates);
}

FMI3_Export Status NAME(fmi3GetEventIndicators)(void *instance, double indicators[], size_t n) {
  return handed(instance, INDICATORS, n, NZ, indicators);
}

FMI3_Export Status NAME(fmi3GetContinuousStates)(void *instance, double states[], size_t n) {
  return handed(instance, STATES, n, NX, states);
}

FMI3_Export Status NAME(fmi3GetNominalsOfContinuousStates)(void *instance, double values[], size_t n) {
  if (n != NX) return report(instance, ERROR, "%zu nominal values requested, but there are %d", n, NX);
  memcpy(values, nominals, NX * sizeof(double));
  return OK;
}

FMI3_Export Status NAME(fmi3GetNumberOfEventIndicators)(void *instance, size_t *n) {
  (void)instance;
  *n = NZ;
  return OK;
}

FMI3_Export Status NAME(fmi3GetNumberOfContinuousStates)(void *instance, size_t *n) {
  (void)instance;
  *n = NX;
  return OK;
}

/* Warns once in a run if the share retreats under a contact law whose resistance always points backwards. */
FMI3_Export Status NAME(fmi3CompletedIntegratorStep)(void *instance, bool final, bool *event, bool *terminate) {
  Instance *self = instance;
  Core *c = &self->core;
  (void)final;
  *event = *terminate = false;
  if (PUSHES && !c->retreats && c->value[STATES + 1] < 0.0) {
    c->retreats = true;
    report(self, WARNING, "the share retreats at %.4g s, and a resistance of fixed sign pushes it: "
           "use a one-sided contact law", c->time);
  }
  return OK;
}
