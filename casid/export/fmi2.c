/* FMI 2.0 (Model Exchange and Co-Simulation) around the equations and the step of a model.

   config.h defines the sizes, the sample time, what inputs do within a sample, and the GUID;
   model.h declares model_equations, model_step, model_x0 and model_p.

   A model with delays has a memory of NPAST numbers; its steps are whole samples, and
   there is no model exchange, as it has no time between its samples.

   Value references: states, derivatives of states, inputs, outputs, parameters, in this order.
*/
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "config.h"
#include "model.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Types of the standard: fmi2TypesPlatform.h and fmi2FunctionTypes.h. */
typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
  fmi2DoStepStatus,
  fmi2PendingStatus,
  fmi2LastSuccessfulTime,
  fmi2Terminated
} fmi2StatusKind;
typedef void (*fmi2Logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String,
                           ...);
typedef struct {
  fmi2Logger logger;
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
  fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
  fmi2Boolean newDiscreteStatesNeeded;
  fmi2Boolean terminateSimulation;
  fmi2Boolean nominalsOfContinuousStatesChanged;
  fmi2Boolean valuesOfContinuousStatesChanged;
  fmi2Boolean nextEventTimeDefined;
  fmi2Real nextEventTime;
} fmi2EventInfo;

/* Arrays of C have at least one element. */
#define SIZE(n) ((n) > 0 ? (n) : 1)

typedef struct {
  double x[SIZE(NX)], u[SIZE(NU)], slope[SIZE(NU)], p[SIZE(NP)];
  double t;
#if NPAST > 0
  double past[NPAST];
#endif
} Values;

typedef struct {
  Values now;
  const fmi2CallbackFunctions *callbacks;
  char name[256];
} Instance;

static const double shares[SIZE(NU)] = SHARES;

static fmi2Status refuse(Instance *c, const char *message) {
  if (c != NULL && c->callbacks != NULL && c->callbacks->logger != NULL)
    c->callbacks->logger(c->callbacks->componentEnvironment, c->name, fmi2Error, "logStatusError",
                         message);
  return fmi2Error;
}

static void begin(Instance *c) {
  memset(&c->now, 0, sizeof(Values));
  memcpy(c->now.x, model_x0, NX * sizeof(double));
  memcpy(c->now.p, model_p, NP * sizeof(double));
  c->now.t = T_START;
}

/* Inputs `after` seconds from now: along their slopes as far as they move within a sample. */
static void inputs_after(const Values *v, double after, double *u) {
  int i;
  for (i = 0; i < NU; i++) u[i] = v->u[i] + shares[i] * after * v->slope[i];
}

/* The step of the fit, one sample long. */
static void sample_step(const Values *v, const double *u, const double *u_next, Values *after,
                        double *y) {
#if NPAST > 0
  model_step(v->x, u, u_next, v->t, v->p, v->past, after->x, y, after->past);
#else
  model_step(v->x, u, u_next, v->t, v->p, after->x, y);
#endif
}

/* The outputs now. A delay of less than a sample takes the outputs around the next one as well:
   they are those of a step along the slopes that the inputs have. */
static void outputs_now(const Values *v, double *y) {
#if NPAST > 0
  Values after;
  double u_next[SIZE(NU)];
  inputs_after(v, SAMPLE_TIME, u_next);
  sample_step(v, v->u, u_next, &after, y);
#else
  double dx[SIZE(NX)];
  model_equations(v->x, v->u, v->t, v->p, dx, y);
#endif
}

