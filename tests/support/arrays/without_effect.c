/* Functions that FMPy asks for, beside those of faulty/without_effect.c, and that this model has no use for. */
#define NONE(name) __attribute__((visibility("default"))) int name(void) { return 3; }
NONE(fmi3FreeFMUState) NONE(fmi3GetFMUState) NONE(fmi3SetFMUState) NONE(fmi3GetDirectionalDerivative)
NONE(fmi3GetOutputDerivatives) NONE(fmi3GetBoolean) NONE(fmi3SetBoolean) NONE(fmi3GetString) NONE(fmi3SetString)
NONE(fmi3GetFloat32) NONE(fmi3SetFloat32) NONE(fmi3GetInt8) NONE(fmi3SetInt8) NONE(fmi3GetUInt8) NONE(fmi3SetUInt8)
NONE(fmi3GetInt16) NONE(fmi3SetInt16) NONE(fmi3GetUInt16) NONE(fmi3SetUInt16) NONE(fmi3GetInt32) NONE(fmi3SetInt32)
NONE(fmi3GetUInt32) NONE(fmi3SetUInt32) NONE(fmi3GetInt64) NONE(fmi3SetInt64)
