/* The functions of FMI 3.0 that are handed on to another process: see calls.h. */
#ifndef BLOCKS_CALLS3_H
#define BLOCKS_CALLS3_H

#include "fmi3.h"

#define FMI(name) fmi3##name

#define OTHERS(C) C(InstantiateModelExchange, NONE) C(InstantiateCoSimulation, NONE) C(FreeInstance, NONE)

#define REFERENCES(name, n) IN(0, fmi3ValueReference, name, n), NUMBER(0, size_t, n)
#define GET(C, type) C(Get##type, REFERENCES(vr, nvr), OUT(1, fmi3##type, values, n), NUMBER(1, size_t, n))
#define SET(C, type) C(Set##type, REFERENCES(vr, nvr), IN(1, fmi3##type, values, n), NUMBER(1, size_t, n))
/* The types whose values are numbers, and go in arrays as they are. */
#define OF_TYPES(M, C)                                                                                   \
    M(C, Float32) M(C, Float64) M(C, Int8) M(C, UInt8) M(C, Int16) M(C, UInt16) M(C, Int32) M(C, UInt32) \
    M(C, Int64) M(C, UInt64) M(C, Boolean)
#define GET_REALS(C, name) C(name, OUT(0, fmi3Float64, values, n), NUMBER(0, size_t, n))
#define DERIVATIVE(C, name)                                                                  \
    C(name, REFERENCES(unknowns, nUnknowns), IN(1, fmi3ValueReference, knowns, nKnowns),     \
      NUMBER(1, size_t, nKnowns), IN(2, fmi3Float64, seed, nSeed), NUMBER(2, size_t, nSeed), \
      OUT(3, fmi3Float64, sensitivity, nSensitivity), NUMBER(3, size_t, nSensitivity))

#define CALLS(C)                                                                                                   \
    C(SetDebugLogging, NUMBER(0, fmi3Boolean, loggingOn), NUMBER(1, size_t, nCategories),                          \
      TEXTS_IN(0, "a category", categories, nCategories))                                                          \
    C(EnterInitializationMode, NUMBER(0, fmi3Boolean, toleranceDefined), REAL(0, tolerance), REAL(1, startTime),   \
      NUMBER(1, fmi3Boolean, stopTimeDefined), REAL(2, stopTime))                                                  \
    C(ExitInitializationMode, NONE) C(EnterEventMode, NONE) C(Terminate, NONE) C(Reset, NONE)                      \
    OF_TYPES(GET, C) OF_TYPES(SET, C)                                                                              \
    C(GetString, REFERENCES(vr, nvr), TEXTS_OUT(1, "strings", values, n), NUMBER(1, size_t, n))                    \
    C(SetString, REFERENCES(vr, nvr), TEXTS_IN(1, "a value", values, n), NUMBER(1, size_t, n))                     \
    C(GetNumberOfVariableDependencies, NUMBER(0, fmi3ValueReference, vr), OUT(0, size_t, n, 1))                    \
    C(GetVariableDependencies, NUMBER(0, fmi3ValueReference, vr), OUT(0, size_t, elements, n),                     \
      OUT(1, fmi3ValueReference, independents, n), OUT(2, size_t, elementsOfIndependents, n),                      \
      OUT(3, fmi3DependencyKind, kinds, n), NUMBER(1, size_t, n))                                                  \
    C(GetFMUState, STATE_INOUT(0, FMUState)) C(SetFMUState, STATE(0, FMUState))                                    \
    C(FreeFMUState, STATE_INOUT(0, FMUState))                                                                      \
    C(SerializedFMUStateSize, STATE(0, FMUState), OUT(0, size_t, size, 1))                                         \
    C(SerializeFMUState, STATE(0, FMUState), OUT(0, fmi3Byte, serializedState, size), NUMBER(1, size_t, size))     \
    C(DeserializeFMUState, IN(0, fmi3Byte, serializedState, size), NUMBER(0, size_t, size),                        \
      STATE_INOUT(1, FMUState))                                                                                    \
    DERIVATIVE(C, GetDirectionalDerivative) DERIVATIVE(C, GetAdjointDerivative)                                    \
    C(EnterConfigurationMode, NONE) C(ExitConfigurationMode, NONE) C(EvaluateDiscreteStates, NONE)                 \
    C(UpdateDiscreteStates, OUT(0, fmi3Boolean, needUpdate, 1), OUT(1, fmi3Boolean, terminateSimulation, 1),       \
      OUT(2, fmi3Boolean, nominalsChanged, 1), OUT(3, fmi3Boolean, valuesChanged, 1),                              \
      OUT(4, fmi3Boolean, nextTimeDefined, 1), OUT(5, fmi3Float64, nextTime, 1))                                   \
    C(EnterContinuousTimeMode, NONE)                                                                               \
    C(CompletedIntegratorStep, NUMBER(0, fmi3Boolean, noSetFMUStatePriorToCurrentPoint), OUT(0, fmi3Boolean, enterEventMode, 1),            \
      OUT(1, fmi3Boolean, terminateSimulation, 1))                                                                 \
    C(SetTime, REAL(0, time)) C(SetContinuousStates, IN(0, fmi3Float64, x, nx), NUMBER(0, size_t, nx))             \
    GET_REALS(C, GetContinuousStateDerivatives) GET_REALS(C, GetEventIndicators) GET_REALS(C, GetContinuousStates) \
    GET_REALS(C, GetNominalsOfContinuousStates)                                                                    \
    C(GetNumberOfEventIndicators, OUT(0, size_t, n, 1)) C(GetNumberOfContinuousStates, OUT(0, size_t, n, 1))       \
    C(EnterStepMode, NONE)                                                                                         \
    C(GetOutputDerivatives, REFERENCES(vr, nvr), IN(1, fmi3Int32, orders, nvr), OUT(2, fmi3Float64, values, n),    \
      NUMBER(1, size_t, n))                                                                                        \
    C(DoStep, REAL(0, t), REAL(1, h), NUMBER(0, fmi3Boolean, noSetFMUStatePriorToCurrentPoint), OUT(0, fmi3Boolean, eventHandlingNeeded, 1),  \
      OUT(1, fmi3Boolean, terminateSimulation, 1), OUT(2, fmi3Boolean, earlyReturn, 1), OUT(3, fmi3Float64, lastSuccessfulTime, 1))

#include "calls.h"

#endif
