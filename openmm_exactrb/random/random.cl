// Counter-based random numbers for a body, a step and a stream: Philox4x64-10 (J. K. Salmon and others, SC11) and the
// Box-Muller transform, with the same numbers as in openmm_exactrb.random.rng.

#if defined(PROCESSOR)
#elif defined(__OPENCL_VERSION__)
#define HIGH_PRODUCT(a, b) mul_hi(a, b)
#else
#define HIGH_PRODUCT(a, b) __umul64hi(a, b)
#endif

DEVICE inline void philox(mm_ulong key, mm_ulong* c) {
    mm_ulong k0 = key, k1 = 0;
    for (int i = 0; i < PHILOX_ROUNDS; i++) {
        const mm_ulong m0 = PHILOX_FIRST, m1 = PHILOX_THIRD;
        const mm_ulong high0 = HIGH_PRODUCT(m0, c[0]), high1 = HIGH_PRODUCT(m1, c[2]);
        const mm_ulong c1 = c[1], c3 = c[3];
        c[1] = m1*c[2];
        c[3] = m0*c[0];
        c[0] = high1^c1^k0;
        c[2] = high0^c3^k1;
        k0 += PHILOX_KEY;
        k1 += PHILOX_SECOND_KEY;
    }
}

// Return a number in the open interval (0, 1), or in (0, 1] in single precision.
DEVICE inline fine uniform(mm_ulong word) {
    if (SINGLE)
        return ((fine) (unsigned int) (word>>32)+((fine) (unsigned int) word+REAL(0.5))*REAL(1.0/4294967296.0))*REAL(1.0/4294967296.0);
    return ((double) (word>>11)+0.5)*(1.0/9007199254740992.0);
}

// Draw four normal random numbers for a key, a step, a stream (16 times the number of a substep, plus the purpose) and
// a body. In single precision, angles are between -pi and pi, where fast sines and cosines are most accurate.
DEVICE inline void normals(mm_long key, mm_long step, int stream, int body, fine* n) {
    mm_ulong c[4] = {(mm_ulong) body+1, 0, (mm_ulong) stream, (mm_ulong) step};
    philox((mm_ulong) key, c);
    for (int i = 0; i < 2; i++) {
        const fine size = sqrt(fmax(-2*log(uniform(c[2*i])), REAL(0.0))), r = SINGLE ? -size : size;
        const fine angle = REAL(6.283185307179586477)*(uniform(c[2*i+1])-(SINGLE ? REAL(0.5) : REAL(0.0)));
        n[2*i] = r*cos(angle);
        n[2*i+1] = r*sin(angle);
    }
}
