// Forces of bonds, angles, torsions, maps of two torsions and pairs of atoms within a block of clusters, with the
// formulas of openmm_exactrb.multiple_time_steps.bonded_forces, and of custom forces. Numbers have the type SCALAR, which is
// `fine`, or double where float is not accurate enough. If `fine` is float, `split` contains for each position the nearest
// float and the rest, so that differences of positions have a relative error of float. On processors, a thread evaluates
// AT_ONCE terms at once, and NUMERIC is a vector with a number of each (LANE).
//
// Tables are stored column by column: number k of term t is numbers[k*count+t]. The atoms of a term are given by their
// indices in the block. A block adds forces only to its own atoms, the first `own` of these indices. A term that
// involves atoms of several blocks has a copy in each of these blocks.

#ifndef PROCESSOR // source/several.h
#define AT_ONCE 1
#define LANE(x, l) (x)
#define FINES fine
#define EXACTS double
typedef int Atoms;
#define atoms_of(column, t, last) (column)[t]
#define numbers_of(column, t, last) (column)[t]
#define strengths_of(column, t, last) (column)[t]
#define POSITIONS LOCAL_ARG const number* xs, LOCAL_ARG const fine* split
#define EXACT_DISTANCE(a, b, e) (xs[3*(a)+e]-xs[3*(b)+e])
#define REST (3*PLACES_OF_BLOCK)
#define DISTANCE(a, b, e) (SINGLE ? (split[3*(a)+e]-split[3*(b)+e])+(split[REST+3*(a)+e]-split[REST+3*(b)+e]) : (fine) EXACT_DISTANCE(a, b, e))
#define DERIVATIVE(kind, v) derivative_of_##kind(force, v, numbers+t, terms.count, parameters)
#define ADD(a, f, u) add((f)*u##0, (f)*u##1, (f)*u##2, a, sums, broken, own);
#define ADD_TWO(a, f, u, b, g, v) ADD(a, f, u) ADD(b, g, v)
#define ADD_THREE(a, f, u, b, g, v, c, h, w) ADD(a, f, u) ADD(b, g, v) ADD(c, h, w)
#define ADD_FOUR(a, f, u, b, g, v, c, h, w, d, i, x) ADD(a, f, u) ADD(b, g, v) ADD(c, h, w) ADD(d, i, x)
#endif
#define ATOM(k) atoms_of(terms_of+(k)*terms.count, t, terms.last)
#define NUMBER(k) numbers_of(numbers+(k)*terms.count, t, terms.last)
#define STRENGTH(k) strengths_of(numbers+(k)*terms.count, t, terms.last) // zero beyond the last term
#define EACH_TERM for (int t = terms.first; t < terms.last; t += AT_ONCE*LOCAL_SIZE)
#define IN_BLOCK POSITIONS, LOCAL_ARG term_sum* sums, LOCAL_ARG int* broken, int own, Terms terms, GLOBAL const int* terms_of, \
    GLOBAL const SCALAR* numbers
#define SCALAR fine
#define NUMERIC FINES
#define BETWEEN DISTANCE

// Return the terms of a kind that a thread evaluates, of those from `first` to `last` - 1 of a block. The first term goes to
// the thread after the one that has the last term of the previous kind, so that all threads have a similar number of terms.
DEVICE inline Terms terms_of_kind(int first, int last, int count, int* before) {
    const Terms terms = {first+(int) (LOCAL_ID+LOCAL_SIZE-*before)%(int) LOCAL_SIZE, last, count};
    *before = (*before+last-first)%(int) LOCAL_SIZE;
    return terms;
}

#define DIFFERENCE(u, a, b) const NUMERIC u##0 = BETWEEN(a, b, 0), u##1 = BETWEEN(a, b, 1), u##2 = BETWEEN(a, b, 2)
#define DOT(u, v) (u##0*v##0+u##1*v##1+u##2*v##2)
#define CROSS(w, u, v) const NUMERIC w##0 = u##1*v##2-u##2*v##1, w##1 = u##2*v##0-u##0*v##2, w##2 = u##0*v##1-u##1*v##0

