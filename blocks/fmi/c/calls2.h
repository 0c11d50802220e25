/* The functions of FMI 2.0 that are handed on to another process: see calls.h. */
#ifndef BLOCKS_CALLS2_H
#define BLOCKS_CALLS2_H

#include "fmi2.h"

#define FMI(name) fmi2##name

#define OTHERS(C) C(Instantiate, NONE) C(FreeInstance, NONE)

#define REFERENCES(name, n) IN(0, fmi2ValueReference, name, n), NUMBER(0, size_t, n)
#define GET(C, type) C(Get##type, REFERENCES(vr, nvr), OUT(1, fmi2##type, value, nvr))
#define SET(C, type) C(Set##type, REFERENCES(vr, nvr), IN(1, fmi2##type, value, nvr))
#define GET_REALS(C, name) C(name, OUT(0, fmi2Real, values, n), NUMBER(0, size_t, n))
#define ASK(C, name, type) C(name, NUMBER(0, fmi2StatusKind, s), OUT(0, type, value, 1))

#define CALLS(C)                                                                                                   \
    C(SetDebugLogging, NUMBER(0, fmi2Boolean, loggingOn), NUMBER(1, size_t, nCategories),                          \
      TEXTS_IN(0, "a category", categories, nCategories))                                                          \
    C(SetupExperiment, NUMBER(0, fmi2Boolean, toleranceDefined), REAL(0, tolerance), REAL(1, startTime),           \
      NUMBER(1, fmi2Boolean, stopTimeDefined), REAL(2, stopTime))                                                  \
    C(EnterInitializationMode, NONE) C(ExitInitializationMode, NONE) C(Terminate, NONE) C(Reset, NONE)             \
    GET(C, Real) GET(C, Integer) GET(C, Boolean) SET(C, Real) SET(C, Integer) SET(C, Boolean)                      \
    C(GetString, REFERENCES(vr, nvr), TEXTS_OUT(1, "strings", value, nvr))                                         \
    C(SetString, REFERENCES(vr, nvr), TEXTS_IN(1, "a value", value, nvr))                                          \
    C(GetFMUstate, STATE_INOUT(0, FMUstate)) C(SetFMUstate, STATE(0, FMUstate))                                    \
    C(FreeFMUstate, STATE_INOUT(0, FMUstate))                                                                      \
    C(SerializedFMUstateSize, STATE(0, FMUstate), OUT(0, size_t, size, 1))                                         \
    C(SerializeFMUstate, STATE(0, FMUstate), OUT(0, fmi2Byte, serializedState, size), NUMBER(1, size_t, size))     \
    C(DeSerializeFMUstate, IN(0, fmi2Byte, serializedState, size), NUMBER(0, size_t, size),                        \
      STATE_INOUT(1, FMUstate))                                                                                    \
    C(GetDirectionalDerivative, REFERENCES(unknowns, nUnknown), IN(1, fmi2ValueReference, knowns, nKnown),         \
      NUMBER(1, size_t, nKnown), IN(2, fmi2Real, dvKnown, nKnown), OUT(3, fmi2Real, dvUnknown, nUnknown))          \
    C(EnterEventMode, NONE) C(NewDiscreteStates, OUT(0, fmi2EventInfo, eventInfo, 1))                              \
    C(EnterContinuousTimeMode, NONE)                                                                               \
    C(CompletedIntegratorStep, NUMBER(0, fmi2Boolean, noSetFMUStatePriorToCurrentPoint), OUT(0, fmi2Boolean, enterEventMode, 1),            \
      OUT(1, fmi2Boolean, terminateSimulation, 1))                                                                 \
    C(SetTime, REAL(0, time)) C(SetContinuousStates, IN(0, fmi2Real, x, nx), NUMBER(0, size_t, nx))                \
    GET_REALS(C, GetDerivatives) GET_REALS(C, GetEventIndicators) GET_REALS(C, GetContinuousStates)                \
    GET_REALS(C, GetNominalsOfContinuousStates)                                                                    \
    C(SetRealInputDerivatives, REFERENCES(vr, nvr), IN(1, fmi2Integer, order, nvr), IN(2, fmi2Real, value, nvr))   \
    C(GetRealOutputDerivatives, REFERENCES(vr, nvr), IN(1, fmi2Integer, order, nvr), OUT(2, fmi2Real, value, nvr)) \
    C(DoStep, REAL(0, t), REAL(1, h), NUMBER(0, fmi2Boolean, noSetFMUStatePriorToCurrentPoint)) C(CancelStep, NONE)                  \
    ASK(C, GetStatus, fmi2Status) ASK(C, GetRealStatus, fmi2Real) ASK(C, GetIntegerStatus, fmi2Integer)            \
    ASK(C, GetBooleanStatus, fmi2Boolean)                                                                          \
    C(GetStringStatus, NUMBER(0, fmi2StatusKind, s), TEXTS_OUT(0, "string", value, 1))

#include "calls.h"

#endif
