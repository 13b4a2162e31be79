// The exact flow of the free rigid body, with the formulas for short steps of openmm_exactrb.kernels.compiled.exact,
// but with fewer divisions and square roots. A longer step is a sequence of short steps. SIX_NODES and TEN_NODES, in
// nodes.cl, are sums of quadrature rules.

// The largest b G t of a short step. A body that needs more than MOST_PARTS short steps has diverged.
#define SHORT 0.3
#define MOST_PARTS 10000.0
// Adding and then subtracting TO_GRID rounds numbers between -1 and 1 to 26 bits; TO_WHOLE rounds to whole numbers.
#define TO_GRID 100663296.0
#define TO_WHOLE 6755399441055744.0

// Return w = sn(v)/c at s = v/c, and write 1-cn(v) and 1-dn(v). A Taylor series is evaluated at s/2, and the argument
// is then doubled.
DEVICE inline double jacobi_short(double s, double x, double z, double* cn_less, double* dn_less) {
    double short_s = 0.5*s, u = short_s*short_s, P = (x+z)*u, Q = (x*z)*(u*u);
    double in_P = 1.0+P*(-1.0/6+P*(1.0/120+P*(-1.0/5040+P*(1.0/362880-P*(1.0/39916800)))));
    double in_Q = 1.0/10+P*(-11.0/420+P*(17.0/5040-P*(461.0/1663200)))+Q*(1.0/120-P*(307.0/92400));
    double w = short_s*(in_P+Q*in_Q);
    u = w*w;
    double xu = x*u, zu = z*u, twice = 2.0/(1.0-xu*zu);
    *cn_less = twice*xu*(1.0-zu);
    *dn_less = twice*zu*(1.0-xu);
    return twice*w*sqrt((1.0-xu)*(1.0-zu));
}

DEVICE inline double integrand(double u, double x, double z, double b) {
    return b*u/((1.0+b*u)*sqrt((1.0-x*u)*(1.0-z*u)));
}

// The integrand has its nearest singularity at 1/sqrt(s), where s is the largest of x, z and b. With n nodes, the error
// is about b w (s w w/4)^n.
DEVICE inline double third_kind_short(double w, double x, double z, double b) {
    double u = w*w;
    return w*(u*fmax(b, fmax(x, z)) <= 0.008 ? SIX_NODES : TEN_NODES);
}

// Compute the cosine and sine by Taylor series after a reduction by multiples of pi/2.
DEVICE inline void cosine_and_sine(double angle, double* cosine, double* sine) {
    double turns = (angle*0.63661977236758134+TO_WHOLE)-TO_WHOLE;
    double r = ((angle-turns*1.5707963267341256)-turns*6.077100506303966e-11)-turns*2.0222662487959506e-21, u = r*r;
    double s = 1.0/362880+u*(-1.0/39916800+u*(1.0/6227020800.0+u*(-1.0/1307674368000.0+u*(1.0/355687428096000.0))));
    s = r+r*u*(-1.0/6+u*(1.0/120+u*(-1.0/5040+u*s)));
    double c = 1.0/40320+u*(-1.0/3628800+u*(1.0/479001600+u*(-1.0/87178291200.0+u*(1.0/20922789888000.0))));
    c = 1.0-0.5*u+u*u*(1.0/24+u*(-1.0/720+u*c));
    double quadrant = turns-4.0*((0.25*turns+TO_WHOLE)-TO_WHOLE);  // -2, -1, 0, 1 or 2
    bool odd = fabs(quadrant) == 1.0, half_turn = fabs(quadrant) == 2.0;
    double first = odd ? s : c, second = odd ? c : s;
    *cosine = half_turn || quadrant == 1.0 ? -first : first;
    *sine = half_turn || quadrant == -1.0 ? -second : second;
}

// Return 1-c for a point (c, s) of the unit circle, from c and the square of s, without cancellation.
DEVICE inline double versine(double c, double square_s) {
    return c > 0.0 ? square_s/(1.0+c) : 1.0-c;
}

// Return 1-q.q of a unit quaternion, with an error of 1e-24.
DEVICE inline double norm_defect(const number* q) {
    double squares = 0.0, rest = 0.0;
    EACH(k, 4) {
        const double whole = q[k], high = (whole+TO_GRID)-TO_GRID;
        squares += high*high;
        rest += (whole-high)*(whole+high);
    }
    return (1.0-squares)-rest;
}

// Multiply q by the quaternion (1+t0, t1, t2, t3), in place. The result is normalised, and not q itself, which points
// elsewhere after a rotation by a large angle.
DEVICE inline void turn(number* q, double t0, double t1, double t2, double t3) {
    const double q0 = q[0], q1 = q[1], q2 = q[2], q3 = q[3];
    const double change[4] = {
        q0*t0-q1*t1-q2*t2-q3*t3, q0*t1+q1*t0+q2*t3-q3*t2, q0*t2-q1*t3+q2*t0+q3*t1, q0*t3+q1*t2-q2*t1+q3*t0};
    const double turned[4] = {q0+change[0], q1+change[1], q2+change[2], q3+change[3]};
    const double defect = 0.5*norm_defect(q)-TIMES_LOW_PARTS(turned, q);
    EACH(k, 4)
        q[k] += change[k]+turned[k]*defect;
}

