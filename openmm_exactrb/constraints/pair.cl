// Free motion of a cluster of two atoms. The vector r between them turns by the angle a = |u|/|r|, where u is the product
// of the time and of the relative velocity across r:
//
//     r -> r cos a + u sin(a)/a,   u -> u cos a - r a sin a.
//
// Devices move pairs as stars (star.cl), so that all threads of a warp execute the same instructions.

// Compute 1-cos a and 1-sin(a)/a from the square of an angle.
DEVICE inline void turned_less(double square, double* cosine_less, double* sine_less) {
    if (square < 0.25) {
        const double s = square;
        *cosine_less = s*(1.0/2-s*(1.0/24-s*(1.0/720-s*(1.0/40320-s*(1.0/3628800-s*(1.0/479001600-s*(1.0/87178291200.0)))))));
        *sine_less = s*(1.0/6-s*(1.0/120-s*(1.0/5040-s*(1.0/362880-s*(1.0/39916800-s*(1.0/6227020800.0-s*(1.0/1307674368000.0)))))));
        return;
    }
    const double angle = sqrt(square), half = sin(0.5*angle);
    *cosine_less = 2.0*half*half;
    *sine_less = 1.0-sin(angle)/angle;
}

// Return the kinetic energy of the velocities of two atoms along the vector r between them, which a projection removes.
DEVICE inline double along_pair(GLOBAL const double* v, const double* r, double weight) {
    const double b = r[0]*(v[0]-v[3])+r[1]*(v[1]-v[4])+r[2]*(v[2]-v[5]);
    return 0.5*b*b*weight;
}

// Advance a pair; the arguments are those of `move_star`.
DEVICE inline void move_pair(double t, GLOBAL const int* cluster, int at, GLOBAL const double* inverse_masses, GLOBAL const double* lengths, bool relaxes,
        GLOBAL const double* before, GLOBAL const double* after, GLOBAL double* heat, LOCAL_ARG number* xs, GLOBAL number* v) {
    const int first = cluster[FIRST_ATOM];
    LOCAL_ARG number* X = xs+3*at;
    GLOBAL number* V = v+3*first;
    const double w[2] = {inverse_masses[first], inverse_masses[first+1]}, over_w = 1.0/(w[0]+w[1]), share[2] = {w[0]*over_w, w[1]*over_w};
    double r[3], rest[3], u[3], v_across[3], along = 0.0, square = 0.0;
    EACH(e, 3) {
        r[e] = apart(X[e], X[3+e], rest+e);
        u[e] = V[e]-V[3+e];
        square += r[e]*r[e];
        along += r[e]*u[e];
    }
    const double over = 1.0/square;
    if (relaxes)
        heat[first] -= along_pair(after+3*first, r, over*over_w)-along_pair(before+3*first, r, over*over_w);
    EACH(e, 3) {
        V[e] -= share[0]*over*along*r[e];
        V[3+e] += share[1]*over*along*r[e];
    }
    if (t == 0.0)
        return;

    // The shift corrects the rounding error of the length; rounding does not change the kinetic energy of u.
    double turns = 0.0, gained = 0.0, along_new = 0.0, energy = 0.0, push[3], cosine_less, sine_less;
    EACH(e, 3) {
        v_across[e] = V[e]-V[3+e];
        u[e] = t*v_across[e];
        turns += u[e]*u[e];
    }
    turns *= over;
    turned_less(turns, &cosine_less, &sine_less);
    // The rounding of 1/t, and that of the shares, whose sum is 1+beyond, are the same in every step. Hence the energy is
    // that of the velocities that result. The effect of `beyond` is less than the rounding of the terms of `gained`.
    const double over_time = 1.0/t, beyond = share[0] < share[1] ? (share[1]-1.0)+share[0] : (share[0]-1.0)+share[1];
    EACH(e, 3) {
        push[e] = over_time*(-cosine_less*u[e]-turns*(1.0-sine_less)*r[e]);
        gained += push[e]*(2.0*v_across[e]+push[e]);
        along_new += push[e]*(v_across[e]+push[e]);
        energy += (v_across[e]+push[e])*(v_across[e]+push[e]);
    }
    const double excess = energy > 0.0 ? (0.5*gained+beyond*along_new)/energy : 0.0, back = over*half_defect(lengths[first+1], r, rest)-cosine_less;
    EACH(e, 3) {
        const double drift = t*(share[1]*V[e]+share[0]*V[3+e]), turn = back*r[e]+(1.0-sine_less)*u[e];
        const double less = excess*(v_across[e]+push[e]);  // most of which would be lost in the rounding of `push`
        X[e] += drift+share[0]*turn;
        X[3+e] += drift-share[1]*turn;
        V[e] += share[0]*push[e];
        V[e] -= share[0]*less;
        V[3+e] -= share[1]*push[e];
        V[3+e] += share[1]*less;
    }
}
