/* Reads samples, runs the exported network, writes its whole state and its outputs after each sample. A sample is
 * body rate and specific force, of a controller the set-point before them. */
#include <stdio.h>
#ifdef CONTROLLER
#include "snn_control.h"
typedef snn_control_state network;
enum { COLUMNS = 10, OUTPUTS = 4 };
#else
#include "att_snn.h"
typedef att_snn_state network;
enum { COLUMNS = 6, OUTPUTS = ATT_SNN_OUTPUTS };
#endif

int main(void)
{
    static network state;
    double sample[COLUMNS], output[OUTPUTS];
#ifdef CONTROLLER
    snn_control_reset(&state);
#else
    att_snn_reset(&state);
#endif
    while (fread(sample, sizeof sample, 1, stdin) == 1) {
#ifdef CONTROLLER
        snn_control_set_point(&state, sample);
        snn_control_encode(&state, sample + 4, sample + 7);
        snn_control_step(&state);
        snn_control_action(&state, output);
#else
        att_snn_encode(&state, sample, sample + 3);
        att_snn_step(&state);
        att_snn_attitude(&state, output);
#endif
        fwrite(&state, sizeof state, 1, stdout);
        fwrite(output, sizeof output, 1, stdout);
    }
    return 0;
}
