/* The optional functions of FMI 3.0: derivatives, the state of the FMU, and those that this FMU does not support. */

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
