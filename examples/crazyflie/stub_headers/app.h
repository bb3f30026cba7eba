/* What the example uses of the Crazyflie's firmware, declared anew: for a test without a checkout. */
#ifndef STUB_APP_H
#define STUB_APP_H
void appMain(void);
#endif
