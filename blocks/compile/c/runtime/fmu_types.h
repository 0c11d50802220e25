/* The types of FMUs' variables whose values are numbers: in the order of `types.NUMBERS` of blocks.fmi, and the Boolean of
   FMI 2 behind them. */
#ifndef BLOCKS_FMU_TYPES_H
#define BLOCKS_FMU_TYPES_H

#include <stdint.h>

/* All but Float64, which needs no conversion. */
#define BLOCKS_CONVERTED(T)                                                                                           \
    T(FLOAT32, float) T(INT8, int8_t) T(UINT8, uint8_t) T(INT16, int16_t) T(UINT16, uint16_t) T(INT32, int32_t)       \
    T(UINT32, uint32_t) T(INT64, int64_t) T(UINT64, uint64_t) T(BOOLEAN, _Bool) T(INT_BOOLEAN, int)

#define BLOCKS_TYPE(name, type) BLOCKS_##name,
enum { BLOCKS_FLOAT64 = 0, BLOCKS_CONVERTED(BLOCKS_TYPE) BLOCKS_TYPES };
#undef BLOCKS_TYPE

#endif
