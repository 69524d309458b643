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

/* The functions of FMI 3.0 below are optional: derivatives, the state of the FMU, and those that this FMU does not
   support. */

/* ---- Derivatives ---- */

#if HAS_DERIVATIVES
/* Returns the position of an unknown or a known in the vectors of sensitivities; -1 for any other variable. */
static int place(const Instance *self, Reference which, bool unknown) {
  const bool starting = self->core.phase <= INITIALIZATION;
  if (unknown) return which >= (starting ? STATES : RATES) && which < INPUTS ? (int)which - STATES : -1;
  if (which >= STATES && which < RATES) return starting ? -1 : (int)which - STATES;
  return which >= INPUTS && which < DISCRETE ? (int)which - INPUTS + NX : -1;
}

/* Computes the changes of all unknowns from changes of states, inputs and parameters. At the start the changes of the
   states are unknowns too: they follow from those of inputs and parameters. */
static void forwards(Instance *self, bool starting, const double known[], double unknown[]) {
  const double *v = self->core.value, *q = self->core.q, *t = &self->core.time, *du = known + NX, *dp = du + NU;
  double dq[NQ + NC + 1];
  forward_derive((const double *[]){v + PARAMETERS, dp}, (double *[]){dq}, NULL, self->work, 0);
  if (starting) forward_begin((const double *[]){v + INPUTS, q, du, dq}, (double *[]){unknown}, NULL, self->work, 0);
  else memcpy(unknown, known, NX * sizeof(double));
  forward_evaluate((const double *[]){t, v + STATES, v + INPUTS, v + DISCRETE, q, unknown, du, dq},
                   (double *[]){unknown + NX}, NULL, self->work, 0);
  memcpy(unknown + CALCULATED - STATES, dq + NQ, NC * sizeof(double));
}

/* Computes the transpose of `forwards`: sensitivities by states, inputs and parameters from seeds of all unknowns. */
static void backwards(Instance *self, bool starting, const double unknown[], double known[]) {
  const double *v = self->core.value, *q = self->core.q, *t = &self->core.time;
  double *dx = known, *du = known + NX, *dp = du + NU, dq[NQ + NC + 1], more_u[NU], more_q[NQ + 1];
  reverse_evaluate((const double *[]){t, v + STATES, v + INPUTS, v + DISCRETE, q, unknown + NX},
                   (double *[]){dx, du, dq}, NULL, self->work, 0);
  for (size_t k = 0; k < NX; k++) dx[k] += unknown[k];
  if (starting) {
    reverse_begin((const double *[]){v + INPUTS, q, dx}, (double *[]){more_u, more_q}, NULL, self->work, 0);
    for (size_t k = 0; k < NU; k++) du[k] += more_u[k];
    for (size_t k = 0; k < NQ; k++) dq[k] += more_q[k];
  }
  memcpy(dq + NQ, unknown + CALCULATED - STATES, NC * sizeof(double));
  reverse_derive((const double *[]){v + PARAMETERS, dq}, (double *[]){dp}, NULL, self->work, 0);
}

static Status sensitive(Instance *self, bool ahead, const Reference unknowns[], size_t n_unknowns,
                        const Reference knowns[], size_t n_knowns, const double seed[], size_t n_seed,
                        double sensitivity[], size_t n_sensitivity) {
  const bool starting = self->core.phase <= INITIALIZATION;
  const Reference *from = ahead ? knowns : unknowns, *to = ahead ? unknowns : knowns;
  const size_t n_from = ahead ? n_knowns : n_unknowns, n_to = ahead ? n_unknowns : n_knowns;
  double seeds[UNKNOWNS + KNOWNS] = {0.0}, found[UNKNOWNS + KNOWNS];
  if (n_seed != n_from || n_sensitivity != n_to)
    return report(self, ERROR, "%zu seeds and %zu sensitivities were expected", n_from, n_to);
  for (size_t k = 0; k < n_from + n_to; k++) {
    const Reference which = k < n_from ? from[k] : to[k - n_from];
    const int at = place(self, which, (k < n_from) != ahead);
    if (at < 0) return report(self, ERROR, "there is no derivative for value reference %u now", which);
    if (k < n_from) seeds[at] += seed[k];
  }
  if (evaluated(self) != OK) return ERROR;
  (ahead ? forwards : backwards)(self, starting, seeds, found);
  for (size_t k = 0; k < n_to; k++) sensitivity[k] = found[place(self, to[k], ahead)];
  return finite_all(sensitivity, n_to)
             ? OK
             : report(self, DISCARD, "a derivative is not finite at %.6g s", self->core.time);
}

