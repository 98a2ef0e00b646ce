/*
 * NAME: a complementary filter behind ahrs_estimator.h, to be replaced by your own.
 *
 * The gyro carries the attitude; the accelerometer pulls the tilt and the magnetometer the heading back with the rates
 * `tilt_gain` and `heading_gain` (1/s). The first second of samples is averaged for the first attitude.
 *
 * Firmware in single precision: keep your own structures in float and convert here, where samples come in and estimates
 * go out; see `narrow` and `widen` below.
 */
#include "ahrs_estimator.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct ahrs_estimator {
    ahrs_site site;
    double tilt_gain, heading_gain; /* 1/s */
    double q[4];                    /* q_nb */
    double t;                       /* s, of the last sample; NaN before the first */
    double accel[3], mag[3];        /* sums for the first attitude */
    double begun;                   /* s */
    int samples, fields, running;
    char error[160];
};

static const double PI = 3.14159265358979323846;
static char create_error[160];

/* An adaptor for float firmware: vectors on the way in and out. */
static inline void narrow(const double from[3], float to[3]) { for (int i = 0; i < 3; i++) to[i] = (float)from[i]; }
static inline void widen(const float from[3], double to[3]) { for (int i = 0; i < 3; i++) to[i] = from[i]; }

static void to_nav(const double q[4], const double v[3], double out[3]) {
    const double a = q[0], b = q[1], c = q[2], d = q[3];
    out[0] = (a*a + b*b - c*c - d*d) * v[0] + 2.0 * (b*c - a*d) * v[1] + 2.0 * (b*d + a*c) * v[2];
    out[1] = 2.0 * (b*c + a*d) * v[0] + (a*a - b*b + c*c - d*d) * v[1] + 2.0 * (c*d - a*b) * v[2];
    out[2] = 2.0 * (b*d - a*c) * v[0] + 2.0 * (c*d + a*b) * v[1] + (a*a - b*b - c*c + d*d) * v[2];
}

static void to_body(const double q[4], const double v[3], double out[3]) {
    const double conjugate[4] = {q[0], -q[1], -q[2], -q[3]};
    to_nav(conjugate, v, out);
}

/* Turn q by the small rotation r (rad), given in body axes. */
static void turn(double q[4], const double r[3]) {
    const double a = q[0], b = q[1], c = q[2], d = q[3], x = 0.5 * r[0], y = 0.5 * r[1], z = 0.5 * r[2];
    q[0] = a - b*x - c*y - d*z;
    q[1] = b + a*x + c*z - d*y;
    q[2] = c + a*y + d*x - b*z;
    q[3] = d + a*z + b*y - c*x;
    const double norm = sqrt(q[0]*q[0] + q[1]*q[1] + q[2]*q[2] + q[3]*q[3]);
    for (int i = 0; i < 4; i++) q[i] /= norm;
}

/* First attitude from the averaged accelerometer and magnetometer. */
static void level(ahrs_estimator *self) {
    const double *f = self->accel, *m = self->mag;
    const double roll = atan2(-f[1], -f[2]), pitch = atan2(f[0], hypot(f[1], f[2]));
    const double my = m[1] * cos(roll) - m[2] * sin(roll);
    const double mx = m[0] * cos(pitch) + (m[1] * sin(roll) + m[2] * cos(roll)) * sin(pitch);
    const double declination = atan2(self->site.mag_n[1], self->site.mag_n[0]);
    const double yaw = self->fields ? atan2(-my, mx) + declination : 0.0;
    const double cr = cos(0.5 * roll), sr = sin(0.5 * roll), cp = cos(0.5 * pitch), sp = sin(0.5 * pitch);
    const double cy = cos(0.5 * yaw), sy = sin(0.5 * yaw);
    self->q[0] = cr*cp*cy + sr*sp*sy;
    self->q[1] = sr*cp*cy - cr*sp*sy;
    self->q[2] = cr*sp*cy + sr*cp*sy;
    self->q[3] = cr*cp*sy - sr*sp*cy;
}

