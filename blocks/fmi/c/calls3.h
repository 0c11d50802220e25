/* The functions of FMI 3.0 that are handed on to another process. */
#ifndef BLOCKS_CALLS3_H
#define BLOCKS_CALLS3_H

#include "channel.h"

/* The types whose values are numbers, and go in arrays as they are. */
#define FMI3_TYPES(T) \
    T(Float32) T(Float64) T(Int8) T(UInt8) T(Int16) T(UInt16) T(Int32) T(UInt32) T(Int64) T(UInt64) T(Boolean)

#define FMI3_CALLS(C)                                                                                              \
    C(InstantiateModelExchange) C(InstantiateCoSimulation) C(FreeInstance) C(SetDebugLogging)                      \
    C(EnterInitializationMode) C(ExitInitializationMode) C(EnterEventMode) C(Terminate) C(Reset)                   \
    C(GetFloat32) C(GetFloat64) C(GetInt8) C(GetUInt8) C(GetInt16) C(GetUInt16) C(GetInt32) C(GetUInt32)           \
    C(GetInt64) C(GetUInt64) C(GetBoolean) C(GetString)                                                            \
    C(SetFloat32) C(SetFloat64) C(SetInt8) C(SetUInt8) C(SetInt16) C(SetUInt16) C(SetInt32) C(SetUInt32)           \
    C(SetInt64) C(SetUInt64) C(SetBoolean) C(SetString)                                                            \
    C(GetNumberOfVariableDependencies) C(GetVariableDependencies) C(GetFMUState) C(SetFMUState) C(FreeFMUState)    \
    C(SerializedFMUStateSize) C(SerializeFMUState) C(DeserializeFMUState) C(GetDirectionalDerivative)              \
    C(GetAdjointDerivative) C(EnterConfigurationMode) C(ExitConfigurationMode) C(EvaluateDiscreteStates)           \
    C(UpdateDiscreteStates) C(EnterContinuousTimeMode) C(CompletedIntegratorStep) C(SetTime)                       \
    C(SetContinuousStates) C(GetContinuousStateDerivatives) C(GetEventIndicators) C(GetContinuousStates)           \
    C(GetNominalsOfContinuousStates) C(GetNumberOfEventIndicators) C(GetNumberOfContinuousStates)                  \
    C(EnterStepMode) C(GetOutputDerivatives) C(DoStep)

#define FMI3_NUMBER(name) FMI3_##name,
enum { FMI3_BEFORE = FIRST_FUNCTION - 1, FMI3_CALLS(FMI3_NUMBER) FMI3_END };
#undef FMI3_NUMBER

#endif
