/* A number of the kernels: a float in the first half of a double's place. Their times count from the first sample. */
typedef union {
    float number;
    uint32_t bits;
} single;
static double first_t;
static int begun;

static void put(uint64_t *to, double x)
{
    single u;
    u.number = (float)x;
    *to = u.bits;
}

static double get(uint64_t from)
{
    single u;
    u.bits = (uint32_t)from;
    return u.number;
}

static void forget(void)
{
    begun = 0;
    ahrs_kernel_forget(memory_instance);
}

static int64_t estimate(const ahrs_sample *sample, ahrs_estimate *answer)
{
    enum { IN = offsetof(ahrs_sample, mag_new) / sizeof(double), OUT = offsetof(ahrs_estimate, status) / sizeof(double) };
    static uint64_t row[IN + 1], found[OUT + 1];
    const double *given = (const double *)sample;
    double *numbers = (double *)answer;
    int64_t bad;
    size_t k;
    if (!begun)
        first_t = sample->t;
    begun = 1;
    for (k = 0; k < IN; k++)
        put(&row[k], given[k]);
    put(&row[offsetof(ahrs_sample, t) / sizeof(double)], sample->t - first_t);
    put(&row[offsetof(ahrs_sample, gnss_t) / sizeof(double)], sample->gnss_t - first_t);
    put(&row[offsetof(ahrs_sample, heading_t) / sizeof(double)], sample->heading_t - first_t);
    for (k = 0; k < sizeof(uint64_t); k++)
        ((uint8_t *)&row[IN])[k] = (&sample->mag_new)[k];
    for (k = 0; k < OUT; k++)
        found[k] = 0x7fc00000u; /* NaN */
    found[OUT] = AHRS_ALIGNING;
    bad = ahrs_kernel_process(memory_instance, row, 1, found);
    for (k = 1; k < OUT && bad < 0; k++)
        numbers[k] = get(found[k]);
    answer->t = sample->t;
    answer->status = *(const uint8_t *)&found[OUT];
    return bad;
}

