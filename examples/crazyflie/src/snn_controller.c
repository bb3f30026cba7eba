/* An exported spiking network as the out-of-tree controller of a Crazyflie: see README.md. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "app.h"
#include "FreeRTOS.h"
#include "task.h"
#include "controller.h"
#include "stabilizer_types.h"

#include "network/snn_control.h"

#define NETWORK_HZ ((int)SNN_CONTROL_RATE_HZ)

static const float RADIANS = 0.01745329252f; /* of a degree */
static const float GRAVITY = 9.81f;          /* m/s^2 */

/* Of the vehicle. The network asks for angular accelerations, the firmware wants torques. */
static const float MASS = 0.029f;                                     /* kg */
static const float INERTIA[3] = {1.657e-5f, 1.666e-5f, 2.926e-5f};    /* kg m^2 */
static const float MOST_THRUST = 0.6f;                                /* of four rotors [N] */

static snn_control_state network;
static double action[4];

void appMain(void)
{
    while (1)
        vTaskDelay(M2T(2000));
}

void controllerOutOfTreeInit(void) { snn_control_reset(&network); }

bool controllerOutOfTreeTest(void) { return true; }

/* Specific force at rest at the attitude that is estimated, which the network reads. */
static void specific_force(const state_t *state, double accel[3])
{
    const float roll = state->attitude.roll * RADIANS;
    const float pitch = -state->attitude.pitch * RADIANS; /* the firmware's is positive nose up */
    accel[0] = -GRAVITY * sinf(pitch);
    accel[1] = GRAVITY * sinf(roll) * cosf(pitch);
    accel[2] = GRAVITY * cosf(roll) * cosf(pitch);
}

static void run_network(const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state)
{
    const double wanted[4] = {
        setpoint->attitude.roll * RADIANS,
        -setpoint->attitude.pitch * RADIANS, /* the firmware's pitch is positive nose up */
        setpoint->attitudeRate.yaw * RADIANS,
        setpoint->thrust / UINT16_MAX * MOST_THRUST / MASS,
    };
    const double gyro[3] = {sensors->gyro.x * RADIANS, sensors->gyro.y * RADIANS, sensors->gyro.z * RADIANS};
    double accel[3];
    specific_force(state, accel);
    snn_control_set_point(&network, wanted);
    snn_control_encode(&network, gyro, accel);
    snn_control_step(&network);
    snn_control_action(&network, action);
}

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const stabilizerStep_t step)
{
    if (RATE_DO_EXECUTE(NETWORK_HZ, step))
        run_network(setpoint, sensors, state);
    const bool off = setpoint->thrust < 1.0f;
    control->controlMode = controlModeForceTorque;
    control->thrustSi = off ? 0.0f : (float)action[3] * MASS;
    control->torqueX = off ? 0.0f : (float)action[0] * INERTIA[0];
    control->torqueY = off ? 0.0f : (float)action[1] * INERTIA[1];
    control->torqueZ = off ? 0.0f : (float)action[2] * INERTIA[2];
}
