/* @METHOD@ as a co-simulation unit of FMI 3.0: the functions of the standard. */
#include <stdbool.h>

#include "unit.c"

API const char *fmi3GetVersion(void) { return "3.0"; }

API void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *folder, bool visible, bool logging,
                                      bool events, bool early, const reference_of required[], size_t n,
                                      const void *environment, const void *log, const void *update)
{
    (void)name, (void)token, (void)folder, (void)visible, (void)logging, (void)events, (void)early, (void)required;
    (void)n, (void)environment, (void)log, (void)update;
    return begin_unit();
}

API void fmi3FreeInstance(void *unit)
{
    (void)unit;
    in_use = 0;
}

API int fmi3EnterInitializationMode(void *unit, bool has_tolerance, double tolerance, double start, bool has_stop,
                                    double stop)
{
    (void)unit, (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    now = start;
    return OK;
}

API int fmi3ExitInitializationMode(void *unit) { return initialise(unit); }
API int fmi3Reset(void *unit) { return forget_unit(unit); }

API int fmi3Terminate(void *unit)
{
    (void)unit;
    return OK;
}

API int fmi3SetDebugLogging(void *unit, bool on, size_t n, const char *const categories[])
{
    (void)unit, (void)on, (void)n, (void)categories;
    return OK;
}

API int fmi3SetFloat64(void *unit, const reference_of which[], size_t n, const double values[], size_t m)
{
    (void)unit;
    return n == m ? set_reals(which, n, values) : ERROR;
}

API int fmi3GetFloat64(void *unit, const reference_of which[], size_t n, double values[], size_t m)
{
    (void)unit;
    return n == m ? get_reals(which, n, values) : ERROR;
}

API int fmi3SetBoolean(void *unit, const reference_of which[], size_t n, const bool values[], size_t m)
{
    size_t k;
    (void)unit;
    for (k = 0; k < n && n == m; k++) {
        if (!flag(which[k]))
            return ERROR;
        *flag(which[k]) = values[k];
    }
    return n == m ? OK : ERROR;
}

API int fmi3GetBoolean(void *unit, const reference_of which[], size_t n, bool values[], size_t m)
{
    size_t k;
    (void)unit;
    for (k = 0; k < n && n == m; k++) {
        if (!flag(which[k]))
            return ERROR;
        values[k] = *flag(which[k]) != 0;
    }
    return n == m ? OK : ERROR;
}

API int fmi3GetInt32(void *unit, const reference_of which[], size_t n, int32_t values[], size_t m)
{
    size_t k;
    (void)unit;
    for (k = 0; k < n && n == m; k++) {
        if (which[k] != STATUS)
            return ERROR;
        values[k] = answer.status;
    }
    return n == m ? OK : ERROR;
}

API int fmi3DoStep(void *unit, double t, double step, bool no_set_back, bool *event, bool *end, bool *early, double *reached)
{
    (void)no_set_back;
    *event = *end = *early = false;
    *reached = t + step;
    return step_to(unit, t, step);
}

/* What this unit does not do. */
#define NOT_HERE(name)           \
    API int fmi3##name(void); \
    API int fmi3##name(void) { return ERROR; }
NOT_HERE(ActivateModelPartition) NOT_HERE(CompletedIntegratorStep) NOT_HERE(DeserializeFMUState)
NOT_HERE(EnterConfigurationMode) NOT_HERE(EnterContinuousTimeMode) NOT_HERE(EnterEventMode) NOT_HERE(EnterStepMode)
NOT_HERE(EvaluateDiscreteStates) NOT_HERE(ExitConfigurationMode) NOT_HERE(FreeFMUState) NOT_HERE(GetAdjointDerivative)
NOT_HERE(GetBinary) NOT_HERE(GetClock) NOT_HERE(GetContinuousStateDerivatives) NOT_HERE(GetContinuousStates)
NOT_HERE(GetDirectionalDerivative) NOT_HERE(GetEventIndicators) NOT_HERE(GetFMUState) NOT_HERE(GetFloat32)
NOT_HERE(GetInt16) NOT_HERE(GetInt64) NOT_HERE(GetInt8) NOT_HERE(GetIntervalDecimal) NOT_HERE(GetIntervalFraction)
NOT_HERE(GetNominalsOfContinuousStates) NOT_HERE(GetNumberOfContinuousStates) NOT_HERE(GetNumberOfEventIndicators)
NOT_HERE(GetNumberOfVariableDependencies) NOT_HERE(GetOutputDerivatives) NOT_HERE(GetShiftDecimal)
NOT_HERE(GetShiftFraction) NOT_HERE(GetString) NOT_HERE(GetUInt16) NOT_HERE(GetUInt32) NOT_HERE(GetUInt64)
NOT_HERE(GetUInt8) NOT_HERE(GetVariableDependencies) NOT_HERE(SerializeFMUState) NOT_HERE(SerializedFMUStateSize)
NOT_HERE(SetBinary) NOT_HERE(SetClock) NOT_HERE(SetContinuousStates) NOT_HERE(SetFMUState) NOT_HERE(SetFloat32)
NOT_HERE(SetInt16) NOT_HERE(SetInt32) NOT_HERE(SetInt64) NOT_HERE(SetInt8) NOT_HERE(SetIntervalDecimal)
NOT_HERE(SetIntervalFraction) NOT_HERE(SetShiftDecimal) NOT_HERE(SetShiftFraction) NOT_HERE(SetString)
NOT_HERE(SetTime) NOT_HERE(SetUInt16) NOT_HERE(SetUInt32) NOT_HERE(SetUInt64) NOT_HERE(SetUInt8)
NOT_HERE(UpdateDiscreteStates)

API void *fmi3InstantiateModelExchange(void);
API void *fmi3InstantiateModelExchange(void) { return NULL; }
API void *fmi3InstantiateScheduledExecution(void);
API void *fmi3InstantiateScheduledExecution(void) { return NULL; }
