#ifndef STUB_FREERTOS_H
#define STUB_FREERTOS_H
#include <stdint.h>
#define M2T(milliseconds) ((uint32_t)(milliseconds)) /* ticks */
#endif
