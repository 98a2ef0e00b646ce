/* @METHOD@ as a co-simulation unit of FMI 2.0: the functions of the standard. */
#include "unit.c"

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *folder, const void *callbacks,
                          int visible, int logging)
{
    (void)name, (void)type, (void)guid, (void)folder, (void)callbacks, (void)visible, (void)logging;
    return begin_unit();
}

API void fmi2FreeInstance(void *unit)
{
    (void)unit;
    in_use = 0;
}

API int fmi2SetupExperiment(void *unit, int has_tolerance, double tolerance, double start, int has_stop, double stop)
{
    (void)unit, (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    now = start;
    return OK;
}

API int fmi2EnterInitializationMode(void *unit)
{
    (void)unit;
    return OK;
}

API int fmi2ExitInitializationMode(void *unit) { return initialise(unit); }
API int fmi2Reset(void *unit) { return forget_unit(unit); }

API int fmi2Terminate(void *unit)
{
    (void)unit;
    return OK;
}

API int fmi2SetDebugLogging(void *unit, int on, size_t n, const char *const categories[])
{
    (void)unit, (void)on, (void)n, (void)categories;
    return OK;
}

API int fmi2SetReal(void *unit, const reference_of which[], size_t n, const double values[])
{
    (void)unit;
    return set_reals(which, n, values);
}

API int fmi2GetReal(void *unit, const reference_of which[], size_t n, double values[])
{
    (void)unit;
    return get_reals(which, n, values);
}

API int fmi2SetBoolean(void *unit, const reference_of which[], size_t n, const int values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (!flag(which[k]))
            return ERROR;
        *flag(which[k]) = values[k] != 0;
    }
    return OK;
}

API int fmi2GetBoolean(void *unit, const reference_of which[], size_t n, int values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (!flag(which[k]))
            return ERROR;
        values[k] = *flag(which[k]);
    }
    return OK;
}

API int fmi2GetInteger(void *unit, const reference_of which[], size_t n, int values[])
{
    size_t k;
    (void)unit;
    for (k = 0; k < n; k++) {
        if (which[k] != STATUS)
            return ERROR;
        values[k] = answer.status;
    }
    return OK;
}

API int fmi2DoStep(void *unit, double t, double step, int no_set_back)
{
    (void)no_set_back;
    return step_to(unit, t, step);
}

/* What this unit does not do. */
#define NOT_HERE(name)           \
    API int fmi2##name(void); \
    API int fmi2##name(void) { return ERROR; }
NOT_HERE(SetInteger) NOT_HERE(SetString) NOT_HERE(GetString) NOT_HERE(GetFMUstate) NOT_HERE(SetFMUstate)
NOT_HERE(FreeFMUstate) NOT_HERE(SerializedFMUstateSize) NOT_HERE(SerializeFMUstate) NOT_HERE(DeSerializeFMUstate)
NOT_HERE(GetDirectionalDerivative) NOT_HERE(SetRealInputDerivatives) NOT_HERE(GetRealOutputDerivatives)
NOT_HERE(CancelStep) NOT_HERE(GetStatus) NOT_HERE(GetRealStatus) NOT_HERE(GetIntegerStatus) NOT_HERE(GetBooleanStatus)
NOT_HERE(GetStringStatus)
