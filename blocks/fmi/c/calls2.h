/* The functions of FMI 2.0 that are handed on to another process. */
#ifndef BLOCKS_CALLS2_H
#define BLOCKS_CALLS2_H

#include "channel.h"

#define FMI2_CALLS(C)                                                                                              \
    C(Instantiate) C(FreeInstance) C(SetDebugLogging) C(SetupExperiment) C(EnterInitializationMode)                \
    C(ExitInitializationMode) C(Terminate) C(Reset)                                                                \
    C(GetReal) C(GetInteger) C(GetBoolean) C(GetString) C(SetReal) C(SetInteger) C(SetBoolean) C(SetString)        \
    C(GetFMUstate) C(SetFMUstate) C(FreeFMUstate) C(SerializedFMUstateSize) C(SerializeFMUstate)                   \
    C(DeSerializeFMUstate) C(GetDirectionalDerivative)                                                             \
    C(EnterEventMode) C(NewDiscreteStates) C(EnterContinuousTimeMode) C(CompletedIntegratorStep) C(SetTime)        \
    C(SetContinuousStates) C(GetDerivatives) C(GetEventIndicators) C(GetContinuousStates)                          \
    C(GetNominalsOfContinuousStates)                                                                               \
    C(SetRealInputDerivatives) C(GetRealOutputDerivatives) C(DoStep) C(CancelStep) C(GetStatus) C(GetRealStatus)   \
    C(GetIntegerStatus) C(GetBooleanStatus) C(GetStringStatus)

#define FMI2_NUMBER(name) FMI2_##name,
enum { FMI2_BEFORE = FIRST_FUNCTION - 1, FMI2_CALLS(FMI2_NUMBER) FMI2_END };
#undef FMI2_NUMBER

#endif
