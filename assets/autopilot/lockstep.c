/* Betaflight's SITL in lockstep with a simulator: this file includes the firmware's own sitl.c and stands in its place.
 *
 * Standard input is a socket that keeps messages whole. For each request the firmware runs until its clock is at the
 * packet's timestamp and replies; between requests its clock stands. The clock advances with the firmware's calls and
 * waits alone, so that a flight depends on nothing but its requests. The firmware gets the packets once in each period
 * of its gyroscope. It ends with the simulator. Its first serial port, with MSP and the command line, is a part of both
 * messages. No thread is started, and no network port is opened. */
#include <pthread.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>

#include "platform.h"

#include "dyad.h"
#include "udplink.h"

static int lockstep_clock(struct timespec *time);
static int lockstep_wait(const struct timespec *time);
static int lockstep_send(const udpLink_t *link);
#define clock_gettime(id, time) lockstep_clock(time)
#define nanosleep(time, rest) lockstep_wait(time)
#define pthread_create(thread, attributes, function, argument) ((void)(thread), (void)(function), 0)
#define pthread_join(thread, result) ((void)(thread))
#define udpInit(link, address, number, server) ((link)->port = (number), 0)
#define udpSend(link, data, size) lockstep_send(link)
#include "sitl_firmware.c"

#include "fc/runtime_config.h"

#define SERIAL_MAX 4096
#define CALL_NS 1000    /* that a look at the clock takes */
#define GYRO_NS 125000

static struct {
    fdm_packet state;
    rc_packet rc;
    char serial[SERIAL_MAX];
} request;
static struct {
    servo_packet motors;
    float quat[4]; /* attitude by the firmware's own estimator, body to world, w first */
    uint32_t armed;
    uint32_t arming_disabled;
    char serial[SERIAL_MAX];
} reply;
static size_t serial_size;
static uint64_t now_ns, next_ns, until_ns;
static bool busy;
static dyad_Callback accepted, received;
static void *port;

static uint8_t lockstep_frame(rxRuntimeState_t *state)
{
    UNUSED(state);
    const bool complete = rc_received;
    rc_received = false;
    return complete ? RX_FRAME_COMPLETE : RX_FRAME_PENDING;
}

static void exchange(void)
{
    const quaternion_t q = imuAttitudeQuaternion;
    const float quat[4] = { q.w, q.x, q.y, q.z };
    memcpy(reply.quat, quat, sizeof(quat));
    reply.armed = ARMING_FLAG(ARMED) != 0;
    reply.arming_disabled = getArmingDisableFlags();
    if (send(0, &reply, offsetof(__typeof__(reply), serial) + serial_size, 0) < 0) {
        exit(0);
    }
    serial_size = 0;
    const ssize_t size = recv(0, &request, sizeof(request), 0);
    const ssize_t serial = size - (ssize_t)offsetof(__typeof__(request), serial);
    if (serial < 0) {
        exit(0);
    }
    until_ns = (uint64_t)llrint(request.state.timestamp * 1e9);
    rcPkt = request.rc;
    rxRuntimeState.channelCount = SIMULATOR_MAX_RC_CHANNELS;
    rxRuntimeState.rcReadRawFn = readRCSITL;
    rxRuntimeState.rcFrameStatusFn = lockstep_frame;
    rc_received = true;
    rxRuntimeState.rxProvider = RX_PROVIDER_UDP;
    if (serial > 0 && received) {
        dyad_Event event = { .udata = port, .data = request.serial, .size = serial };
        received(&event);
    }
}

static void advance(uint64_t ns)
{
    if (busy) {
        return;
    }
    now_ns += ns;
    busy = true;
    while (now_ns >= until_ns) {
        exchange();
    }
    if (now_ns >= next_ns && virtualGyroDev && virtualAccDev) {
        fdm_packet state = request.state;
        state.timestamp = now_ns * 1e-9;
        updateState(&state);
        next_ns = now_ns - now_ns % GYRO_NS + GYRO_NS;
    }
    busy = false;
}

static int lockstep_clock(struct timespec *time)
{
    advance(CALL_NS);
    time->tv_sec = now_ns / 1000000000;
    time->tv_nsec = now_ns % 1000000000;
    return 0;
}

static int lockstep_wait(const struct timespec *time)
{
    advance(time->tv_sec * 1000000000ULL + time->tv_nsec);
    return 0;
}

static int lockstep_send(const udpLink_t *link)
{
    if (link->port == PORT_PWM) {
        reply.motors = pwmPkt;
    }
    return 0;
}

/* dyad carries the serial ports; this one carries the first, and takes no one for the others. */

dyad_Stream *dyad_newStream(void)
{
    return (dyad_Stream *)&port;
}

void dyad_addListener(dyad_Stream *stream, int event, dyad_Callback callback, void *udata)
{
    UNUSED(stream);
    if (event == DYAD_EVENT_ACCEPT) {
        accepted = callback;
        if (!port) {
            port = udata;
        }
    } else if (event == DYAD_EVENT_DATA) {
        received = callback;
    }
}

int dyad_listenEx(dyad_Stream *stream, const char *host, int number, int backlog)
{
    UNUSED(host);
    UNUSED(number);
    UNUSED(backlog);
    if (!received) {
        dyad_Event event = { .udata = port, .remote = stream };
        accepted(&event);
    }
    return 0;
}

void dyad_write(dyad_Stream *stream, const void *data, int size)
{
    UNUSED(stream);
    for (int i = 0; i < size && serial_size < SERIAL_MAX; i++) {
        reply.serial[serial_size++] = ((const char *)data)[i];
    }
}

void dyad_init(void) {}
void dyad_update(void) {}
void dyad_shutdown(void) {}
void dyad_close(dyad_Stream *stream) { UNUSED(stream); }
void dyad_setNoDelay(dyad_Stream *stream, int on) { UNUSED(stream); UNUSED(on); }
void dyad_setTimeout(dyad_Stream *stream, double seconds) { UNUSED(stream); UNUSED(seconds); }
void dyad_setTickInterval(double seconds) { UNUSED(seconds); }
void dyad_setUpdateTimeout(double seconds) { UNUSED(seconds); }
