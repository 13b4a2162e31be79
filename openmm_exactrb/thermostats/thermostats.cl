// The factors by which a heat exchange multiplies momenta of translation and of rotation, from the kinetic energies in
// `totals`. The numbers of the exchange are tau, kT, the relaxation time or the frequency, the degrees of freedom of
// translation and of rotation, and whether both have a common factor. A single thread computes the factors.

#define FACTORS GLOBAL const double* totals, GLOBAL double* factors, GLOBAL double* own, GLOBAL const int* moves, \
    GLOBAL const double* numbers, int row, mm_long step, double key

// All kernels below, from which those for processors are found by their names.
#define EACH_THERMOSTAT(OF) OF(rescaling) OF(nose_hoover)

#ifdef RESCALING
// Draw a gamma variate, as openmm_exactrb.random.rng does: G. Marsaglia and W. W. Tsang (2000),
// doi:10.1145/358407.358414.
DEVICE inline double gamma_variate(mm_long key, mm_long step, int stream, double shape) {
    if (shape <= 0.0)
        return 0.0;
    const double d = (shape < 1.0 ? shape+1.0 : shape)-1.0/3.0, width = 1.0/sqrt(9.0*d);
    for (int attempt = 1; ; attempt++) {
        mm_ulong c[4] = {(mm_ulong) attempt, 1, (mm_ulong) stream, (mm_ulong) step};
        philox((mm_ulong) key, c);
        const double x = sqrt(-2.0*log(uniform(c[0])))*cos(6.283185307179586477*uniform(c[1])), root = 1.0+width*x, v = root*root*root;
        if (root > 0.0 && log(uniform(c[2])) < 0.5*x*x+d*(1.0-v+log(v)))
            return shape < 1.0 ? d*v*pow(uniform(c[3]), 1.0/shape) : d*v;
    }
}

// Return the factor of momenta with f degrees of freedom, by the rule of openmm_exactrb.thermostats.rescaling.
DEVICE inline double scaling(double kinetic, double f, double kT, double elapsed, mm_long key, mm_long step, int stream) {
    if (kinetic == 0.0 || f == 0.0 || elapsed == 0.0)
        return 1.0;
    double n[4];
    normals(key, step, stream, 0, n);
    const double across = 2.0*gamma_variate(key, step, stream, 0.5*(f-1.0)), noise = -expm1(-elapsed)*kT/(2.0*kinetic);
    const double first = exp(-0.5*elapsed)+sqrt(noise)*n[0], size = sqrt(first*first+noise*across);
    return first < 0.0 ? -size : size;
}

KERNEL void rescaling(FACTORS) {
    if (GLOBAL_ID != 0)
        return;
    GLOBAL const double* of = numbers+moves[4*row+2];
    const int stream = 16*(moves[4*row+1] & 0xffff);
    const mm_long now = step+(moves[4*row+1]>>16);
    const double kT = of[1], elapsed = of[0]/of[2];
    double a, b;
    if (of[5] != 0.0)
        a = b = scaling(totals[0]+totals[1], of[3]+of[4], kT, elapsed, (mm_long) key, now, stream);
    else {
        a = scaling(totals[0], of[3], kT, elapsed, (mm_long) key, now, stream);
        b = scaling(totals[1], of[4], kT, elapsed, (mm_long) key, now, stream+1);
    }
    factors[0] = a;
    factors[1] = b;
    own[0] += (a-1.0)*(a+1.0)*totals[0]+(b-1.0)*(b+1.0)*totals[1]; // heat
}
#endif

#ifdef CHAIN
// Advance a Nose-Hoover chain of CHAIN links by tau, and return the factor of the momenta, with the formulas of
// openmm_exactrb.thermostats.nose_hoover. The coordinates start at x, and the velocities at x+CHAIN.
DEVICE inline double chain(GLOBAL double* x, double kinetic, double f, double kT, double frequency, double tau) {
    const double weights[] = {WEIGHTS};
    GLOBAL double* v = x+CHAIN;
    const double square = frequency*frequency, ratio = 2.0*kinetic/(f*kT);
    double scale = 1.0;
    if (f == 0.0)
        return scale;
    for (int part = 0; part < REPETITIONS*N_WEIGHTS; part++) {
        const double h = weights[part%N_WEIGHTS]*tau/REPETITIONS;
        for (int pass = 0; pass < 2; pass++) {
            for (int k = 0; k < CHAIN; k++) {
                const int link = pass ? k : CHAIN-1-k;
                const double below = link == 1 ? f : 1.0;
                const double pull = link ? below*v[link-1]*v[link-1]-square : square*(ratio*scale*scale-1.0);
                const double drag = link == CHAIN-1 ? 1.0 : exp(-0.25*h*v[link+1]);
                v[link] = (v[link]*drag+0.5*h*pull)*drag;
            }
            if (pass == 0) {
                scale *= exp(-h*v[0]);
                for (int k = 0; k < CHAIN; k++)
                    x[k] += h*v[k];
            }
        }
    }
    return scale;
}

KERNEL void nose_hoover(FACTORS) {
    if (GLOBAL_ID != 0)
        return;
    GLOBAL const double* of = numbers+moves[4*row+2];
    if (of[5] != 0.0)
        factors[0] = factors[1] = chain(own, totals[0]+totals[1], of[3]+of[4], of[1], of[2], of[0]);
    else {
        factors[0] = chain(own, totals[0], of[3], of[1], of[2], of[0]);
        factors[1] = chain(own+2*CHAIN, totals[1], of[4], of[1], of[2], of[0]);
    }
}
#endif