/* One Runge-Kutta step of h seconds, `done` seconds after the inputs were set. */
static void part_step(Values *v, double done, double h) {
  double u[SIZE(NU)], y[SIZE(NY)], x[SIZE(NX)];
  double k[4][SIZE(NX)];
  const double at[4] = {0.0, 0.5, 0.5, 1.0};
  int i, s;
  for (s = 0; s < 4; s++) {
    for (i = 0; i < NX; i++) x[i] = v->x[i] + (s > 0 ? at[s] * h * k[s - 1][i] : 0.0);
    inputs_after(v, done + at[s] * h, u);
    model_equations(x, u, v->t + at[s] * h, v->p, k[s], y);
  }
  for (i = 0; i < NX; i++) v->x[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
  v->t += h;
}

/* ---- common to both kinds ---- */

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n,
                                      const fmi2String categories[]) {
  (void)c, (void)on, (void)n, (void)categories;
  return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
                                     fmi2String resources,
                                     const fmi2CallbackFunctions *callbacks, fmi2Boolean visible,
                                     fmi2Boolean logging) {
  Instance *c;
  (void)type, (void)resources, (void)visible, (void)logging;
  if (guid == NULL || strcmp(guid, GUID) != 0) return NULL;
  c = (Instance *)calloc(1, sizeof(Instance));
  if (c == NULL) return NULL;
  c->callbacks = callbacks;
  if (name != NULL) strncpy(c->name, name, sizeof(c->name) - 1);
  begin(c);
  return c;
}

EXPORT void fmi2FreeInstance(fmi2Component c) { free(c); }

EXPORT fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance,
                                      fmi2Real tolerance, fmi2Real start, fmi2Boolean has_stop,
                                      fmi2Real stop) {
  (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
  ((Instance *)c)->now.t = start;
  return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (void)c, fmi2OK; }

EXPORT fmi2Status fmi2Terminate(fmi2Component c) { return (void)c, fmi2OK; }

EXPORT fmi2Status fmi2Reset(fmi2Component c) { return begin((Instance *)c), fmi2OK; }

/* The variable of a value reference that can be set, or null. */
static double *settable(Values *v, fmi2ValueReference r) {
  if (r < NX) return &v->x[r];
  if (r >= 2 * NX && r < 2 * NX + NU) return &v->u[r - 2 * NX];
  if (r >= 2 * NX + NU + NY && r < 2 * NX + NU + NY + NP) return &v->p[r - 2 * NX - NU - NY];
  return NULL;
}

EXPORT fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference r[], size_t n,
                              fmi2Real value[]) {
  Instance *c = (Instance *)component;
  double dx[SIZE(NX)], y[SIZE(NY)], given[SIZE(NY)];
  int is_evaluated = 0;
  size_t i;
  for (i = 0; i < n; i++) {
    const double *held = settable(&c->now, r[i]);
    if (held != NULL) {
      value[i] = *held;
      continue;
    }
    if (r[i] >= 2 * NX + NU + NY) return refuse(c, "fmi2GetReal: no such value reference");
    if (!is_evaluated) {
      model_equations(c->now.x, c->now.u, c->now.t, c->now.p, dx, y);
      outputs_now(&c->now, given);
    }
    is_evaluated = 1;
    value[i] = r[i] < 2 * NX ? dx[r[i] - NX] : given[r[i] - 2 * NX - NU];
  }
  return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference r[], size_t n,
                              const fmi2Real value[]) {
  Instance *c = (Instance *)component;
  size_t i;
  for (i = 0; i < n; i++) {
    double *held = settable(&c->now, r[i]);
    if (held == NULL) return refuse(c, "fmi2SetReal: this variable is computed and cannot be set");
    *held = value[i];
    /* An input has no slope unless one is set after it. */
    if (r[i] >= 2 * NX && r[i] < 2 * NX + NU) c->now.slope[r[i] - 2 * NX] = 0.0;
  }
  return fmi2OK;
}

