/* @METHOD@ as a co-simulation unit of FMI 2.0: variables by name in modelDescription.xml, one step a sample. */
#include "@NAME@.c"

#if defined(__GNUC__)
#define API __attribute__((visibility("default")))
#else
#define API
#endif

typedef int fmi2Status;
enum { fmi2OK = 0, fmi2Error = 3 };
typedef unsigned reference_of;

static ahrs_sample sample;
static ahrs_estimate answer;
static ahrs_site where;
static ahrs_sensors what;
static double quiet;

/* By value reference: inputs and parameters, which can be set, then outputs. */
static double *const reals[] = {
@REALS@
};
enum { SETTABLE = @SETTABLE@ };
static uint8_t *const flags[] = {@FLAGS@};

static void nothing(void)
{
    size_t k;
    quiet = 0.0;
    quiet /= quiet; /* NaN */
    for (k = 0; k < offsetof(ahrs_estimate, status) / sizeof(double); k++)
        ((double *)&answer)[k] = quiet;
    answer.status = AHRS_ALIGNING;
}

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *folder, const void *callbacks,
                          int visible, int logging)
{
    size_t k;
    (void)name, (void)type, (void)guid, (void)folder, (void)callbacks, (void)visible, (void)logging;
    if (in_use)
        return NULL; /* canBeInstantiatedOnlyOncePerProcess */
    nothing();
    for (k = 0; k < offsetof(ahrs_sample, mag_new) / sizeof(double); k++)
        ((double *)&sample)[k] = quiet;
    for (k = 0; k < sizeof flags / sizeof *flags; k++)
        *flags[k] = 0;
    where = (ahrs_site){{0.0, 0.0, 0.0}, 9.80665, {2.2e-5, 0.0, 4.2e-5}};
    what = suite;
    in_use = 1;
    return &the_estimator;
}

API void fmi2FreeInstance(void *unit)
{
    (void)unit;
    in_use = 0;
}

API fmi2Status fmi2EnterInitializationMode(void *unit)
{
    (void)unit;
    return fmi2OK;
}

API fmi2Status fmi2ExitInitializationMode(void *unit)
{
    in_use = 0;
    return ahrs_create(&where, &what, "") == unit ? fmi2OK : fmi2Error;
}

API fmi2Status fmi2Reset(void *unit)
{
    ahrs_reset(unit);
    nothing();
    return fmi2OK;
}

API fmi2Status fmi2SetupExperiment(void *unit, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)unit, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return fmi2OK;
}

API fmi2Status fmi2Terminate(void *unit)
{
    (void)unit;
    return fmi2OK;
}

API fmi2Status fmi2SetDebugLogging(void *unit, int on, size_t n, const char *const categories[])
{
    (void)unit, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

API fmi2Status fmi2SetReal(void *unit, const reference_of which[], size_t n, const double values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (which[k] >= SETTABLE)
            return fmi2Error;
        *reals[which[k]] = values[k];
    }
    return fmi2OK;
}

API fmi2Status fmi2GetReal(void *unit, const reference_of which[], size_t n, double values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (which[k] >= sizeof reals / sizeof *reals)
            return fmi2Error;
        values[k] = *reals[which[k]];
    }
    return fmi2OK;
}

API fmi2Status fmi2SetBoolean(void *unit, const reference_of which[], size_t n, const int values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (which[k] >= sizeof flags / sizeof *flags)
            return fmi2Error;
        *flags[which[k]] = values[k] != 0;
    }
    return fmi2OK;
}

API fmi2Status fmi2GetBoolean(void *unit, const reference_of which[], size_t n, int values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (which[k] >= sizeof flags / sizeof *flags)
            return fmi2Error;
        values[k] = *flags[which[k]];
    }
    return fmi2OK;
}

API fmi2Status fmi2GetInteger(void *unit, const reference_of which[], size_t n, int values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (which[k] != 0)
            return fmi2Error;
        values[k] = answer.status;
    }
    return fmi2OK;
}

API fmi2Status fmi2DoStep(void *unit, double t, double step, int no_set_back)
{
    double given = sample.t;
    fmi2Status status;
    (void)no_set_back;
    if (!(given > t && given <= t + 1.5 * step)) /* not connected: the end of the step */
        sample.t = t + step;
    nothing();
    answer.t = sample.t;
    status = ahrs_process(unit, &sample, 1, &answer) ? fmi2Error : fmi2OK;
    sample.t = given;
    return status;
}

/* What this unit does not do. */
#define NOT_HERE(name)                                                                                                         \
    API fmi2Status name(void);                                                                                                 \
    API fmi2Status name(void) { return fmi2Error; }
NOT_HERE(fmi2SetInteger)
NOT_HERE(fmi2SetString)
NOT_HERE(fmi2GetString)
NOT_HERE(fmi2GetFMUstate)
NOT_HERE(fmi2SetFMUstate)
NOT_HERE(fmi2FreeFMUstate)
NOT_HERE(fmi2SerializedFMUstateSize)
NOT_HERE(fmi2SerializeFMUstate)
NOT_HERE(fmi2DeSerializeFMUstate)
NOT_HERE(fmi2GetDirectionalDerivative)
NOT_HERE(fmi2SetRealInputDerivatives)
NOT_HERE(fmi2GetRealOutputDerivatives)
NOT_HERE(fmi2CancelStep)
NOT_HERE(fmi2GetStatus)
NOT_HERE(fmi2GetRealStatus)
NOT_HERE(fmi2GetIntegerStatus)
NOT_HERE(fmi2GetBooleanStatus)
NOT_HERE(fmi2GetStringStatus)
