// The exact flow of the free rigid body, with the formulas for short steps of openmm_exactrb.rotors.closed_form, but with
// fewer divisions and square roots. A longer step is a sequence of short steps. SIX_NODES and TEN_NODES, in
// nodes.cl, are sums of quadrature rules.

// Adding and then subtracting TO_WHOLE rounds to whole numbers. The sum of RIGHT_ANGLE, NEXT and LAST is pi/2.
#define TO_WHOLE REAL(SINGLE ? 12582912.0 : 6755399441055744.0)
#define RIGHT_ANGLE REAL(SINGLE ? 1.5703125 : 1.5707963267341256)
#define NEXT REAL(SINGLE ? 4.837512969970703e-4 : 6.077100506303966e-11)
#define LAST REAL(SINGLE ? 7.549789948768648e-8 : 2.0222662487959506e-21)
// A transverse component that stands for zero, and the largest angular momentum that counts as zero.
#define SMALLEST REAL(SINGLE ? 1e-18 : 1e-30)
#define LEAST_MOMENTUM REAL(SINGLE ? 1e-16 : 1e-70)

// REALS are numbers of a body or, on processors, vectors with a number of each of several bodies (source/several.h).
#ifndef PROCESSOR
#define REALS fine
#define NUMBERS number
#define ZERO REAL(0.0)
#define ALL_OF(condition) (condition)
#endif

// Return w = sn(v)/c at s = v/c, and write 1-cn(v) and 1-dn(v). A Taylor series is evaluated at s/2, and the argument
// is then doubled.
DEVICE inline REALS jacobi_short(REALS s, REALS x, REALS z, REALS* cn_less, REALS* dn_less) {
    REALS short_s = REAL(0.5)*s, u = short_s*short_s, P = (x+z)*u, Q = (x*z)*(u*u);
    REALS in_P = 1+P*(REAL(-1.0/6)+P*(REAL(1.0/120)+P*(REAL(-1.0/5040)+P*(REAL(1.0/362880)-P*REAL(1.0/39916800)))));
    REALS in_Q = REAL(1.0/10)+P*(REAL(-11.0/420)+P*(REAL(17.0/5040)-P*REAL(461.0/1663200)))+Q*(REAL(1.0/120)-P*REAL(307.0/92400));
    REALS w = short_s*(in_P+Q*in_Q);
    u = w*w;
    REALS xu = x*u, zu = z*u, twice = 2/(1-xu*zu);
    *cn_less = twice*xu*(1-zu);
    *dn_less = twice*zu*(1-xu);
    return twice*w*sqrt((1-xu)*(1-zu));
}

DEVICE inline REALS integrand(REALS u, REALS x, REALS z, REALS b) {
    return b*u/((1+b*u)*sqrt((1-x*u)*(1-z*u)));
}

// The integrand has its nearest singularity at 1/sqrt(s), where s is the largest of x, z and b. With n nodes, the error
// is about b w (s w w/4)^n.
DEVICE inline REALS third_kind_short(REALS w, REALS x, REALS z, REALS b) {
    REALS u = w*w, size = u*fmax(b, fmax(x, z));
    if (ALL_OF(size <= REAL(0.008)))
        return w*SIX_NODES;
    return w*(size <= REAL(0.008) ? SIX_NODES : TEN_NODES);
}

// Compute the cosine and sine by Taylor series after a reduction by multiples of pi/2.
DEVICE inline void cosine_and_sine(REALS angle, REALS* cosine, REALS* sine) {
    REALS turns = (angle*REAL(0.63661977236758134)+TO_WHOLE)-TO_WHOLE;
    REALS r = ((angle-turns*RIGHT_ANGLE)-turns*NEXT)-turns*LAST, u = r*r;
    REALS s = REAL(1.0/362880)+u*(REAL(-1.0/39916800)+u*(REAL(1.0/6227020800.0)+u*(REAL(-1.0/1307674368000.0)+u*REAL(1.0/355687428096000.0))));
    s = r+r*u*(REAL(-1.0/6)+u*(REAL(1.0/120)+u*(REAL(-1.0/5040)+u*s)));
    REALS c = REAL(1.0/40320)+u*(REAL(-1.0/3628800)+u*(REAL(1.0/479001600)+u*(REAL(-1.0/87178291200.0)+u*REAL(1.0/20922789888000.0))));
    c = 1-REAL(0.5)*u+u*u*(REAL(1.0/24)+u*(REAL(-1.0/720)+u*c));
    REALS quadrant = turns-4*((REAL(0.25)*turns+TO_WHOLE)-TO_WHOLE);  // -2, -1, 0, 1 or 2
    REALS first = fabs(quadrant) == REAL(1.0) ? s : c, second = fabs(quadrant) == REAL(1.0) ? c : s;
    *cosine = (fabs(quadrant) == REAL(2.0)) | (quadrant == REAL(1.0)) ? -first : first;
    *sine = (fabs(quadrant) == REAL(2.0)) | (quadrant == REAL(-1.0)) ? -second : second;
}