#define DERIVATIVE(FUNCTION, AHEAD) \
  FMI3_Export Status NAME(FUNCTION)(void *instance, const Reference unknowns[], size_t n_unknowns, \
                                    const Reference knowns[], size_t n_knowns, const double seed[], size_t n_seed, \
                                    double sensitivity[], size_t n_sensitivity) { \
    return sensitive(instance, AHEAD, unknowns, n_unknowns, knowns, n_knowns, seed, n_seed, sensitivity, \
                     n_sensitivity); \
  }
DERIVATIVE(fmi3GetDirectionalDerivative, true)
DERIVATIVE(fmi3GetAdjointDerivative, false)
#endif

/* ---- The FMU's state ---- */

FMI3_Export Status NAME(fmi3GetFMUState)(void *instance, void **state) {
  Instance *self = instance;
  if (!*state) *state = malloc(sizeof(Core));
  if (!*state) return report(self, ERROR, "no memory for the FMU's state");
  memcpy(*state, &self->core, sizeof(Core));
  return OK;
}

FMI3_Export Status NAME(fmi3SetFMUState)(void *instance, void *state) {
  memcpy(&((Instance *)instance)->core, state, sizeof(Core));
  return OK;
}

FMI3_Export Status NAME(fmi3FreeFMUState)(void *instance, void **state) {
  (void)instance;
  free(*state);
  *state = NULL;
  return OK;
}

FMI3_Export Status NAME(fmi3SerializedFMUStateSize)(void *instance, void *state, size_t *size) {
  (void)instance, (void)state;
  *size = sizeof(Core);
  return OK;
}

FMI3_Export Status NAME(fmi3SerializeFMUState)(void *instance, void *state, uint8_t bytes[], size_t size) {
  if (size != sizeof(Core)) return report(instance, ERROR, "the FMU's state has %zu bytes", sizeof(Core));
  memcpy(bytes, state, size);
  return OK;
}

FMI3_Export Status NAME(fmi3DeserializeFMUState)(void *instance, const uint8_t bytes[], size_t size, void **state) {
  if (size != sizeof(Core)) return report(instance, ERROR, "the FMU's state has %zu bytes", sizeof(Core));
  if (!*state) *state = malloc(size);
  if (!*state) return report(instance, ERROR, "no memory for the FMU's state");
  memcpy(*state, bytes, size);
  return OK;
}

/* ---- Unsupported functions ---- */

