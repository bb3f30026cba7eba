#ifndef STUB_TASK_H
#define STUB_TASK_H
#include <stdint.h>
void vTaskDelay(const uint32_t ticks);
#endif