// Advance a body by a short step; `G` is |m|, and `body` contains b, rho, sigma and 1/I3.
DEVICE inline void rotate_short(double t, double G, GLOBAL const double* body, number* q, number* m) {
    const double b = body[0], rho = body[1], sigma = body[2], inverse_I3 = body[3];
    double x1 = m[0], x2 = m[1], x3 = m[2], hG = t*G, flip = x3 < 0.0 ? -1.0 : 1.0;
    double inverse_G = 1.0/G, y1 = flip*x1*inverse_G, y2 = x2*inverse_G, y3 = flip*x3*inverse_G;
    if (fabs(y1) < 1e-30 && fabs(y2) < 1e-30)
        y2 = 1e-30;
    double x = sigma*(y3*y3+rho*y2*y2), transverse = y1*y1+sigma*y2*y2, B = sigma*transverse, z = rho*transverse;
    double cn_less, dn_less, cosine, sine, w = jacobi_short(b*hG, x, z, &cn_less, &dn_less);
    double cn = 1.0-cn_less, dn = 1.0-dn_less;
    cosine_and_sine(0.5*(hG*inverse_I3+third_kind_short(w, x, z, B)), &cosine, &sine);

    double wy3 = w*y3, cd = cn*dn, rw2 = sigma*wy3*wy3, inverse = 1.0/(cn*cn+rw2);
    double d1 = (y1*(cn*cn_less-rw2)-sigma*wy3*dn*y2)*inverse;
    double d2 = (y2*(cn*(cn_less-dn_less)-rw2)+wy3*y1)*inverse;
    double d3 = (y3*(cn_less*(1.0+cn)-dn_less-rw2)-rho*w*cn*y1*y2)*inverse;
    double n1 = y1+d1, n2 = y2+d2, n3 = y3+d3;
    double re = y2*y2+y1*(cn*n1+wy3*n2), im = -rho*w*y2*n2, other;
    other = re*cd-im*w; im = re*w+im*cd; re = other;
    double across_re = y1*n1+y2*n2, across_im = y2*d1-y1*d2;
    other = re*across_re-im*across_im; im = re*across_im+im*across_re; re = other;
    double size = sqrt(re*re+im*im), sum = size+fabs(re), over = 1.0/sqrt(2.0*size*sum);  // for half the angle of (re, im)
    double larger = sum*over, smaller = fabs(im)*over, sign = im < 0.0 ? -1.0 : 1.0;
    double hc = re < 0.0 ? smaller : larger, hs = re < 0.0 ? sign*larger : sign*smaller;
    double c = cosine*hc-sine*hs, e = sine*hc+cosine*hs, less = versine(c, e*e);
    double z1 = d1*c-d2*e-(y1*less+y2*e), z2 = d1*e+d2*c-(y2*less-y1*e);
    double a0 = 1.0+y3, a1 = 1.0+n3, prod = a0*a1, scale = 0.5/sqrt(prod);
    double t2 = -scale*(a0*(z1+y1*less-y2*e)-d3*(y1*c+y2*e));
    double t1 = scale*(a0*(z2+y2*less+y1*e)-d3*(y2*c-y1*e));
    double t3 = scale*(prod*e+y2*z1-y1*z2);
    double along = scale*(prod*c+y1*(y1+z1)+y2*(y2+z2));
    double t0 = -versine(along, t1*t1+t2*t2+t3*t3);
    d1 = flip*d1*G; d2 = d2*G; d3 = flip*d3*G;
    n1 = x1+d1; n2 = x2+d2; n3 = x3+d3;
    double correction = (d1*(x1+n1)+d2*(x2+n2)+d3*(x3+n3))*(0.5*inverse_G*inverse_G);
    m[0] += d1-n1*correction; m[1] += d2-n2*correction; m[2] += d3-n3*correction;
    turn(q, t0, flip*t1, t2, flip*t3);
}

// Advance a body by t. A long step is divided into short steps, and is therefore also exact. A body that rotates too
// fast has diverged, and its state becomes nan.
DEVICE inline void rotate(double t, GLOBAL const double* body, number* q, number* m) {
    double G = sqrt(m[0]*m[0]+m[1]*m[1]+m[2]*m[2]), parts = ceil(fabs(body[0]*t)*G*(1.0/SHORT));
    if (G <= 1e-70 || t == 0.0)
        return;
    if (!(parts <= MOST_PARTS)) {
        const double nothing = sqrt(-1.0-G*G);
        EACH(k, 3)
            q[k] = m[k] = nothing;
        return;
    }
    if (parts > 1.0)
        t /= parts;
    for (int i = 0; i < (int) fmax(1.0, parts); i++)
        rotate_short(t, G, body, q, m);
}

// Compute the rotation matrix of a quaternion.
DEVICE inline void attitude(const number* q, double* Q) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    Q[0] = 1-2*(y*y+z*z); Q[1] = 2*(x*y-w*z); Q[2] = 2*(x*z+w*y);
    Q[3] = 2*(x*y+w*z); Q[4] = 1-2*(x*x+z*z); Q[5] = 2*(y*z-w*x);
    Q[6] = 2*(x*z-w*y); Q[7] = 2*(y*z+w*x); Q[8] = 1-2*(x*x+y*y);
}

// Multiply q by the quaternion of a rotation by |v| about v, as in openmm_exactrb.mathematics.quaternions.exponential.
DEVICE inline void turn_by(number* q, const double* v) {
    double square = v[0]*v[0]+v[1]*v[1]+v[2]*v[2], angle = sqrt(square);
    double part = angle > 1e-8 ? sin(0.5*angle)/angle : 0.5, cosine = cos(0.5*angle);
    turn(q, -versine(cosine, part*part*square), part*v[0], part*v[1], part*v[2]);
}