// Return 1-c for a point (c, s) of the unit circle, from c and the square of s, without cancellation.
DEVICE inline REALS versine(REALS c, REALS square_s) {
    return c > REAL(0.0) ? square_s/(1+c) : 1-c;
}

// Return 1-q.q of a unit quaternion, with an error of 1e-24.
DEVICE inline DOUBLES norm_defect(const NUMBERS* q) {
    DOUBLES squares = ZERO, rest = ZERO;
    EACH(k, 4) {
        const DOUBLES whole = q[k], high = (whole+TO_GRID)-TO_GRID;
        squares += high*high;
        rest += (whole-high)*(whole+high);
    }
    return (1.0-squares)-rest;
}

// Multiply q by the quaternion (1+t0, t1, t2, t3), in place. The result is normalised, and not q itself, which points
// elsewhere after a rotation by a large angle.
DEVICE inline void turn(NUMBERS* q, REALS t0, REALS t1, REALS t2, REALS t3) {
    const REALS q0 = q[0], q1 = q[1], q2 = q[2], q3 = q[3];
    const REALS change[4] = {
        q0*t0-q1*t1-q2*t2-q3*t3, q0*t1+q1*t0+q2*t3-q3*t2, q0*t2-q1*t3+q2*t0+q3*t1, q0*t3+q1*t2-q2*t1+q3*t0};
    if (SINGLE) {  // the change also has an error, so that the norm is that of the result
        DOUBLES moved[4], square = ZERO;
        EACH(k, 4) {
            moved[k] = q[k];
            moved[k] += change[k];
            square += moved[k]*moved[k];
        }
        const DOUBLES defect = 0.5*(1.0-square);
        EACH(k, 4)
            q[k] = moved[k]+moved[k]*defect;
        return;
    }
    const REALS turned[4] = {q0+change[0], q1+change[1], q2+change[2], q3+change[3]};
    const DOUBLES defect = 0.5*norm_defect(q)-TIMES_LOW_PARTS(turned, q);
    EACH(k, 4)
        q[k] += change[k]+turned[k]*defect;
}

// Advance a body by a short step; `G` is |m|. The new length of m is corrected in double precision.
DEVICE inline void rotate_short(REALS t, REALS G, REALS b, REALS rho, REALS sigma, REALS inverse_I3, NUMBERS* q, NUMBERS* m) {
    REALS x1 = m[0], x2 = m[1], x3 = m[2], hG = t*G, flip = x3 < REAL(0.0) ? REAL(-1.0) : REAL(1.0);
    REALS inverse_G = 1/G, y1 = flip*x1*inverse_G, y2 = x2*inverse_G, y3 = flip*x3*inverse_G;
    y2 = (fabs(y1) < SMALLEST) & (fabs(y2) < SMALLEST) ? SMALLEST : y2;
    REALS x = sigma*(y3*y3+rho*y2*y2), transverse = y1*y1+sigma*y2*y2, B = sigma*transverse, z = rho*transverse;
    REALS cn_less, dn_less, cosine, sine, w = jacobi_short(b*hG, x, z, &cn_less, &dn_less);
    REALS cn = 1-cn_less, dn = 1-dn_less;
    cosine_and_sine(REAL(0.5)*(hG*inverse_I3+third_kind_short(w, x, z, B)), &cosine, &sine);

    REALS wy3 = w*y3, cd = cn*dn, rw2 = sigma*wy3*wy3, inverse = 1/(cn*cn+rw2);
    REALS d1 = (y1*(cn*cn_less-rw2)-sigma*wy3*dn*y2)*inverse;
    REALS d2 = (y2*(cn*(cn_less-dn_less)-rw2)+wy3*y1)*inverse;
    REALS d3 = (y3*(cn_less*(1+cn)-dn_less-rw2)-rho*w*cn*y1*y2)*inverse;
    REALS n1 = y1+d1, n2 = y2+d2, n3 = y3+d3, u1 = y1, u2 = y2, v1 = n1, v2 = n2, e1 = d1, e2 = d2;
    if (SINGLE) {  // otherwise fourth powers of small numbers would be zero
        const REALS scale = 1/(fabs(y1)+fabs(y2));
        u1 *= scale; u2 *= scale; v1 *= scale; v2 *= scale; e1 *= scale; e2 *= scale;
    }
    REALS re = u2*u2+u1*(cn*v1+wy3*v2), im = -rho*w*u2*v2, other;
    other = re*cd-im*w; im = re*w+im*cd; re = other;
    REALS across_re = u1*v1+u2*v2, across_im = u2*e1-u1*e2;
    other = re*across_re-im*across_im; im = re*across_im+im*across_re; re = other;
    REALS size = sqrt(re*re+im*im), sum = size+fabs(re), over = 1/sqrt(2*size*sum);  // for half the angle of (re, im)
    REALS larger = sum*over, smaller = fabs(im)*over, sign = im < REAL(0.0) ? REAL(-1.0) : REAL(1.0);
    REALS hc = re < REAL(0.0) ? smaller : larger, hs = re < REAL(0.0) ? sign*larger : sign*smaller;
    REALS c = cosine*hc-sine*hs, e = sine*hc+cosine*hs, less = versine(c, e*e);
    REALS z1 = d1*c-d2*e-(y1*less+y2*e), z2 = d1*e+d2*c-(y2*less-y1*e);
    REALS a0 = 1+y3, a1 = 1+n3, prod = a0*a1, scale = REAL(0.5)/sqrt(prod);
    REALS t2 = -scale*(a0*(z1+y1*less-y2*e)-d3*(y1*c+y2*e));
    REALS t1 = scale*(a0*(z2+y2*less+y1*e)-d3*(y2*c-y1*e));
    REALS t3 = scale*(prod*e+y2*z1-y1*z2);
    REALS along = scale*(prod*c+y1*(y1+z1)+y2*(y2+z2));
    REALS t0 = -versine(along, t1*t1+t2*t2+t3*t3);
    const DOUBLES change[3] = {flip*d1*G, d2*G, flip*d3*G}, before[3] = {m[0], m[1], m[2]};
    const DOUBLES after[3] = {before[0]+change[0], before[1]+change[1], before[2]+change[2]};
    const DOUBLES correction = (change[0]*(before[0]+after[0])+change[1]*(before[1]+after[1])+change[2]*(before[2]+after[2]))
        *(REAL(0.5)*inverse_G*inverse_G);
    EACH(k, 3)
        m[k] += change[k]-after[k]*correction;
    turn(q, t0, flip*t1, t2, flip*t3);
}

