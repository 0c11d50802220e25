/* Division of integers of 128 bits, for libraries that zig makes for Linux: what zig would link in for it brings sin, exp
   and others along, which would take the place of those of libm. */
#if defined(__SIZEOF_INT128__)
typedef unsigned __int128 Wide;

Wide __udivti3(Wide n, Wide d);
Wide __umodti3(Wide n, Wide d);

/* Bit by bit, from where the divisor's first bit stands below the dividend's. */
Wide __udivti3(Wide n, Wide d)
{
    if (!(n >> 64) && !(d >> 64)) return (unsigned long long)n / (unsigned long long)d;
    Wide quotient = 0, bit = 1;
    while (d < n && !(d >> 127)) d <<= 1, bit <<= 1;
    for (; bit; d >>= 1, bit >>= 1)
        if (n >= d) n -= d, quotient |= bit;
    return quotient;
}

Wide __umodti3(Wide n, Wide d) { return n - __udivti3(n, d) * d; }
#endif
