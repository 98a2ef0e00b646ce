/*
 * @METHOD@ of ahrs_sim @VERSION@ behind ahrs_estimator.h, for @TARGET@. Generated; kernels in @NAME@_kernels.o.
 *
 * One estimator, in static memory: no heap, and of the C library memset, memcpy and sqrt alone. Settings are fixed:
@SETTINGS@
 */
#include "ahrs_estimator.h"

typedef void (*ahrs_kernel)(void);
@KERNELS@
extern int64_t ahrs_kernel_process(void *instance, void *samples, int64_t n, void *estimates);
extern void *ahrs_kernel_forget(void *instance);

@SQRT@/* The memory that the kernels work on: the records of ahrs_sim's estimators. Addresses in it have eight bytes on every machine. */
@BLOCKS@
/* What it holds at first. */
@IMAGES@
typedef struct {
    uint64_t *to;
    const uint64_t *from; /* NULL: zeros */
    uint32_t words;
} contents;
static const contents first[] = {
@CONTENTS@
};

typedef struct {
    uint64_t *at;
    const void *what;
} reference;
static const reference references[] = {
@REFERENCES@
};

typedef struct {
    uint64_t *at;
    ahrs_kernel what;
} call;
static const call calls[] = {
@CALLS@
};

/* The data sheet of the suite "@SUITE@", for ahrs_create(site, NULL, ""). */
static const ahrs_sensors suite = {
@SHEET@
};

struct ahrs_estimator {
    const char *error;
};
static ahrs_estimator the_estimator;
static const char *refused = "";
static int in_use = 0;

int32_t ahrs_version(void) { return AHRS_INTERFACE_VERSION; }

@NUMBERS@static void place(const ahrs_site *site)
{
    uint64_t *to = memory_site;
    put(&to[0], site->lla[0]), put(&to[1], site->lla[1]), put(&to[2], site->lla[2]);
    put(&to[3], site->gravity);
    put(&to[4], site->mag_n[0]), put(&to[5], site->mag_n[1]), put(&to[6], site->mag_n[2]);
}

static void fit(const ahrs_sensors *sensors)
{
    uint64_t *to = memory_sensors;
@FIT@
}

ahrs_estimator *ahrs_create(const ahrs_site *site, const ahrs_sensors *sensors, const char *settings)
{
    size_t k;
    uint32_t w;
    refused = "";
    if (in_use) {
        refused = "@METHOD@ as exported code is one estimator at a time";
        return NULL;
    }
    if (!site) {
        refused = "no site";
        return NULL;
    }
    if (settings && *settings) {
        refused = "settings are fixed when code is exported: ahrs-sim export-code @METHOD@ --setting NAME=VALUE";
        return NULL;
    }
    for (k = 0; k < sizeof first / sizeof *first; k++)
        for (w = 0; w < first[k].words; w++)
            first[k].to[w] = first[k].from ? first[k].from[w] : 0;
    for (k = 0; k < sizeof references / sizeof *references; k++)
        *references[k].at = (uint64_t)(uintptr_t)references[k].what;
    for (k = 0; k < sizeof calls / sizeof *calls; k++)
        *calls[k].at = (uint64_t)(uintptr_t)calls[k].what;
    place(site);
    fit(sensors ? sensors : &suite);
    forget();
    the_estimator.error = "";
    in_use = 1;
    return &the_estimator;
}

int32_t ahrs_process(ahrs_estimator *self, const ahrs_sample *samples, uint32_t n, ahrs_estimate *estimates)
{
    uint32_t k;
    for (k = 0; k < n; k++) {
        if (estimate(&samples[k], &estimates[k]) >= 0) {
            self->error = "a time stamp is not finite or more than a second back";
            return 1;
        }
    }
    return 0;
}

void ahrs_reset(ahrs_estimator *self)
{
    self->error = "";
    forget();
}

void ahrs_destroy(ahrs_estimator *self)
{
    (void)self;
    in_use = 0;
}

const char *ahrs_error(const ahrs_estimator *self) { return self ? self->error : refused; }
