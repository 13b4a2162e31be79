// Numbers of the state, and access to positions and forces of the Context, in single, mixed or double precision. OpenMM moves molecules by box
// vectors. write_position applies this displacement, and read_position undoes it. The place of an atom consists of its
// slot and its numbers of box vectors.

// The type of a number of the state, which on processors has a low part (source/dialect.h), and the product of a
// quaternion `a` with the low parts of q.
typedef double number;
#define TIMES_LOW_PARTS(a, q) 0.0
#define LOW_PARTS 0
// The type of a component of a force.
typedef mm_long component;
#define LOCAL_ARRAY(type, name, size) LOCAL type name[size]
// The workspace of a cluster; on processors, each thread has one workspace for all of its clusters.
#define WORKSPACE(room, place, size) ((room)+(place))
// The ranges of `for` over the indices of a thread, and over those of a block of threads.
#define OF_THREAD(i, n) int i = GLOBAL_ID; i < (n); i += GLOBAL_SIZE
#define OF_GROUP(i, n) int i = GROUP_ID; i < (n); i += GLOBAL_SIZE/LOCAL_SIZE

// Unroll a loop, so that indices are constant and the compiler can keep arrays in registers.
#define EACH(k, n) _Pragma("unroll") for (int k = 0; k < n; k++)

// Return the difference of two numbers of the state, and write the rounding error of the result to `rest`.
DEVICE inline double apart(number a, number b, double* rest) {
    *rest = 0.0;
    return a-b;
}

// Return (d*d-r.r)/2 for a vector r with rounding errors `rest`.
DEVICE inline double half_defect(double d, const double* r, const double* rest) {
    return 0.5*(d*d-(r[0]*r[0]+r[1]*r[1]+r[2]*r[2]));
}

DEVICE inline void cell_of(int4 place, GLOBAL const double* box, double* shift) {
    EACH(k, 3)
        shift[k] = 0.0;
    if ((place.y|place.z|place.w) != 0) {
        EACH(k, 3)
            shift[k] = place.y*box[k]+place.z*box[3+k]+place.w*box[6+k];
    }
}

DEVICE inline void write_position(GLOBAL real4* posq, GLOBAL real4* posqCorrection, int4 place, GLOBAL const double* box,
        double x, double y, double z) {
    double shift[3];
    cell_of(place, box, shift);
    x += shift[0]; y += shift[1]; z += shift[2];
    const real4 high = make_real4((real) x, (real) y, (real) z, posq[place.x].w);
    posq[place.x] = high;
#ifdef USE_MIXED_PRECISION
    posqCorrection[place.x] = make_real4((real) (x-high.x), (real) (y-high.y), (real) (z-high.z), 0);
#endif
}

DEVICE inline void read_position(GLOBAL const real4* posq, GLOBAL const real4* posqCorrection, int4 place,
        GLOBAL const double* box, double* x) {
    double shift[3];
    cell_of(place, box, shift);
    const real4 high = posq[place.x];
    x[0] = high.x-shift[0]; x[1] = high.y-shift[1]; x[2] = high.z-shift[2];
#ifdef USE_MIXED_PRECISION
    const real4 low = posqCorrection[place.x];
    x[0] += low.x; x[1] += low.y; x[2] += low.z;
#endif
}

// Convert a number in fixed point. Conversions of 64 bits are as slow as operations in double precision.
#define FIXED_POINT 4294967296.0
DEVICE inline fine from_fixed(mm_long x) {
    return (fine) (int) (x>>32)+(fine) (unsigned int) x*REAL(1.0/FIXED_POINT);
}

DEVICE inline void read_force(GLOBAL const component* force, int slot, fine* f) {
    EACH(k, 3)
        f[k] = from_fixed(force[slot+k*PADDED_NUM_ATOMS]);
}