/* The correction (rad/s, body axes) by gravity and field. */
static void correction(const ahrs_estimator *self, const ahrs_sample *s, double out[3]) {
    const double *f = s->accel_b;
    const double norm = sqrt(f[0]*f[0] + f[1]*f[1] + f[2]*f[2]), up_n[3] = {0.0, 0.0, -1.0};
    double up[3];
    out[0] = out[1] = out[2] = 0.0;
    if (norm > 1.0) {
        to_body(self->q, up_n, up);
        out[0] = self->tilt_gain * (f[1] * up[2] - f[2] * up[1]) / norm;
        out[1] = self->tilt_gain * (f[2] * up[0] - f[0] * up[2]) / norm;
        out[2] = self->tilt_gain * (f[0] * up[1] - f[1] * up[0]) / norm;
    }
    if (isfinite(s->mag_b[0])) {
        double m_n[3], axis[3];
        to_nav(self->q, s->mag_b, m_n);
        const double wanted = atan2(self->site.mag_n[1], self->site.mag_n[0]);
        const double rate_n[3] = {0.0, 0.0, self->heading_gain * remainder(wanted - atan2(m_n[1], m_n[0]), 2.0 * PI)};
        to_body(self->q, rate_n, axis);
        for (int i = 0; i < 3; i++) out[i] += axis[i];
    }
}

static int read_settings(ahrs_estimator *self, const char *text) {
    while (*text) {
        char name[40];
        double value;
        int length = 0;
        if (sscanf(text, " %39[^=\n]=%lf%n", name, &value, &length) != 2 || length == 0) {
            snprintf(create_error, sizeof create_error, "settings: not `name=number`: %.60s", text);
            return 0;
        }
        if (!strcmp(name, "tilt_gain")) self->tilt_gain = value;
        else if (!strcmp(name, "heading_gain")) self->heading_gain = value;
        else {
            snprintf(create_error, sizeof create_error, "no setting '%s'; known: tilt_gain, heading_gain", name);
            return 0;
        }
        text += length;
        while (*text == '\n') text++;
    }
    return 1;
}

int32_t ahrs_version(void) { return AHRS_INTERFACE_VERSION; }

void ahrs_reset(ahrs_estimator *self) {
    self->t = NAN;
    self->samples = self->fields = self->running = 0;
    memset(self->accel, 0, sizeof self->accel);
    memset(self->mag, 0, sizeof self->mag);
}

ahrs_estimator *ahrs_create(const ahrs_site *site, const ahrs_sensors *sensors, const char *settings) {
    (void)sensors;
    ahrs_estimator *self = calloc(1, sizeof *self);
    if (!self) return NULL;
    self->site = *site;
    self->tilt_gain = 0.1;
    self->heading_gain = 0.1;
    ahrs_reset(self);
    if (read_settings(self, settings)) return self;
    free(self);
    return NULL;
}

int32_t ahrs_process(ahrs_estimator *self, const ahrs_sample *samples, uint32_t n, ahrs_estimate *estimates) {
    for (uint32_t k = 0; k < n; k++) {
        const ahrs_sample *s = &samples[k];
        ahrs_estimate *e = &estimates[k];
        const double dt = isnan(self->t) ? 0.0 : s->t - self->t;
        if (!isfinite(s->gyro_b[0]) || !isfinite(s->accel_b[0])) continue; /* e stays NaN and ALIGNING */
        if (isnan(self->t)) self->begun = s->t;
        self->t = s->t;
        if (!self->running) {
            for (int i = 0; i < 3; i++) self->accel[i] += s->accel_b[i];
            if (s->mag_new && ++self->fields)
                for (int i = 0; i < 3; i++) self->mag[i] += s->mag_b[i];
            self->samples++;
            if (s->t - self->begun < 1.0) continue;
            level(self);
            self->running = 1;
        } else {
            double w[3];
            correction(self, s, w);
            for (int i = 0; i < 3; i++) w[i] = (w[i] + s->gyro_b[i]) * dt;
            turn(self->q, w);
        }
        e->status = AHRS_RUNNING;
        memcpy(e->q_nb, self->q, sizeof e->q_nb);
    }
    return 0;
}

void ahrs_destroy(ahrs_estimator *self) { free(self); }

const char *ahrs_error(const ahrs_estimator *self) { return self ? self->error : create_error; }