// Numbers: length, square of the length rounded to `fine`, rounding error of this square, strength.
DEVICE inline void add_bonds(IN_BLOCK) {
    EACH_TERM {
        const Atoms a = ATOM(0), b = ATOM(1);
        const EXACTS d0 = EXACT_DISTANCE(a, b, 0), d1 = EXACT_DISTANCE(a, b, 1), d2 = EXACT_DISTANCE(a, b, 2), square = d0*d0+d1*d1+d2*d2;
        const FINES u0 = (FINES) d0, u1 = (FINES) d1, u2 = (FINES) d2, r = sqrt((FINES) square), length = NUMBER(0);
        FINES f = -STRENGTH(3)*(FINES) (square-(EXACTS) NUMBER(1)-(EXACTS) NUMBER(2))/((r+length)*r);
        EACH(l, AT_ONCE)
            if (LANE(r, l) == 0) // a bond of zero length has no direction
                LANE(f, l) = 0;
        ADD_TWO(a, f, u, b, -f, u)
    }
}

// Return the angle of the point (x, y), by a polynomial if it is small. The largest error of the polynomial is 7e-18 of the angle.
DEVICE inline FINES angle_of(FINES y, FINES x) {
    const FINES z = y/x, u = z*z, v = u*u;  // even and odd powers of u
    const FINES even = (fine) -0.333333333333333291+v*((fine) -0.14285714284398276+v*((fine) -0.0909090372625419416
        +v*((fine) -0.0666424051322612547+v*((fine) -0.0507347593184631205+v*(fine) -0.0187649224736799086))));
    const FINES odd = (fine) 0.19999999999994216+v*((fine) 0.111111109939878484+v*((fine) 0.0769216368130412972
        +v*((fine) 0.0585582834767944345+v*(fine) 0.0388905503026414422)));
    FINES angle = z+z*u*(even+u*odd);
    EACH(l, AT_ONCE)
        if (!(fabs(LANE(y, l)) <= (fine) 0.42f*LANE(x, l)))
            LANE(angle, l) = atan2(LANE(y, l), LANE(x, l));
    return angle;
}

// Compute the cosine and sine of an angle, times the lengths of both sides, and the forces on its three atoms for -dV/d(angle) = f.
#define ANGLE(a, b, c) \
    DIFFERENCE(u, a, b); \
    DIFFERENCE(v, c, b); \
    CROSS(n, u, v); \
    const NUMERIC cosine = DOT(u, v); \
    NUMERIC sine = sqrt(DOT(n, n));
#define ADD_ANGLE(a, b, c, f) \
    CROSS(p, u, n); \
    CROSS(q, n, v); \
    const NUMERIC g = (f)/(sine*DOT(u, u)), h = (f)/(sine*DOT(v, v)); \
    const NUMERIC m0 = g*p0+h*q0, m1 = g*p1+h*q1, m2 = g*p2+h*q2; \
    ADD_THREE(a, g, p, c, h, q, b, -1, m)

