// Forces of bonds, angles, torsions, maps of two torsions and pairs of atoms within a block of clusters, with the
// formulas of openmm_exactrb.kernels.compiled.bonded. Differences of positions are computed in double precision, and
// all further numbers in the type NUMERIC, which is `fine` (float or double), or double where float is not accurate
// enough.
//
// Tables are stored column by column: number k of term t is numbers[k*count+t]. The atoms of a term are given by their
// indices in the block. A block adds forces only to its own atoms, the first `own` of these indices. A term that
// involves atoms of several blocks has a copy in each of these blocks.

typedef struct { int first, last, count; } Terms; // first term of a thread, end of its block, terms of all blocks

#define ATOM(k) terms_of[(k)*terms.count+t]
#define NUMBER(k) numbers[(k)*terms.count+t]
#define EACH_TERM for (int t = terms.first; t < terms.last; t += LOCAL_SIZE)
#define IN_BLOCK LOCAL_ARG const number* xs, LOCAL_ARG term_sum* sums, LOCAL_ARG int* broken, int own, Terms terms, GLOBAL const int* terms_of, \
    GLOBAL const NUMERIC* numbers
#define NUMERIC fine

// Return the terms of a kind that a thread evaluates. The first term goes to the thread after the one that has the last
// term of the previous kind, so that all threads have a similar number of terms.
DEVICE inline Terms terms_of_kind(GLOBAL const int* row, int kind, int count, int* before) {
    const int first = row[FIRST_TERMS+2*kind], last = row[FIRST_TERMS+2*kind+1];
    const Terms terms = {first+(int) (LOCAL_ID+LOCAL_SIZE-*before)%(int) LOCAL_SIZE, last, count};
    *before = (*before+last-first)%(int) LOCAL_SIZE;
    return terms;
}

#define DIFFERENCE(u, a, b) const NUMERIC u##0 = (NUMERIC) (xs[3*(a)]-xs[3*(b)]), u##1 = (NUMERIC) (xs[3*(a)+1]-xs[3*(b)+1]), \
    u##2 = (NUMERIC) (xs[3*(a)+2]-xs[3*(b)+2])
#define DOT(u, v) (u##0*v##0+u##1*v##1+u##2*v##2)
#define CROSS(w, u, v) const NUMERIC w##0 = u##1*v##2-u##2*v##1, w##1 = u##2*v##0-u##0*v##2, w##2 = u##0*v##1-u##1*v##0
#define ADD(a, f, u) add((f)*u##0, (f)*u##1, (f)*u##2, a, sums, broken, own)

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

// Numbers: length, square of the length rounded to `fine`, rounding error of this square, strength.
DEVICE inline void add_bonds(IN_BLOCK) {
    EACH_TERM {
        const int a = ATOM(0), b = ATOM(1);
        const double d0 = xs[3*a]-xs[3*b], d1 = xs[3*a+1]-xs[3*b+1], d2 = xs[3*a+2]-xs[3*b+2], square = d0*d0+d1*d1+d2*d2;
        const fine u0 = (fine) d0, u1 = (fine) d1, u2 = (fine) d2, r = sqrt((fine) square), length = NUMBER(0);
        if (r == 0) // a bond of zero length has no direction
            continue;
        const fine stretch = (fine) (square-(double) NUMBER(1)-(double) NUMBER(2))/(r+length), f = -NUMBER(3)*stretch/r;
        ADD(a, f, u);
        ADD(b, -f, u);
    }
}

// Return the angle of the point (x, y), by a polynomial if it is small. The largest error of the polynomial is 7e-18 of the angle.
DEVICE inline fine angle_of(fine y, fine x) {
    if (!(fabs(y) <= (fine) 0.42f*x))
        return atan2(y, x);
    const fine z = y/x, u = z*z, v = u*u;  // even and odd powers of u
    const fine even = (fine) -0.333333333333333291+v*((fine) -0.14285714284398276+v*((fine) -0.0909090372625419416
        +v*((fine) -0.0666424051322612547+v*((fine) -0.0507347593184631205+v*(fine) -0.0187649224736799086))));
    const fine odd = (fine) 0.19999999999994216+v*((fine) 0.111111109939878484+v*((fine) 0.0769216368130412972
        +v*((fine) 0.0585582834767944345+v*(fine) 0.0388905503026414422)));
    return z+z*u*(even+u*odd);
}

// Numbers: cosine and sine of the angle, strength.
DEVICE inline void add_angles(IN_BLOCK) {
    EACH_TERM {
        const int a = ATOM(0), b = ATOM(1), c = ATOM(2);
        DIFFERENCE(u, a, b);
        DIFFERENCE(v, c, b);
        CROSS(n, u, v);
        const fine sine = fmax(sqrt(DOT(n, n)), (fine) 1e-12f), cosine = DOT(u, v);
        const fine f = NUMBER(2)*angle_of(NUMBER(1)*cosine-NUMBER(0)*sine, NUMBER(0)*cosine+NUMBER(1)*sine);
        CROSS(p, u, n);
        CROSS(q, n, v);
        const fine g = f/(sine*DOT(u, u)), h = f/(sine*DOT(v, v));
        const fine m0 = g*p0+h*q0, m1 = g*p1+h*q1, m2 = g*p2+h*q2;
        ADD(a, g, p);
        ADD(c, h, q);
        ADD(b, (fine) -1, m);
    }
}

