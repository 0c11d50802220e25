/* Functions of the standards that the model has no use for. They are there because importers ask for all of them. */
#ifdef _WIN32
#define NONE(name) __declspec(dllexport) int name(void) { return 3; }
#else
#define NONE(name) __attribute__((visibility("default"))) int name(void) { return 3; }
#endif
#if FMI == 2
NONE(fmi2SerializedFMUstateSize) NONE(fmi2SerializeFMUstate) NONE(fmi2DeSerializeFMUstate) NONE(fmi2GetIntegerStatus)
NONE(fmi2GetStringStatus)
#else
NONE(fmi3InstantiateScheduledExecution) NONE(fmi3GetBinary) NONE(fmi3SetBinary) NONE(fmi3GetClock) NONE(fmi3SetClock)
NONE(fmi3GetNumberOfVariableDependencies) NONE(fmi3GetVariableDependencies) NONE(fmi3SerializedFMUStateSize)
NONE(fmi3SerializeFMUState) NONE(fmi3DeserializeFMUState) NONE(fmi3GetAdjointDerivative) NONE(fmi3GetIntervalDecimal)
NONE(fmi3GetIntervalFraction) NONE(fmi3GetShiftDecimal) NONE(fmi3GetShiftFraction) NONE(fmi3SetIntervalDecimal)
NONE(fmi3SetIntervalFraction) NONE(fmi3SetShiftDecimal) NONE(fmi3SetShiftFraction) NONE(fmi3EvaluateDiscreteStates)
NONE(fmi3ActivateModelPartition)
#endif