// Numbers: cosine and sine of the angle, strength.
DEVICE inline void add_angles(IN_BLOCK) {
    EACH_TERM {
        const Atoms a = ATOM(0), b = ATOM(1), c = ATOM(2);
        ANGLE(a, b, c)
        EACH(l, AT_ONCE)
            LANE(sine, l) = fmax(LANE(sine, l), (fine) 1e-12f);
        const FINES f = STRENGTH(2)*angle_of(NUMBER(1)*cosine-NUMBER(0)*sine, NUMBER(0)*cosine+NUMBER(1)*sine);
        ADD_ANGLE(a, b, c, f)
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
#define ADD_TORSION(i, j, k, l, f) ADD_FOUR(i, (f)*first, a, j, (f), m, k, -(f), o, l, (f)*last, b)

// Numbers: the coefficients of all cosines, then those of all sines.
DEVICE inline void add_torsions(IN_BLOCK) {
    EACH_TERM {
        const Atoms i = ATOM(0), j = ATOM(1), k = ATOM(2), l = ATOM(3);
        TORSION(i, j, k, l)
        FINES cn = cosine, sn = sine, f = 0*cosine;
        for (int n = 0; n < HARMONICS; n++) {
            f += (n+1)*(STRENGTH(n)*sn-STRENGTH(HARMONICS+n)*cn);
            const FINES next = cn*cosine-sn*sine;
            sn = sn*cosine+cn*sine;
            cn = next;
        }
        ADD_TORSION(i, j, k, l, f)
    }
}

// Numbers: angle, strength, and the period of the angle in OpenMM's formula.
DEVICE inline void add_impropers(IN_BLOCK) {
    EACH_TERM {
        const Atoms i = ATOM(0), j = ATOM(1), k = ATOM(2), l = ATOM(3);
        TORSION(i, j, k, l)
        const FINES middle = NUMBER(0), period = NUMBER(2);
        FINES away = cosine;
        EACH(m, AT_ONCE) {
            const fine angle = atan2(LANE(sine, m), LANE(cosine, m))-LANE(middle, m);
            LANE(away, m) = angle-LANE(period, m)*rint(angle/LANE(period, m));
        }
        const FINES f = -2*STRENGTH(1)*away;
        ADD_TORSION(i, j, k, l, f)
    }
}

// Numbers: product of charges times Coulomb's constant, sigma, epsilon.
DEVICE inline void add_pairs(IN_BLOCK) {
    EACH_TERM {
        const Atoms a = ATOM(0), b = ATOM(1);
        DIFFERENCE(u, a, b);
        const FINES over = 1/DOT(u, u), ratio = NUMBER(1)*NUMBER(1)*over, s = ratio*ratio*ratio;
        const FINES f = (STRENGTH(0)*sqrt(over)+STRENGTH(2)*(48*s-24)*s)*over;
        ADD_TWO(a, f, u, b, -f, u)
    }
}

// Float is not accurate enough for every expression of a custom force, nor for the position within a patch of a map.
#undef SCALAR
#undef NUMERIC
#undef BETWEEN
#define SCALAR double
#define NUMERIC EXACTS
#define BETWEEN EXACT_DISTANCE

// Custom forces: the energy is an expression of the distance, the angle or the torsion, with DERIVATIVE as its derivative.
#define OF_CUSTOM int force, GLOBAL const int* customs, GLOBAL const double* values, GLOBAL const double* parameters

DEVICE inline void add_custom_bonds(IN_BLOCK, OF_CUSTOM) {
    EACH_TERM {
        const Atoms a = ATOM(0), b = ATOM(1);
        DIFFERENCE(u, a, b);
        const EXACTS r = sqrt(DOT(u, u));
        EXACTS f = -DERIVATIVE(bond, r)/r;
        EACH(l, AT_ONCE)
            if (LANE(r, l) == 0) // without a direction
                LANE(f, l) = 0;
        ADD_TWO(a, f, u, b, -f, u)
    }
}

DEVICE inline void add_custom_angles(IN_BLOCK, OF_CUSTOM) {
    EACH_TERM {
        const Atoms a = ATOM(0), b = ATOM(1), c = ATOM(2);
        ANGLE(a, b, c)
        EXACTS angle = sine;
        EACH(l, AT_ONCE) {
            LANE(angle, l) = atan2(LANE(sine, l), LANE(cosine, l));
            LANE(sine, l) = fmax(LANE(sine, l), 1e-12);
        }
        const EXACTS f = -DERIVATIVE(angle, angle);
        ADD_ANGLE(a, b, c, f)
    }
}

DEVICE inline void add_custom_torsions(IN_BLOCK, OF_CUSTOM) {
    EACH_TERM {
        const Atoms i = ATOM(0), j = ATOM(1), k = ATOM(2), l = ATOM(3);
        TORSION(i, j, k, l)
        EXACTS angle = cosine;
        EACH(m, AT_ONCE)
            LANE(angle, m) = atan2(LANE(sine, m), LANE(cosine, m));
        const EXACTS f = -DERIVATIVE(torsion, angle);
        ADD_TORSION(i, j, k, l, f)
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

// Maps are evaluated one at a time.
#undef NUMERIC
#undef ATOM
#define NUMERIC double
#define ATOM(k) terms_of[(k)*terms.count+t]

// Integers: the atoms of both torsions, the first patch, and the patches per direction. Maps have no numbers other than
// the coefficients of their patches.
DEVICE inline void add_maps(IN_BLOCK, GLOBAL const double* patches) {
    for (int t = terms.first; t < terms.last; t += LOCAL_SIZE) {
        const int size = ATOM(9);
        double cosines[2], sines[2], u, v, energy = 0, of_u = 0, of_v = 0;
        int s, other;
        for (int n = 0; n < 2; n++) {
            const int i = ATOM(4*n), j = ATOM(4*n+1), k = ATOM(4*n+2), l = ATOM(4*n+3);
            TORSION(i, j, k, l)
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
            const int i = ATOM(4*n), j = ATOM(4*n+1), k = ATOM(4*n+2), l = ATOM(4*n+3);
            TORSION(i, j, k, l)
            ADD_TORSION(i, j, k, l, n ? -of_v : -of_u)
        }
    }
}
