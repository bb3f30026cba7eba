/* Runs an exported network on an emulated Cortex-M: samples.bin to outputs.bin and counts.bin, by semihosting.
 *
 * samples.bin: how many of the samples to run, then the samples, all doubles: set-point (of a controller), body rate,
 * specific force. outputs.bin: doubles. counts.bin: cycles of the system timer for scaling, network and output of each
 * sample, less those of an empty interval; the emulator runs an instruction in a fixed time. */
#include <stdint.h>
#ifdef CONTROLLER
#include "snn_control.h"
typedef snn_control_state network;
enum { COLUMNS = 10, OUTPUTS = 4 };
#else
#include "att_snn.h"
typedef att_snn_state network;
enum { COLUMNS = 6, OUTPUTS = ATT_SNN_OUTPUTS };
#endif

enum { MOST = 4096, OPEN = 1, CLOSE = 2, WRITE = 5, READ = 6, EXIT = 0x18, READ_BINARY = 1, WRITE_BINARY = 5, FINE = 0x20026 };
#define SYSTICK ((volatile uint32_t *)0xe000e010) /* control, reload, current */
#define CPACR (*(volatile uint32_t *)0xe000ed88)

static struct {
    double count, rows[MOST][COLUMNS];
} samples;
static double outputs[MOST][OUTPUTS];
static uint32_t counts[MOST][3];
static network state;
extern uint32_t top_of_stack[];

static int host(int operation, const void *arguments)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = arguments;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static void file(int operation, const char *name, unsigned length, void *content, unsigned size)
{
    const uint32_t opening[3] = {(uint32_t)name, operation == READ ? READ_BINARY : WRITE_BINARY, length};
    const uint32_t moving[3] = {(uint32_t)host(OPEN, opening), (uint32_t)content, size};
    host(operation, moving);
    host(CLOSE, moving);
}

static uint32_t now(void) { return SYSTICK[2]; }

static uint32_t since(uint32_t then) { return (then - now()) & 0xffffff; }

static void run(void)
{
    const uint32_t then = now(), empty = since(then);
#ifdef CONTROLLER
    snn_control_reset(&state);
#else
    att_snn_reset(&state);
#endif
    for (int k = 0; k < (int)samples.count; ++k) {
        const double *row = samples.rows[k];
        uint32_t start = now();
#ifdef CONTROLLER
        snn_control_set_point(&state, row);
        snn_control_encode(&state, row + 4, row + 7);
        counts[k][0] = since(start) - empty;
        start = now();
        snn_control_step(&state);
        counts[k][1] = since(start) - empty;
        start = now();
        snn_control_action(&state, outputs[k]);
        counts[k][2] = since(start) - empty;
#else
        att_snn_encode(&state, row, row + 3);
        counts[k][0] = since(start) - empty;
        start = now();
        att_snn_step(&state);
        counts[k][1] = since(start) - empty;
        start = now();
        att_snn_attitude(&state, outputs[k]);
        counts[k][2] = since(start) - empty;
#endif
    }
}

void start(void);

void start(void)
{
    CPACR |= 0xf00000; /* the floating-point unit */
    __asm__ volatile("dsb\n\tisb");
    SYSTICK[1] = 0xffffff;
    SYSTICK[0] = 5; /* counts, without interrupts, at the speed of the core */
    file(READ, "samples.bin", 11, &samples, sizeof samples);
    run();
    file(WRITE, "outputs.bin", 11, outputs, sizeof outputs);
    file(WRITE, "counts.bin", 10, counts, sizeof counts);
    host(EXIT, (const void *)FINE);
    for (;;)
        ;
}

static void halt(void)
{
    host(EXIT, (const void *)0);
    for (;;)
        ;
}

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[15])(void);
} VECTORS = {top_of_stack, {start, halt, halt, halt, halt, halt}};
