/* A test of its own, without ahrs_sim: at rest, banked by 20 degrees, heading east; then a slow turn of the gyro. */
#include "ahrs_estimator.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>

int main(void) {
    const double g = 9.80665, bank = 20.0 / 57.29577951308232;
    const ahrs_site site = {{0.75, 0.02, 150.0}, g, {2.2e-5, 0.0, 4.2e-5}};
    const ahrs_sensors sensors = {.rate = 100.0};
    assert(ahrs_version() == AHRS_INTERFACE_VERSION);
    assert(ahrs_create(&site, &sensors, "no_such=1\n") == NULL && ahrs_error(NULL)[0]);
    ahrs_estimator *estimator = ahrs_create(&site, &sensors, "tilt_gain=0.5\n");
    assert(estimator);

    ahrs_estimate e = {0};
    for (int k = 0; k < 3000; k++) {
        /* down is (0, sin, cos) in body axes; north is to the left of an aircraft that heads east */
        const double down[3] = {0.0, sin(bank), cos(bank)}, north[3] = {0.0, -cos(bank), sin(bank)};
        ahrs_sample s = {.t = 0.01 * k, .mag_new = 1};
        for (int i = 0; i < 3; i++) {
            s.accel_b[i] = -g * down[i];
            s.mag_b[i] = site.mag_n[0] * north[i] + site.mag_n[2] * down[i];
        }
        assert(ahrs_process(estimator, &s, 1, &e) == 0);
    }
    assert(e.status == AHRS_RUNNING);
    const double *q = e.q_nb;
    const double roll = atan2(2.0 * (q[0]*q[1] + q[2]*q[3]), 1.0 - 2.0 * (q[1]*q[1] + q[2]*q[2]));
    const double yaw = atan2(2.0 * (q[0]*q[3] + q[1]*q[2]), 1.0 - 2.0 * (q[2]*q[2] + q[3]*q[3]));
    printf("roll %.4f deg, heading %.4f deg\n", roll * 57.29577951308232, yaw * 57.29577951308232);
    assert(fabs(roll - bank) < 1e-3 && fabs(yaw - 90.0 / 57.29577951308232) < 1e-3);
    ahrs_destroy(estimator);
    return 0;
}
