#ifndef STUB_STABILIZER_TYPES_H
#define STUB_STABILIZER_TYPES_H
#include <stdint.h>

typedef uint32_t stabilizerStep_t;
typedef struct { float x, y, z; } Axis3f;
typedef struct { float roll, pitch, yaw; } attitude_t; /* [deg], [deg/s] */
typedef struct { Axis3f acc, gyro; } sensorData_t;      /* [g], [deg/s] */
typedef struct { attitude_t attitude; } state_t;
typedef struct { attitude_t attitude, attitudeRate; float thrust; } setpoint_t;
typedef enum { controlModeLegacy, controlModeForceTorque, controlModeForce } control_mode_t;
typedef struct { float thrustSi, torqueX, torqueY, torqueZ; control_mode_t controlMode; } control_t; /* [N], [N m] */

#define RATE_MAIN_LOOP 1000
#define RATE_DO_EXECUTE(RATE_HZ, TICK) (((TICK) % (RATE_MAIN_LOOP / (RATE_HZ))) == 0)
#endif
