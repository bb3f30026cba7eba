/* Reads the inputs of a step in each line, whole numbers, and writes the outputs. */
#include "network.h"
#include <stdio.h>

int main(void)
{
    static network_state state;
    static int32_t input[NETWORK_INPUTS], output[NETWORK_OUTPUTS];
    network_reset(&state);
    for (;;) {
        for (int k = 0; k < NETWORK_INPUTS; ++k) {
            long number;
            if (scanf("%ld", &number) != 1)
                return 0;
            input[k] = (int32_t)number;
        }
        network_step(&state, input);
        network_outputs(&state, output);
        for (int k = 0; k < NETWORK_OUTPUTS; ++k)
            printf("%ld%c", (long)output[k], k + 1 < NETWORK_OUTPUTS ? ' ' : '\n');
    }
}