// Advance a body by t; `body` contains b, rho, sigma and 1/I3. A long step is divided into short steps, and is therefore
// also exact. A body that rotates too fast has diverged, and its state becomes nan.
DEVICE inline void rotate(fine t, GLOBAL const double* body, number* q, number* m) {
    const fine b = body[0], x1 = m[0], x2 = m[1], x3 = m[2];
    fine G = sqrt(x1*x1+x2*x2+x3*x3), parts = ceil(fabs(b*t)*G*REAL(1.0/SHORT));
    if (G <= LEAST_MOMENTUM || t == 0)
        return;
    if (!(parts <= REAL(MOST_PARTS))) {
        EACH(k, 3)
            q[k] = m[k] = NOT_A_NUMBER;
        return;
    }
    if (parts > 1)
        t /= parts;
    for (int i = 0; i < max(1, (int) parts); i++)
        rotate_short(t, G, b, body[1], body[2], body[3], q, m);
}

// Compute the rotation matrix of a quaternion; `quick_attitude` has the precision of increments.
#define ATTITUDE(type, q, Q) \
    const type w = q[0], x = q[1], y = q[2], z = q[3], xx = x*x, yy = y*y, zz = z*z, xy = x*y, xz = x*z, yz = y*z, wx = w*x, wy = w*y, wz = w*z; \
    Q[0] = 1-2*(yy+zz); Q[1] = 2*(xy-wz); Q[2] = 2*(xz+wy); \
    Q[3] = 2*(xy+wz); Q[4] = 1-2*(xx+zz); Q[5] = 2*(yz-wx); \
    Q[6] = 2*(xz-wy); Q[7] = 2*(yz+wx); Q[8] = 1-2*(xx+yy);

DEVICE inline void attitude(const number* q, double* Q) {
    ATTITUDE(double, q, Q)
}

DEVICE inline void quick_attitude(const number* q, fine* Q) {
    ATTITUDE(fine, q, Q)
}

// Multiply q by the quaternion of a rotation by |v| about v, as in openmm_exactrb.mathematics.quaternions.exponential.
DEVICE inline void turn_by(number* q, const fine* v) {
    REALS square = v[0]*v[0]+v[1]*v[1]+v[2]*v[2], angle = sqrt(square), cosine, sine;
    cosine_and_sine(REAL(0.5)*angle, &cosine, &sine);
    REALS part = angle > REAL(1e-8) ? sine/angle : REAL(0.5);
    turn(q, -versine(cosine, part*part*square), part*v[0], part*v[1], part*v[2]);
}