#define ABSENT(FUNCTION, ...) \
  FMI3_Export Status NAME(FUNCTION)(void *instance, __VA_ARGS__) { \
    return report(instance, ERROR, #FUNCTION " is not supported"); \
  }
#define NO_VARIABLES(TYPE, C) \
  FMI3_Export Status NAME(fmi3Get##TYPE)(void *instance, const Reference which[], size_t n, C values[], \
                                         size_t count) { \
    (void)which, (void)values, (void)count; \
    return n ? report(instance, ERROR, "this FMU has no variables of type " #TYPE) : OK; \
  } \
  FMI3_Export Status NAME(fmi3Set##TYPE)(void *instance, const Reference which[], size_t n, const C values[], \
                                         size_t count) { \
    (void)which, (void)values, (void)count; \
    return n ? report(instance, ERROR, "this FMU has no variables of type " #TYPE) : OK; \
  }
NO_VARIABLES(Float32, float)
NO_VARIABLES(Int8, int8_t)
NO_VARIABLES(UInt8, uint8_t)
NO_VARIABLES(Int16, int16_t)
NO_VARIABLES(UInt16, uint16_t)
NO_VARIABLES(Int32, int32_t)
NO_VARIABLES(UInt32, uint32_t)
NO_VARIABLES(Int64, int64_t)
NO_VARIABLES(UInt64, uint64_t)
NO_VARIABLES(Boolean, bool)
NO_VARIABLES(String, char *)

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
ABSENT(fmi3GetBinary, const Reference which[], size_t n, size_t sizes[], const uint8_t *values[], size_t count)
ABSENT(fmi3SetBinary, const Reference which[], size_t n, const size_t sizes[], const uint8_t *const values[],
       size_t count)
ABSENT(fmi3GetClock, const Reference which[], size_t n, bool values[])
ABSENT(fmi3SetClock, const Reference which[], size_t n, const bool values[])
ABSENT(fmi3GetNumberOfVariableDependencies, Reference which, size_t *n)
ABSENT(fmi3GetVariableDependencies, Reference which, size_t elements[], Reference on[], size_t elements_on[],
       int kinds[], size_t n)
ABSENT(fmi3GetIntervalDecimal, const Reference which[], size_t n, double intervals[], int qualifiers[])
ABSENT(fmi3GetIntervalFraction, const Reference which[], size_t n, uint64_t counters[], uint64_t resolutions[],
       int qualifiers[])
ABSENT(fmi3GetShiftDecimal, const Reference which[], size_t n, double shifts[])
ABSENT(fmi3GetShiftFraction, const Reference which[], size_t n, uint64_t counters[], uint64_t resolutions[])
ABSENT(fmi3SetIntervalDecimal, const Reference which[], size_t n, const double intervals[])
ABSENT(fmi3SetIntervalFraction, const Reference which[], size_t n, const uint64_t counters[],
       const uint64_t resolutions[])
ABSENT(fmi3SetShiftDecimal, const Reference which[], size_t n, const double shifts[])
ABSENT(fmi3SetShiftFraction, const Reference which[], size_t n, const uint64_t counters[],
       const uint64_t resolutions[])
ABSENT(fmi3GetOutputDerivatives, const Reference which[], size_t n, const int32_t orders[], double values[],
       size_t count)
ABSENT(fmi3DoStep, double from, double size, bool final, bool *event, bool *terminate, bool *early, double *last)
ABSENT(fmi3ActivateModelPartition, Reference clock, double time)
#if !HAS_DERIVATIVES
ABSENT(fmi3GetDirectionalDerivative, const Reference unknowns[], size_t n_unknowns, const Reference knowns[],
       size_t n_knowns, const double seed[], size_t n_seed, double sensitivity[], size_t n_sensitivity)
ABSENT(fmi3GetAdjointDerivative, const Reference unknowns[], size_t n_unknowns, const Reference knowns[],
       size_t n_knowns, const double seed[], size_t n_seed, double sensitivity[], size_t n_sensitivity)
#endif

#define ABSENT_MODE(FUNCTION) \
  FMI3_Export Status NAME(FUNCTION)(void *instance) { return report(instance, ERROR, #FUNCTION " is not supported"); }
ABSENT_MODE(fmi3EnterConfigurationMode)
ABSENT_MODE(fmi3ExitConfigurationMode)
ABSENT_MODE(fmi3EnterStepMode)
ABSENT_MODE(fmi3EvaluateDiscreteStates)

FMI3_Export void *NAME(fmi3InstantiateCoSimulation)(const char *name, const char *token, const char *resources,
                                                    bool visible, bool logging, bool events, bool early,
                                                    const Reference intermediate[], size_t n, void *environment,
                                                    Log log, void (*update)(void)) {
  if (log) log(environment, ERROR, "logStatusError", "this FMU is for model exchange: it has no integrator");
  return NULL;
}

FMI3_Export void *NAME(fmi3InstantiateScheduledExecution)(const char *name, const char *token, const char *resources,
                                                          bool visible, bool logging, void *environment, Log log,
                                                          void (*update)(void), void (*lock)(void),
                                                          void (*unlock)(void)) {
  if (log) log(environment, ERROR, "logStatusError", "this FMU is for model exchange: it has no clocks");
  return NULL;
}
