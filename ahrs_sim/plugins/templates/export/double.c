/* A number of the kernels: a double. */
static void put(uint64_t *to, double x)
{
    union {
        double number;
        uint64_t bits;
    } u;
    u.number = x;
    *to = u.bits;
}

static void forget(void) { ahrs_kernel_forget(memory_instance); }

static int64_t estimate(const ahrs_sample *sample, ahrs_estimate *answer)
{
    static ahrs_sample row; /* kernels write to it */
    row = *sample;
    return ahrs_kernel_process(memory_instance, &row, 1, answer);
}

