"""The exact free rotation as per-DOF statements: `openmm_exactrb.kernels.plain.exact` for steps of b G h <= RANGE.

Either family of orbits has the one form that circles axis 3, and symmetric, spherical and resting bodies are no cases
of their own. The names are those of that module; vectors hold what is three numbers. Velocities, which are shown
after it, lend their place.
"""

from __future__ import annotations

import math

from openmm_exactrb.engines.custom_program.program import Program, turned
from openmm_exactrb.mathematics.elliptic import RULES

#: Up to this b G h the series are exact to roundoff; beyond it the state becomes nan, which OpenMM does not go on from.
RANGE = 0.35

# The squares of the five nodes of Gauss's rule and their weights, as two vectors.
_NODES, _WEIGHTS = ([*map(float, numbers.ravel()), 0.0] for numbers in RULES[1])


def rotate(program: Program, time: str) -> None:
    """Write the rotation of all bodies by a time: new L, q, w and d."""
    _unit_momentum(program, time)
    _elliptic_functions(program)
    _angle(program)
    _new_momentum(program)
    _turn(program)
    _turn_attitude(program)


def _unit_momentum(program: Program, time: str) -> None:
    """Write g = (G, flip, h G) and y, which lies along axis 3 for a body at rest and never exactly on it."""
    speed = f"abs(_x(abc)*{time})*norm"
    program.let(
        "g",
        f"vector(norm,2*step(_z(L))-1,select(step({RANGE}-{speed}),{time}*norm,sqrt({RANGE}-{speed})));"
        "norm=sqrt(dot(L,L))",
    )
    program.let("y", "L*vector(_y(g),1,_y(g))/max(_x(g),1e-100)+vector(0,0,step(1e-90-_x(g)))")
    program.let("y", "y+vector(0,select(step(1e-30-max(abs(_x(y)),abs(_y(y)))),1e-30,0),0)")


def _elliptic_functions(program: Program) -> None:
    """Write a = (x, z, B) and c = (cn, dn, w): the series at half the argument, and one duplication."""
    program.let(
        "a",
        "vector(sigma*(y3*y3+rho*y2*y2),rho*across,sigma*across);across=y1*y1+sigma*y2*y2;"
        "y1=_x(y);y2=_y(y);y3=_z(y);rho=_y(abc);sigma=_z(abc)",
    )
    program.let("c", "vector(half,(_x(a)+_y(a))*half*half,_x(a)*_y(a)*half*half*half*half);half=0.5*_x(abc)*_z(g)")
    in_p = "1+P*(-1/6+P*(1/120+P*(-1/5040+P*(1/362880-P/39916800))))"
    in_q = "1/10+P*(-11/420+P*(17/5040-P*(461/1663200)))+Q*(1/120-P*(307/92400))"
    program.let("c", f"_x(c)*({in_p}+Q*({in_q}));P=_y(c);Q=_z(c)")
    program.let("c", "2*c*sqrt((1-xu)*(1-zu))/(1-xu*zu);xu=_x(a)*c*c;zu=_y(a)*c*c")
    program.let("c", "vector(sqrt(1-_x(a)*c*c),sqrt(1-_y(a)*c*c),c)")


def _angle(program: Program) -> None:
    """Write the angle into a: the integral of the third kind by Gauss's rule."""
    for name, first in (("p", 0), ("v", 3)):
        nodes, weights = (
            "vector({!r},{!r},{!r})".format(*numbers[first : first + 3]) for numbers in (_NODES, _WEIGHTS)
        )
        program.let(
            name,
            f"_z(c)*dot({weights},bs/((1+bs)*sqrt((1-_x(a)*square)*(1-_y(a)*square))));"
            f"bs=_z(a)*square;square=_z(c)*_z(c)*{nodes}",
        )
    program.let("a", "_z(g)*_x(inverse)+p+v")


def _new_momentum(program: Program) -> None:
    """Write the new unit momentum n, by the addition theorem."""
    program.let(
        "n",
        "vector((y1*cn-sigma*wy*y2*dn)*over,(y2*cn*dn+wy*y1)*over,(y3*dn-rho*w1*y1*y2*cn)*over);"
        "over=1/(cn*cn+sigma*wy*wy);wy=w1*y3;cn=_x(c);dn=_y(c);w1=_z(c);y1=_x(y);y2=_y(y);y3=_z(y);"
        "rho=_y(abc);sigma=_z(abc)",
    )


def _turn(program: Program) -> None:
    """Write the quaternion (c, a) of the rotation, around the frame y; p and v hold complex numbers."""
    program.let(
        "p",
        "vector(y2*y2+y1*(cn*_x(n)+w1*_z(y)*_y(n)),-_y(abc)*w1*y2*_y(n),0);cn=_x(c);w1=_z(c);y1=_x(y);y2=_y(y)",
    )
    program.let("p", "vector(_x(p)*cd-_y(p)*w1,_x(p)*w1+_y(p)*cd,0);cd=_x(c)*_y(c);w1=_z(c)")
    program.let("v", "vector(y1*n1+y2*n2,y2*n1-y1*n2,0);y1=_x(y);y2=_y(y);n1=_x(n);n2=_y(n)")
    program.let("p", "vector(_x(p)*_x(v)-_y(p)*_y(v),_x(p)*_y(v)+_y(p)*_x(v),0)")
    # Half the angle of p, as a unit number: devices compute functions of vectors for each component, so there are few.
    program.let(
        "v",
        "vector(select(step(co),root,abs(si)*0.5/root),select(step(co),si*0.5/root,select(step(si),root,-root)),0);"
        "root=sqrt(0.5*(1+abs(co)));co=_x(p)/norm;si=_y(p)/norm;norm=sqrt(_x(p)*_x(p)+_y(p)*_y(p))",
    )
    program.let("p", f"sin(vector(half+{0.5 * math.pi!r},half,0));half=0.5*_x(a)")
    program.let("p", "vector(_x(p)*_x(v)-_y(p)*_y(v),_x(p)*_y(v)+_y(p)*_x(v),0)")
    program.let("v", "vector(_x(n)*_x(p)-_y(n)*_y(p),_x(n)*_y(p)+_y(n)*_x(p),(1+_z(y))*(1+_z(n)))")
    program.let("c", "(_z(v)*_x(p)+_x(y)*_x(v)+_y(y)*_y(v))*0.5/sqrt(_z(v))")
    program.let(
        "a",
        "vector(flip*(a0*_y(v)-a1*(_y(y)*co-_x(y)*si)),-(a0*_x(v)-a1*(_x(y)*co+_y(y)*si)),"
        "flip*(_z(v)*si+_y(y)*_x(v)-_x(y)*_y(v)))*0.5/sqrt(_z(v));"
        "a0=1+_z(y);a1=1+_z(n);co=_x(p);si=_y(p);flip=_y(g)",
    )


def _turn_attitude(program: Program) -> None:
    """Write L with the norm that it had, the orientation with norm one, and d."""
    program.let("n", "_x(g)*n*vector(_y(g),1,_y(g))")
    program.let("L", "n+n*(dot(L-n,L+n)*0.5/max(_x(g)*_x(g),1e-200))")
    program.let("p", "w")
    program.let("v", "q")
    program.let("q", "p*a+c*v+cross(v,a)")
    program.let("w", "p*c-dot(v,a)")
    program.let("p", "0.5*(3-w*w-dot(q,q))")
    program.let("q", "q*p")
    program.let("w", "w*p")
    program.let("d", turned("q", "w", "s"))
