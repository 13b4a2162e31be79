// The type `fine` of increments of the state. The state itself is in double precision. In Contexts in single or mixed precision
// `fine` is float, because OpenMM's forces are not more accurate, and because most GPUs perform at most a 32nd as many
// operations in double precision. What would accumulate is then corrected in double precision: the lengths of angular
// momenta, quaternions and constraints.
#ifndef FINE
#define FINE double
#endif
typedef FINE fine;
#define SINGLE (sizeof(fine) == 4)
// A constant, which would otherwise promote the numbers beside it to double precision, and a number of the state.
#define REAL(x) ((fine) (x))
// Numbers in double precision beside numbers of type REALS; on processors, these are the same.
#define DOUBLES double
#define NOT_A_NUMBER (0.0/0.0)