// Compute the cosine and sine of a torsion, and the forces on its four atoms for -dV/dphi = 1.
#define TORSION(i, j, k, l) \
    DIFFERENCE(d, i, j); \
    DIFFERENCE(e, j, k); \
    DIFFERENCE(z, l, k); \
    CROSS(a, d, e); \
    CROSS(b, z, e); \
    CROSS(ba, b, a); \
    const NUMERIC over_aa = 1/DOT(a, a), over_bb = 1/DOT(b, b), g = sqrt(DOT(e, e)), over_g = 1/g, scale = sqrt(over_aa*over_bb); \
    const NUMERIC cosine = scale*DOT(a, b), sine = scale*over_g*DOT(ba, e); \
    const NUMERIC first = -g*over_aa, last = g*over_bb, p = DOT(d, e)*over_aa*over_g, q = -DOT(z, e)*over_bb*over_g; \
    const NUMERIC h0 = p*a0+q*b0, h1 = p*a1+q*b1, h2 = p*a2+q*b2; \
    const NUMERIC m0 = h0-first*a0, m1 = h1-first*a1, m2 = h2-first*a2, o0 = h0+last*b0, o1 = h1+last*b1, o2 = h2+last*b2;
#define ADD_TORSION(i, j, k, l, f) \
    ADD(i, (f)*first, a); \
    ADD(j, (f), m); \
    ADD(k, -(f), o); \
    ADD(l, (f)*last, b);

// Numbers: the coefficients of all cosines, then those of all sines.
DEVICE inline void add_torsions(IN_BLOCK) {
    EACH_TERM {
        const int i = ATOM(0), j = ATOM(1), k = ATOM(2), l = ATOM(3);
        TORSION(i, j, k, l)
        fine cn = cosine, sn = sine, f = 0;
        for (int n = 0; n < HARMONICS; n++) {
            f += (n+1)*(NUMBER(n)*sn-NUMBER(HARMONICS+n)*cn);
            const fine next = cn*cosine-sn*sine;
            sn = sn*cosine+cn*sine;
            cn = next;
        }
        ADD_TORSION(i, j, k, l, f)
    }
}

// Numbers: angle, strength, and the period of the angle in OpenMM's formula.
DEVICE inline void add_impropers(IN_BLOCK) {
    EACH_TERM {
        const int i = ATOM(0), j = ATOM(1), k = ATOM(2), l = ATOM(3);
        TORSION(i, j, k, l)
        const fine away = atan2(sine, cosine)-NUMBER(0), f = -2*NUMBER(1)*(away-NUMBER(2)*rint(away/NUMBER(2)));
        ADD_TORSION(i, j, k, l, f)
    }
}

// Float is not accurate enough for twelfth powers and for the position within a patch of a map.
#undef NUMERIC
#define NUMERIC double

// Numbers: product of charges times Coulomb's constant, sigma, epsilon.
DEVICE inline void add_pairs(IN_BLOCK) {
    EACH_TERM {
        const int a = ATOM(0), b = ATOM(1);
        DIFFERENCE(u, a, b);
        const double over = 1/DOT(u, u), ratio = NUMBER(1)*NUMBER(1)*over, s = ratio*ratio*ratio;
        const double f = (NUMBER(0)*sqrt(over)+NUMBER(2)*(48*s-24)*s)*over;
        ADD(a, f, u);
        ADD(b, -f, u);
    }
}

#define CIRCLE 6.283185307179586

// Find which of `size` parts of the circle contains an angle, and the position within this part; nan is in part 0.
DEVICE inline void find_patch(double cosine, double sine, int size, int* part, double* within) {
    double angle = atan2(sine, cosine);
    angle = angle < 0 ? angle+CIRCLE : angle;
    *part = max(0, min((int) (angle*(size/CIRCLE)), size-1));
    *within = angle-*part*(CIRCLE/size);
}

// Integers: the atoms of both torsions, the first patch, and the patches per direction. Maps have no numbers other than
// the coefficients of their patches.
DEVICE inline void add_maps(IN_BLOCK, GLOBAL const double* patches) {
    EACH_TERM {
        const int size = ATOM(9);
        double cosines[2], sines[2], u, v, energy = 0, of_u = 0, of_v = 0;
        int s, other;
        for (int n = 0; n < 2; n++) {
            TORSION(ATOM(4*n), ATOM(4*n+1), ATOM(4*n+2), ATOM(4*n+3))
            cosines[n] = cosine;
            sines[n] = sine;
        }
        find_patch(cosines[0], sines[0], size, &s, &u);
        find_patch(cosines[1], sines[1], size, &other, &v);
        GLOBAL const double* patch = patches+16*(ATOM(8)+s*size+other);
        for (int k = 0; k < 4; k++) {
            double row = 0, slope = 0;
            for (int l = 0; l < 4; l++) {
                slope = slope*v+row;
                row = row*v+patch[4*k+l];
            }
            of_u = of_u*u+energy;
            energy = energy*u+row;
            of_v = of_v*u+slope;
        }
        for (int n = 0; n < 2; n++) {
            TORSION(ATOM(4*n), ATOM(4*n+1), ATOM(4*n+2), ATOM(4*n+3))
            ADD_TORSION(ATOM(4*n), ATOM(4*n+1), ATOM(4*n+2), ATOM(4*n+3), n ? -of_v : -of_u)
        }
    }
}
