// Sums of forces in fixed point, like OpenMM's sums, so that the order does not affect the result.

#define LARGEST_FORCE 1e9f
typedef mm_ulong term_sum;
#define OF_SUM(sum) from_fixed((mm_long) (sum))

// Convert to fixed point. In single precision, the whole part and the rest are converted to 32 bits; see `from_fixed`.
DEVICE inline mm_long to_fixed(fine f) {
    if (SINGLE) {
        const fine whole = rint(f);
        return (mm_long) (((mm_ulong) (unsigned int) (int) whole<<32)+2*(mm_long) (int) ((f-whole)*REAL(0.5*FIXED_POINT)));
    }
    return (mm_long) (f*(fine) FIXED_POINT);
}

// Add to a sum in local memory. On CUDA, which has no such instruction for 64 bits, the halves are added with a carry.
DEVICE inline void add_to_sum(fine f, LOCAL_ARG term_sum* sum) {
    const mm_long value = to_fixed(f);
#ifdef __CUDA_ARCH__
    unsigned int* words = (unsigned int*) sum;
    const unsigned int low = (unsigned int) value, before = atomicAdd(words, low);
    atomicAdd(words+1, (unsigned int) ((mm_ulong) value>>32)+(before+low < before ? 1u : 0u));
#else
    ATOMIC_ADD(sum, (mm_ulong) value);
#endif
}

// Add a force to the sum for atom a. If a force is too large for fixed point, the block is marked as broken.
DEVICE inline void add(fine f0, fine f1, fine f2, int a, LOCAL_ARG term_sum* sums, LOCAL_ARG int* broken, int own) {
    if (a >= own)
        return;
    if (!(fabs(f0) < LARGEST_FORCE && fabs(f1) < LARGEST_FORCE && fabs(f2) < LARGEST_FORCE)) {
        *broken = 1;
        return;
    }
    add_to_sum(f0, sums+3*a);
    add_to_sum(f1, sums+3*a+1);
    add_to_sum(f2, sums+3*a+2);
}
