/*
 * ahrs_estimator.h: one interface for attitude estimators in C, both ways.
 *
 * A shared library that exports the six functions below flies in ahrs_sim as `method = "lib:./libmine.so"`; estimators of
 * ahrs_sim that are exported as C code implement the same six functions.
 *
 * Conventions: SI units and radians. Navigation frame n: local north-east-down (NED). Body frame b: forward-right-down
 * (FRD). Quaternions are Hamilton, scalar first; q_nb takes body vectors to the navigation frame. Latitude, longitude and
 * height are geodetic on WGS84. Missing values are NaN, never zero. Every structure is made of doubles followed by bytes
 * with explicit padding, so that its layout is the same on every common ABI.
 */
#ifndef AHRS_ESTIMATOR_H
#define AHRS_ESTIMATOR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The version of this interface. It changes whenever a structure or a function changes. */
#define AHRS_INTERFACE_VERSION 1

#if defined(_WIN32)
#define AHRS_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define AHRS_EXPORT __attribute__((visibility("default")))
#else
#define AHRS_EXPORT
#endif

/*
 * One row per sample of the inertial sensors. Filled by the caller.
 *
 * Slower sensors are latched: a value is the last one received, NaN before the first, and its `*_new` is 1 on the one row
 * at which it arrived. `gnss_t` and `heading_t` are the times at which the values were true (latency).
 */
typedef struct ahrs_sample {
    double t;               /* s, time stamp; strictly increasing, dt comes from it and never from a nominal rate */
    double gyro_b[3];       /* rad/s, NaN when missing */
    double accel_b[3];      /* m/s2, specific force: (0, 0, -g) at rest and level; NaN when missing */
    double mag_b[3];        /* T */
    double lla[3];          /* rad, rad, m: GNSS latitude, longitude, ellipsoidal height */
    double vel_n[3];        /* m/s, GNSS velocity, NED */
    double gnss_t;          /* s, when position and velocity were true */
    double gnss_satellites; /* satellites in use */
    double heading;         /* rad, true heading of a dual-antenna baseline */
    double heading_sigma;   /* rad, as its receiver reports it */
    double heading_t;       /* s, when it was true */
    double airspeed;        /* m/s, true airspeed */
    double alpha;           /* rad, angle of attack by a vane */
    double beta;            /* rad, sideslip by a vane */
    uint8_t mag_new;        /* 1: mag_b arrived with this row */
    uint8_t gnss_new;       /* 1: lla, vel_n, gnss_t, gnss_satellites arrived with this row */
    uint8_t heading_new;    /* 1: heading, heading_sigma, heading_t arrived with this row */
    uint8_t air_new;        /* 1: airspeed, alpha, beta arrived with this row */
    uint8_t reserved[4];    /* 0 */
} ahrs_sample;

/* ahrs_estimate.status */
enum {
    AHRS_ALIGNING = 0, /* no attitude yet: q_nb and down_b are NaN */
    AHRS_RUNNING = 1,
    AHRS_COASTING = 2, /* a needed measurement is missing or refused: carried by the gyro */
    AHRS_DIVERGED = 3  /* numerically lost */
};

/*
 * One row per row of samples. The caller fills `t`, sets every other number to NaN and `status` to AHRS_ALIGNING before the
 * call; the estimator overwrites what it estimates and leaves the rest NaN.
 */
typedef struct ahrs_estimate {
    double t;                   /* s, the sample's */
    double q_nb[4];             /* unit quaternion; NaN when the method has no heading */
    double down_b[3];           /* unit vector towards down in body axes (tilt); taken from q_nb when left NaN */
    double att_cov[9];          /* rad2, 3x3 row-major covariance of the small attitude error rotation in body axes */
    double gyro_bias[3];        /* rad/s */
    double gyro_bias_sigma[3];  /* rad/s, 1 sigma */
    double accel_bias[3];       /* m/s2 */
    double accel_bias_sigma[3]; /* m/s2, 1 sigma */
    double lla[3];              /* rad, rad, m */
    double vel_n[3];            /* m/s, NED */
    double pos_cov[9];          /* m2, 3x3 row-major covariance of the place, NED */
    double vel_cov[9];          /* m2/s2, 3x3 row-major covariance of vel_n, NED */
    double innovation[12];      /* independent innovations of this row's measurements */
    double innovation_var[12];  /* their variances; NIS is the sum of innovation^2 / innovation_var */
    double adaptation[4];       /* meaning by method */
    uint8_t status;             /* AHRS_ALIGNING ... AHRS_DIVERGED */
    uint8_t reserved[7];        /* leave */
} ahrs_estimate;

/* The place where the recording begins. Filled by the caller; no NaN. */
typedef struct ahrs_site {
    double lla[3];   /* rad, rad, m */
    double gravity;  /* m/s2 */
    double mag_n[3]; /* T, field of the World Magnetic Model, NED */
} ahrs_site;

/* What the data sheets say of the sensors, one sigma. Filled by the caller; no NaN. */
typedef struct ahrs_sensors {
    double rate;             /* Hz, nominal */
    double gyro_noise;       /* rad/s/sqrt(Hz), single-sided density */
    double gyro_bias;        /* rad/s, turn-on */
    double gyro_instability; /* rad/s, in run */
    double gyro_scale;       /* scale factor and misalignment, relative */
    double accel_noise;      /* m/s2/sqrt(Hz), single-sided density */
    double accel_bias;       /* m/s2, turn-on */
    double accel_scale;      /* relative */
    double mag_noise;        /* T, one sample */
    double mag_bias;         /* T, hard iron that is left */
    double gyro_delay;       /* s: the value stamped t was true at t - delay */
    double accel_delay;      /* s */
    double mag_delay;        /* s */
    double gnss_pos;         /* m */
    double gnss_vel;         /* m/s */
    double heading;          /* rad, dual antenna */
    double airspeed;         /* m/s */
    double airspeed_scale;   /* relative */
    double antenna_b[3];     /* m, GNSS antenna from the IMU, body axes */
} ahrs_sensors;

typedef struct ahrs_estimator ahrs_estimator;

/* Returns AHRS_INTERFACE_VERSION of the header that the library was compiled with. */
AHRS_EXPORT int32_t ahrs_version(void);

/*
 * Makes an estimator, or returns NULL and explains in ahrs_error(NULL). `settings` is text, one `name=value` a line, of the
 * scenario's settings; an estimator refuses names that it does not know. A library may support one estimator at a time.
 */
AHRS_EXPORT ahrs_estimator *ahrs_create(const ahrs_site *site, const ahrs_sensors *sensors, const char *settings);

/*
 * Takes n rows of samples in order of time and writes n rows of estimates; blocks of any length give the same numbers.
 * Returns 0, or another number after an error that ahrs_error explains.
 */
AHRS_EXPORT int32_t ahrs_process(ahrs_estimator *self, const ahrs_sample *samples, uint32_t n, ahrs_estimate *estimates);

/* Forgets everything seen: as after ahrs_create. */
AHRS_EXPORT void ahrs_reset(ahrs_estimator *self);

/* Ends an estimator. */
AHRS_EXPORT void ahrs_destroy(ahrs_estimator *self);

/* Explains the last error in one line, "" when there was none; valid until the next call. */
AHRS_EXPORT const char *ahrs_error(const ahrs_estimator *self);

#ifdef __cplusplus
}
#endif

#endif