#define NONE_OF(Name, type)                                                                      \
  EXPORT fmi2Status fmi2Get##Name(fmi2Component c, const fmi2ValueReference r[], size_t n,       \
                                  type value[]) {                                                \
    (void)r, (void)value;                                                                        \
    return n == 0 ? fmi2OK : refuse((Instance *)c, "fmi2Get" #Name ": all variables are real");  \
  }                                                                                              \
  EXPORT fmi2Status fmi2Set##Name(fmi2Component c, const fmi2ValueReference r[], size_t n,       \
                                  const type value[]) {                                          \
    (void)r, (void)value;                                                                        \
    return n == 0 ? fmi2OK : refuse((Instance *)c, "fmi2Set" #Name ": all variables are real");  \
  }

NONE_OF(Integer, fmi2Integer)
NONE_OF(Boolean, fmi2Boolean)
NONE_OF(String, fmi2String)

EXPORT fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
  if (*state == NULL) *state = malloc(sizeof(Values));
  if (*state == NULL) return refuse((Instance *)c, "fmi2GetFMUstate: out of memory");
  memcpy(*state, &((Instance *)c)->now, sizeof(Values));
  return fmi2OK;
}

EXPORT fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
  memcpy(&((Instance *)c)->now, state, sizeof(Values));
  return fmi2OK;
}

EXPORT fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
  (void)c;
  free(*state);
  *state = NULL;
  return fmi2OK;
}

EXPORT fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
  (void)c, (void)state;
  *size = sizeof(Values);
  return fmi2OK;
}

EXPORT fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[],
                                        size_t size) {
  if (size < sizeof(Values)) return refuse((Instance *)c, "fmi2SerializeFMUstate: too few bytes");
  memcpy(bytes, state, sizeof(Values));
  return fmi2OK;
}

EXPORT fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                          fmi2FMUstate *state) {
  if (size < sizeof(Values)) return refuse((Instance *)c, "fmi2DeSerializeFMUstate: too few bytes");
  if (*state == NULL) *state = malloc(sizeof(Values));
  if (*state == NULL) return refuse((Instance *)c, "fmi2DeSerializeFMUstate: out of memory");
  memcpy(*state, bytes, sizeof(Values));
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                               size_t n_unknown, const fmi2ValueReference known[],
                                               size_t n_known, const fmi2Real dv_known[],
                                               fmi2Real dv_unknown[]) {
  (void)unknown, (void)n_unknown, (void)known, (void)n_known, (void)dv_known, (void)dv_unknown;
  return refuse((Instance *)c, "fmi2GetDirectionalDerivative is not provided");
}

/* ---- Model Exchange ---- */

EXPORT fmi2Status fmi2EnterEventMode(fmi2Component c) { return (void)c, fmi2OK; }

EXPORT fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
  (void)c;
  memset(info, 0, sizeof(*info));
  return fmi2OK;
}

EXPORT fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { return (void)c, fmi2OK; }

EXPORT fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state,
                                              fmi2Boolean *enter_event, fmi2Boolean *terminate) {
  (void)c, (void)no_set_state;
  *enter_event = *terminate = 0;
  return fmi2OK;
}

EXPORT fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t) {
  ((Instance *)c)->now.t = t;
  return fmi2OK;
}

EXPORT fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
  if (n != NX) return refuse((Instance *)c, "fmi2SetContinuousStates: wrong number of states");
  memcpy(((Instance *)c)->now.x, x, n * sizeof(double));
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
  if (n != NX) return refuse((Instance *)c, "fmi2GetContinuousStates: wrong number of states");
  memcpy(x, ((Instance *)c)->now.x, n * sizeof(double));
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
  const Values *v = &((Instance *)c)->now;
  double y[SIZE(NY)];
  if (n != NX) return refuse((Instance *)c, "fmi2GetDerivatives: wrong number of states");
  model_equations(v->x, v->u, v->t, v->p, dx, y);
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
  (void)c, (void)z, (void)n;
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[],
                                                    size_t n) {
  size_t i;
  (void)c;
  for (i = 0; i < n; i++) nominal[i] = 1.0;
  return fmi2OK;
}

/* ---- Co-Simulation ---- */

