/* @METHOD@ as a unit for co-simulation: variables by value reference, one step a sample. What every version of FMI shares. */
#include "@NAME@.c"

#if defined(__GNUC__)
#define API __attribute__((visibility("default")))
#else
#define API
#endif

typedef unsigned reference_of;
enum { OK = 0, ERROR = 3 }; /* fmi2Status, fmi3Status */

static ahrs_sample sample;
static ahrs_estimate answer;
static ahrs_site where;
static ahrs_sensors what;
static double quiet, now;

/* By value reference: inputs and parameters, which can be set, then outputs; then the flags, the status, the time. */
static double *const reals[] = {
@REALS@
};
static uint8_t *const flags[] = {@FLAGS@};
enum {
    SETTABLE = @SETTABLE@,
    REALS = sizeof reals / sizeof *reals,
    STATUS = REALS + sizeof flags / sizeof *flags,
    TIME
};

static void nothing(void)
{
    size_t k;
    quiet = 0.0;
    quiet /= quiet; /* NaN */
    for (k = 0; k < offsetof(ahrs_estimate, status) / sizeof(double); k++)
        ((double *)&answer)[k] = quiet;
    answer.status = AHRS_ALIGNING;
}

static void *begin_unit(void)
{
    size_t k;
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

static int initialise(const void *unit)
{
    in_use = 0;
    return ahrs_create(&where, &what, "") == unit ? OK : ERROR;
}

static int forget_unit(void *unit)
{
    ahrs_reset(unit);
    nothing();
    return OK;
}

static int set_reals(const reference_of which[], size_t n, const double values[])
{
    size_t k;
    for (k = 0; k < n; k++) {
        if (which[k] >= SETTABLE)
            return ERROR;
        *reals[which[k]] = values[k];
    }
    return OK;
}

static int get_reals(const reference_of which[], size_t n, double values[])
{
    size_t k;
    for (k = 0; k < n; k++) {
        if (which[k] >= REALS && which[k] != TIME)
            return ERROR;
        values[k] = which[k] == TIME ? now : *reals[which[k]];
    }
    return OK;
}

static uint8_t *flag(reference_of which)
{
    return which >= REALS && which < STATUS ? flags[which - REALS] : NULL;
}

static int step_to(void *unit, double t, double step)
{
    double given = sample.t;
    int status;
    if (!(given > t && given <= t + 1.5 * step)) /* not connected: the end of the step */
        sample.t = t + step;
    nothing();
    answer.t = sample.t;
    status = ahrs_process(unit, &sample, 1, &answer) ? ERROR : OK;
    sample.t = given;
    now = t + step;
    return status;
}
