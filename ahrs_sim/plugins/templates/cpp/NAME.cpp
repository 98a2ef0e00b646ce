// NAME: a complementary filter behind ahrs_estimator.h, to be replaced by your own.
//
// The gyro carries the attitude; the accelerometer pulls the tilt and the magnetometer the heading back with the rates
// `tilt_gain` and `heading_gain` (1/s). Exceptions must not leave the functions at the end: they answer in C.
#include "ahrs_estimator.h"

#include <array>
#include <cmath>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>

using Vector = std::array<double, 3>;

static Vector cross(const Vector &a, const Vector &b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
static Vector scaled(const Vector &a, double k) { return {a[0] * k, a[1] * k, a[2] * k}; }
static Vector sum(const Vector &a, const Vector &b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
static Vector vector(const double *v) { return {v[0], v[1], v[2]}; }

// A rotation from body to navigation axes.
struct Quaternion {
    double w = 1.0;
    Vector v = {0.0, 0.0, 0.0};

    Vector to_nav(const Vector &x) const {
        const Vector t = scaled(cross(v, x), 2.0);
        return sum(x, sum(scaled(t, w), cross(v, t)));
    }
    Vector to_body(const Vector &x) const { return Quaternion{w, scaled(v, -1.0)}.to_nav(x); }
    Quaternion times(const Quaternion &o) const {
        const double dot = v[0] * o.v[0] + v[1] * o.v[1] + v[2] * o.v[2];
        return {w * o.w - dot, sum(sum(scaled(o.v, w), scaled(v, o.w)), cross(v, o.v))};
    }
    Quaternion turned(const Vector &r) const { // by a small rotation in body axes, rad
        Quaternion q = times({1.0, scaled(r, 0.5)});
        const double norm = std::sqrt(q.w * q.w + q.v[0] * q.v[0] + q.v[1] * q.v[1] + q.v[2] * q.v[2]);
        return {q.w / norm, scaled(q.v, 1.0 / norm)};
    }
    static Quaternion about(int axis, double angle) {
        Quaternion q{std::cos(0.5 * angle), {}};
        q.v[axis] = std::sin(0.5 * angle);
        return q;
    }
};

struct ahrs_estimator {
    ahrs_estimator(const ahrs_site &where, const std::string &settings) : declination(std::atan2(where.mag_n[1], where.mag_n[0])) {
        std::map<std::string, double *> known = {{"tilt_gain", &tilt_gain}, {"heading_gain", &heading_gain}};
        std::istringstream lines(settings);
        for (std::string line; std::getline(lines, line);) {
            const auto at = line.find('=');
            const auto found = known.find(line.substr(0, at));
            if (found == known.end()) throw std::invalid_argument("no setting '" + line.substr(0, at) + "'; known: heading_gain, tilt_gain");
            *found->second = std::stod(line.substr(at + 1));
        }
    }

    void reset() { t = NAN; running = false; accel = field = {}; }

    void step(const ahrs_sample &s, ahrs_estimate &e) {
        if (!std::isfinite(s.gyro_b[0]) || !std::isfinite(s.accel_b[0])) return; // e stays NaN and ALIGNING
        const double dt = std::isnan(t) ? 0.0 : s.t - t;
        if (std::isnan(t)) begun = s.t;
        t = s.t;
        if (running) {
            q = q.turned(scaled(sum(vector(s.gyro_b), correction(s)), dt));
        } else {
            accel = sum(accel, vector(s.accel_b));
            if (s.mag_new) field = sum(field, vector(s.mag_b));
            if (t - begun < 1.0) return;
            level();
            running = true;
        }
        e.status = AHRS_RUNNING;
        e.q_nb[0] = q.w;
        for (int i = 0; i < 3; i++) e.q_nb[i + 1] = q.v[i];
    }

    std::string error;

  private:
    void level() { // the first attitude from the averaged accelerometer and magnetometer
        const double roll = std::atan2(-accel[1], -accel[2]), pitch = std::atan2(accel[0], std::hypot(accel[1], accel[2]));
        const Quaternion tilt = Quaternion::about(1, pitch).times(Quaternion::about(0, roll));
        const Vector horizontal = tilt.to_nav(field);
        q = Quaternion::about(2, declination - std::atan2(horizontal[1], horizontal[0])).times(tilt);
    }

    Vector correction(const ahrs_sample &s) const { // rad/s, body axes
        Vector out{}, f = vector(s.accel_b);
        const double norm = std::sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
        if (norm > 1.0) out = scaled(cross(f, q.to_body({0.0, 0.0, -1.0})), tilt_gain / norm);
        if (std::isfinite(s.mag_b[0])) {
            const Vector m = q.to_nav(vector(s.mag_b));
            const double miss = std::remainder(declination - std::atan2(m[1], m[0]), 2.0 * std::acos(-1.0));
            out = sum(out, q.to_body({0.0, 0.0, heading_gain * miss}));
        }
        return out;
    }

    double declination, tilt_gain = 0.1, heading_gain = 0.1, t = NAN, begun = 0.0;
    bool running = false;
    Quaternion q;
    Vector accel{}, field{};
};

static std::string create_error;

int32_t ahrs_version(void) { return AHRS_INTERFACE_VERSION; }

ahrs_estimator *ahrs_create(const ahrs_site *site, const ahrs_sensors *, const char *settings) {
    try {
        return new ahrs_estimator(*site, settings);
    } catch (const std::exception &error) {
        create_error = error.what();
        return nullptr;
    }
}

int32_t ahrs_process(ahrs_estimator *self, const ahrs_sample *samples, uint32_t n, ahrs_estimate *estimates) {
    try {
        for (uint32_t k = 0; k < n; k++) self->step(samples[k], estimates[k]);
        return 0;
    } catch (const std::exception &error) {
        self->error = error.what();
        return 1;
    }
}

void ahrs_reset(ahrs_estimator *self) { self->reset(); }
void ahrs_destroy(ahrs_estimator *self) { delete self; }
const char *ahrs_error(const ahrs_estimator *self) { return self ? self->error.c_str() : create_error.c_str(); }