EXPORT fmi2Status fmi2SetRealInputDerivatives(fmi2Component component,
                                              const fmi2ValueReference r[], size_t n,
                                              const fmi2Integer order[], const fmi2Real value[]) {
  Instance *c = (Instance *)component;
  size_t i;
  for (i = 0; i < n; i++) {
    if (r[i] < 2 * NX || r[i] >= 2 * NX + NU || order[i] != 1)
      return refuse(c, "fmi2SetRealInputDerivatives: inputs have first derivatives alone");
    c->now.slope[r[i] - 2 * NX] = value[i];
  }
  return fmi2OK;
}

EXPORT fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference r[],
                                               size_t n, const fmi2Integer order[],
                                               fmi2Real value[]) {
  (void)r, (void)n, (void)order, (void)value;
  return refuse((Instance *)c, "fmi2GetRealOutputDerivatives is not provided");
}

/* Whole samples by the step that the model was fitted with, what is left by Runge-Kutta. */
EXPORT fmi2Status fmi2DoStep(fmi2Component component, fmi2Real t, fmi2Real h, fmi2Boolean no_set) {
  Instance *c = (Instance *)component;
  Values *v = &c->now;
  Values after = *v;
  double u[SIZE(NU)], u_next[SIZE(NU)], y[SIZE(NY)], slope, rest;
  long k, samples = (long)floor(h / SAMPLE_TIME + 1e-6);
  int i, s, steps;
  (void)no_set;
  if (!(h > 0.0)) return refuse(c, "fmi2DoStep: the step must be positive");
  rest = h - samples * SAMPLE_TIME;
  if (NPAST > 0 && fabs(rest) > 1e-6 * SAMPLE_TIME)
    return refuse(c, "fmi2DoStep: sensors are delayed; step by whole samples of the fit");
  for (k = 0; k < samples; k++) {
    v->t = t + k * SAMPLE_TIME;
    for (i = 0; i < NU; i++) {
      /* model_step itself leaves held inputs where they are at the beginning of a sample. */
      slope = shares[i] > 0.0 ? v->slope[i] : 0.0;
      u[i] = v->u[i] + slope * (k * SAMPLE_TIME);
      u_next[i] = v->u[i] + slope * ((k + 1) * SAMPLE_TIME);
    }
    sample_step(v, u, u_next, &after, y);
    memcpy(v->x, after.x, NX * sizeof(double));
#if NPAST > 0
    memcpy(v->past, after.past, sizeof(v->past));
#endif
  }
  v->t = t + samples * SAMPLE_TIME;
  if (rest > 1e-6 * SAMPLE_TIME) {
    steps = (int)ceil(rest / SAMPLE_TIME * SUBSTEPS);
    for (s = 0; s < steps; s++) {
      part_step(v, samples * SAMPLE_TIME + s * rest / steps, rest / steps);
    }
  }
  v->t = t + h;
  for (i = 0; i < NX; i++) {
    if (!isfinite(v->x[i])) return refuse(c, "fmi2DoStep: the simulation diverged");
  }
  /* Outputs are read where the inputs have arrived. */
  inputs_after(v, h, u);
  memcpy(v->u, u, NU * sizeof(double));
  memset(v->slope, 0, sizeof(v->slope));
  return fmi2OK;
}

EXPORT fmi2Status fmi2CancelStep(fmi2Component c) {
  return refuse((Instance *)c, "fmi2CancelStep: steps are not asynchronous");
}

#define STATUS_OF(Name, type)                                                                    \
  EXPORT fmi2Status fmi2Get##Name##Status(fmi2Component c, const fmi2StatusKind kind,            \
                                          type *value) {                                         \
    (void)c, (void)kind, (void)value;                                                            \
    return fmi2Discard;                                                                          \
  }

STATUS_OF(, fmi2Status)
STATUS_OF(Real, fmi2Real)
STATUS_OF(Integer, fmi2Integer)
STATUS_OF(Boolean, fmi2Boolean)
STATUS_OF(String, fmi2String)
