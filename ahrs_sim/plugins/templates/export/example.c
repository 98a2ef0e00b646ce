/* A minute of standing on an apron, level and heading north: prints the attitude that @METHOD@ finds. */
#include <math.h>
#include <stdio.h>

#include "ahrs_estimator.h"

int main(void)
{
    static const ahrs_site site = {{0.84, 0.15, 400.0}, 9.81, {2.15e-5, 1.1e-6, 4.3e-5}};
    ahrs_estimator *estimator = ahrs_create(&site, NULL, "");
    ahrs_estimate estimate;
    const double *q = estimate.q_nb;
    size_t i;
    int k;
    if (!estimator) {
        puts(ahrs_error(NULL));
        return 1;
    }
    for (k = 0; k < 6000; k++) {
        ahrs_sample sample = {0};
        double *number = (double *)&sample;
        for (i = 0; i < offsetof(ahrs_sample, mag_new) / sizeof(double); i++)
            number[i] = NAN; /* what is not fitted is missing */
        for (i = 0; i < offsetof(ahrs_estimate, status) / sizeof(double); i++)
            ((double *)&estimate)[i] = NAN;
        estimate.status = AHRS_ALIGNING;
        estimate.t = sample.t = 0.01 * k;
        for (i = 0; i < 3; i++) {
            sample.gyro_b[i] = 0.001 * sin(1.7 * k + (double)i);
            sample.accel_b[i] = 0.01 * sin(2.3 * k + (double)i) - (i == 2 ? site.gravity : 0.0);
            sample.mag_b[i] = site.mag_n[i];
        }
        sample.mag_new = k % 2 == 0;
        if (ahrs_process(estimator, &sample, 1, &estimate)) {
            puts(ahrs_error(estimator));
            return 1;
        }
    }
    printf("status %d, q_nb %.6f %.6f %.6f %.6f\n", estimate.status, q[0], q[1], q[2], q[3]);
    ahrs_destroy(estimator);
    return estimate.status == AHRS_RUNNING || estimate.status == AHRS_COASTING ? 0 : 1;
}
