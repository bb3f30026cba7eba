/* Reads samples of six doubles, runs the exported network, writes its whole state and the attitude after each sample. */
#include <stdio.h>
#include "att_snn.h"

int main(void)
{
    static att_snn_state state;
    double sample[6], attitude[ATT_SNN_OUTPUTS];
    att_snn_reset(&state);
    while (fread(sample, sizeof sample, 1, stdin) == 1) {
        att_snn_encode(&state, sample, sample + 3);
        att_snn_step(&state);
        att_snn_attitude(&state, attitude);
        fwrite(&state, sizeof state, 1, stdout);
        fwrite(attitude, sizeof attitude, 1, stdout);
    }
    return 0;
}
