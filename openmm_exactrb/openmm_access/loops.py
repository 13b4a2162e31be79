"""Loops that call functions of OpenMM's C interface, and thus read the parameters of its objects one by one."""

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from openmm_exactrb.kernels.build import at_first_call

_WORD, _WHOLE = ir.IntType(64), ir.IntType(32)


@intrinsic
def _write(typing, function, source, n, count, targets):
    """Call ``void function(source, n, *targets[:count])``, where all arguments except n are addresses."""

    def code(context, builder, signature, arguments):
        address, *others = arguments[:3]
        own = others[0], builder.trunc(others[1], _WHOLE)
        pointers = cgutils.unpack_tuple(builder, arguments[4])
        for many in range(1, len(pointers) + 1):  # one compiled loop for all functions
            kind = ir.FunctionType(ir.VoidType(), [_WORD, _WHOLE, *([_WORD] * many)])
            with builder.if_then(builder.icmp_signed("==", arguments[3], _WORD(many))):
                builder.call(builder.inttoptr(address, kind.as_pointer()), [*own, *pointers[:many]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64, targets), code


@intrinsic
def _value(typing, function, source, n):
    """Return the result of ``double function(source, n)``."""

    def code(context, builder, signature, arguments):
        kind = ir.FunctionType(ir.DoubleType(), [_WORD, _WHOLE])
        address = builder.inttoptr(arguments[0], kind.as_pointer())
        return builder.call(address, [arguments[1], builder.trunc(arguments[2], _WHOLE)])

    return types.float64(types.int64, types.int64, types.int64), code


@at_first_call
def values(function, source, out):
    """Write the results of ``double function(source, n)`` for all n to `out`."""
    for n in range(len(out)):
        out[n] = _value(function, source, n)


@at_first_call
def rows(function, source, count, targets, whole, real, particles, numbers):
    """Call ``void function(source, n, *targets[:count])`` for all n; copy its results `whole` and `real` to rows."""
    for n in range(len(particles)):
        _write(function, source, n, count, targets)
        particles[n] = whole
        numbers[n] = real


@at_first_call
def rows_of_arrays(function, element, array, source, count, targets, whole, particles, numbers):
    """Like `rows`, but read numbers by ``double element(array, k)`` from the last target, an OpenMM_DoubleArray."""
    for n in range(len(particles)):
        _write(function, source, n, count, targets)
        particles[n] = whole
        for k in range(numbers.shape[1]):
            numbers[n, k] = _value(element, array, k)
