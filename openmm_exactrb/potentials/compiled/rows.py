"""Operations on rows of the mesh as LLVM vector instructions: numba does not vectorise loops of ten iterations."""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

__all__ = ["LANES"]  # numba's intrinsics have no signatures for documentation

#: Numbers per vector register.
LANES = 4

_ROW = ir.VectorType(ir.DoubleType(), LANES)
_FIRST = ir.Constant(ir.IntType(64), 0)
_FUSED = ("contract",)


class _Code:
    """Builder of instructions for rows of `order` numbers, padded to full vectors."""

    zero = ir.Constant(_ROW, [0.0] * LANES)

    def __init__(self, context, builder, order):
        self.context, self.builder = context, builder
        self.vectors = -(-order // LANES)
        self.width = LANES * self.vectors

    def pointer(self, kind, array, at=_FIRST):
        """Return a pointer to element `at` of a flat array of type `kind`."""
        return self.builder.gep(self.context.make_array(kind)(self.context, self.builder, array).data, [at])

    def after(self, pointer, n):
        return self.builder.gep(pointer, [ir.IntType(64)(n)])

    def vector(self, pointer, n):
        """Load vector n from a pointer to numbers."""
        return self.builder.load(self.place(pointer, n), align=8)

    def place(self, pointer, n):
        return self.builder.bitcast(self.after(pointer, LANES * n), _ROW.as_pointer())

    def store(self, vector, pointer, n):
        self.builder.store(vector, self.place(pointer, n), align=8)

    def number(self, pointer, n):
        """Load number n from a pointer, as a vector of equal numbers."""
        return self.spread(self.builder.load(self.after(pointer, n)))

    def spread(self, number):
        first = self.builder.insert_element(ir.Constant(_ROW, ir.Undefined), number, ir.IntType(32)(0))
        mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return self.builder.shuffle_vector(first, ir.Constant(_ROW, ir.Undefined), mask)

    def times(self, a, b):
        return self.builder.fmul(a, b, flags=_FUSED)

    def plus(self, a, b):
        return self.builder.fadd(a, b, flags=_FUSED)


@intrinsic
def spline_rows(typingctx, C, t, scale, w, at, steps):
    """Write a spline and its first two derivatives at t to w[at:], from the coefficients C of their pieces."""
    signature = types.void(C, t, scale, w, at, steps)
    order = steps.count

    def generate(context, builder, signature, values):
        code = _Code(context, builder, order)
        coefficients = code.pointer(signature.args[0], values[0])
        t, scale = map(code.spread, values[1:3])
        w, unit = code.pointer(signature.args[3], values[3], values[4]), None
        for e in range(3):
            for n in range(code.vectors):
                value = code.vector(coefficients, (order * e + e) * code.vectors + n)
                for c in range(e + 1, order):
                    value = code.plus(
                        code.times(value, t), code.vector(coefficients, (order * e + c) * code.vectors + n)
                    )
                code.store(value if unit is None else code.times(value, unit), w, code.vectors * e + n)
            unit = scale if unit is None else code.times(unit, scale)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_plane(typingctx, mesh, at, stride, w, a, b, c, steps):
    """Add (a Y + b Y') Z + c Y Z', with splines w along y and z, to the rows of a plane, starting at mesh[at:]."""
    signature = types.void(mesh, at, stride, w, a, b, c, steps)

    def generate(context, builder, signature, values):
        code = _Code(context, builder, steps.count)
        mesh, at, stride, w, a, b, c, _ = values
        row, w = code.pointer(signature.args[0], mesh, at), code.pointer(signature.args[3], w)
        Y, dY, Z, dZ = (code.after(w, k * code.width) for k in (3, 4, 6, 7))
        Z, dZ = ([code.vector(row, n) for n in range(code.vectors)] for row in (Z, dZ))
        a, b, c = map(code.spread, (a, b, c))
        for k in range(steps.count):
            y = code.number(Y, k)
            along, across = code.times(c, y), code.plus(code.times(a, y), code.times(b, code.number(dY, k)))
            for n in range(code.vectors):
                added = code.plus(code.vector(row, n), code.times(across, Z[n]))
                code.store(code.plus(added, code.times(along, dZ[n])), row, n)
            row = builder.gep(row, [stride])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sum_plane(typingctx, phi, at, stride, w, a, sums, steps):
    """Add plane a of phi, which starts at phi[at:], times the splines w along x and y, summed over y, to `sums`.

    The six rows of `sums` are for the products X Y, X' Y, X Y', X'' Y, X' Y' and X Y''.
    """
    signature = types.void(phi, at, stride, w, a, sums, steps)

    def generate(context, builder, signature, values):
        code = _Code(context, builder, steps.count)
        phi, at, stride, w, a, sums, _ = values
        row, w = code.pointer(signature.args[0], phi, at), code.pointer(signature.args[3], w)
        sums = code.pointer(signature.args[5], sums)
        h = [[code.zero] * code.vectors for _ in range(3)]
        for k in range(steps.count):
            potential = [code.vector(row, n) for n in range(code.vectors)]
            for e in range(3):
                y = code.number(w, (3 + e) * code.width + k)
                h[e] = [code.plus(h[e][n], code.times(y, potential[n])) for n in range(code.vectors)]
            row = builder.gep(row, [stride])
        X = [code.number(builder.gep(w, [a]), e * code.width) for e in range(3)]
        for k, (e, f) in enumerate([(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]):
            for n in range(code.vectors):
                old = code.vector(sums, k * code.vectors + n)
                code.store(code.plus(old, code.times(X[e], h[f][n])), sums, k * code.vectors + n)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_columns(typingctx, columns, at, stride, rows, numbers, first):
    """Add 8 columns of 6 numbers, which start at columns[at], to 8-number rows; numbers[first:] are the row indices."""
    signature = types.void(columns, at, stride, rows, numbers, first)

    def generate(context, builder, signature, values):
        code = _Code(context, builder, 2 * LANES)
        columns, at, stride, rows, numbers, first = values
        wide = ir.VectorType(ir.DoubleType(), 2 * LANES)
        source, rows = code.pointer(signature.args[0], columns, at), code.pointer(signature.args[3], rows)
        numbers = code.pointer(signature.args[4], numbers, first)
        vectors = []
        for _ in range(6):
            vectors.append(builder.load(builder.bitcast(source, wide.as_pointer()), align=8))
            source = builder.gep(source, [stride])
        vectors += 2 * [ir.Constant(wide, 8 * [0.0])]
        for width in (4, 2, 1):  # transpose: exchange blocks with those on the other side of the diagonal
            for k in (k for k in range(8) if not k & width):
                a, b = vectors[k], vectors[k + width]
                for place, offset in ((k, 0), (k + width, width)):
                    mask = [c - width + offset + 8 if c & width else c + offset for c in range(8)]
                    mask = ir.Constant(ir.VectorType(ir.IntType(32), 8), mask)
                    vectors[place] = builder.shuffle_vector(a, b, mask)
        for h, vector in enumerate(vectors):
            number = builder.load(code.after(numbers, h))
            row = builder.bitcast(builder.gep(rows, [builder.mul(number, ir.IntType(64)(8))]), wide.as_pointer())
            builder.store(code.plus(builder.load(row, align=8), vector), row, align=8)
        return context.get_dummy_value()

    return signature, generate
