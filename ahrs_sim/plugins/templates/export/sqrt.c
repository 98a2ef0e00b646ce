/* Square root of a double, correctly rounded, bit by bit: for processors that have no instruction for it. */
extern void ahrs_kernel_sqrt(double *x);
void ahrs_kernel_sqrt(double *x)
{
    union {
        double number;
        uint64_t bits;
    } u;
    uint64_t mantissa, root = 0, rest = 0;
    int exponent, k;
    u.number = *x;
    if (!(u.number > 0.0) || u.bits >> 52 == 0x7ff) { /* zero, negative, infinite, NaN */
        *x = u.number < 0.0 ? (u.number - u.number) / 0.0 : u.number;
        return;
    }
    exponent = (int)(u.bits >> 52) - 1023;
    mantissa = u.bits & 0xfffffffffffffu;
    if (exponent == -1023) {
        for (exponent = -1022; !(mantissa >> 52); exponent--)
            mantissa <<= 1;
    }
    mantissa |= 0x10000000000000u;
    if (exponent & 1) {
        mantissa <<= 1;
        exponent--;
    }
    for (k = 0; k < 55; k++) { /* root = floor(sqrt(mantissa 2^56)): 53 digits, and two more to round by */
        uint64_t next = k < 27 ? mantissa >> (52 - 2 * k) & 3u : 0u, trial = root << 2 | 1u;
        rest = rest << 2 | next;
        root <<= 1;
        if (rest >= trial) {
            rest -= trial;
            root |= 1u;
        }
    }
    k = (root & 2u) && ((root & 1u) || rest || (root & 4u));
    u.bits = ((uint64_t)(exponent / 2 + 1022) << 52) + (root >> 2) + (uint64_t)k;
    *x = u.number;
}

