"""Arithmetic: sums, gains, products and sizes of signals."""

import numpy as np

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Input, Parameter

__all__ = ["DotProduct", "Gain", "MatrixGain", "Norm", "Product", "Sum"]


class Sum(Block):
    """y = +- u1 +- u2 ..., with the signs of `signs`: "+-" is u1 - u2.

    All inputs and y have one unit.
    """

    signs = Parameter("++", structural=True, type="string", doc="a + or - for each input")
    unit = Parameter("", structural=True, type="string", doc='unit of the inputs and of y; "": unknown')
    u = Input(shape=lambda signs: len(signs), ports="u{}", unit=unit, doc="terms")

    @requires("signs must be a text of + and -, one for each input")
    def is_signs(signs):
        return len(signs) > 0 and set(signs) <= {"+", "-"}

    @output(unit=unit, doc="the sum")
    def y(u, signs):
        total = 0.0
        for sign, term in zip(signs, u, strict=True):
            total = total + term if sign == "+" else total - term
        return total


class Gain(Block):
    """y = k u.

    k has the unit of y over the unit of u, if both are known.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    k = Parameter(1.0, unit=unit / unit_u, doc="gain")
    u = Input(unit=unit_u, doc="input")

    @output(unit=unit, doc="k times the input")
    def y(u, k):
        return k * u


class MatrixGain(Block, apart="gain"):
    """y = K u, for vectors u and y.

    K is p x m: u has m elements and y has p, which wires name u[0], y[0]. Zeros of K fix the type: an element of y
    depends only on the elements of u with a nonzero entry in its row of K. All u have one unit, and so have all y.
    Named inputs and outputs are ports of their own, one for each name.

    Give a large K by its edges, {"edges": [[row, column, value], ...], "shape": [p, m]}, by a CSV file of edges, or in
    Python as a matrix of scipy.sparse. The cost is then proportional to the number of edges.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    K = Parameter([[1.0]], shape=("p", "m"), zeros=True, sparse=True, unit=unit / unit_u, doc="matrix of gains")
    inputs = Parameter("", structural=True, type="string", doc='names of the inputs, "F, d"; "": one vector u')
    outputs = Parameter("", structural=True, type="string", doc='names of the outputs, "p, v"; "": one vector y')
    u = Input(shape=lambda m: m, ports=inputs, unit=unit_u, doc="inputs")

    @output(shape=lambda p: p, ports=outputs, unit=unit, doc="K times the inputs")
    def y(u, K):
        return K @ u


class Product(Block):
    """y = u1 u2 ..., or quotients by `operations`: "*/" is u1 / u2.

    The units of the inputs are free. A division by 0 stops the run with an error that names this block.
    """

    operations = Parameter("**", structural=True, type="string", doc="a * or / for each input")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u = Input(shape=lambda operations: len(operations), ports="u{}", doc="factors")

    @requires("operations must be a text of * and /, one for each input")
    def is_operations(operations):
        return len(operations) > 0 and set(operations) <= {"*", "/"}

    @output(unit=unit, doc="the product")
    def y(u, operations):
        product = 1.0
        for operation, factor in zip(operations, u, strict=True):
            product = product * factor if operation == "*" else product / factor
        return product


class DotProduct(Block, apart="dot"):
    """y = the scalar product of two vectors, u1[0] u2[0] + u1[1] u2[1] and so on.

    The units of the inputs are free.
    """

    size = Parameter(2, structural=True, type="int", min=1, doc="number of elements of each vector")
    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    u1 = Input(shape=lambda size: size, doc="vector")
    u2 = Input(shape=lambda size: size, doc="vector")

    @output(unit=unit, doc="scalar product of the inputs")
    def y(u1, u2):
        return u1 @ u2


class Norm(Block, apart="norm"):
    """y = |u|, the norm of a vector.

    kind "2": sqrt(u[0]^2 + u[1]^2 + ...), the length; "1": |u[0]| + |u[1]| + ...; "inf": the largest |u[k]|.

    The slope jumps at u = 0, with "1" also when an element changes its sign, and with "inf" when another element
    becomes the largest. These corners are not located.
    """

    kind = Parameter("2", structural=True, choices=("2", "1", "inf"), doc="norm: Euclidean, sum, maximum")
    size = Parameter(2, structural=True, type="int", min=1, doc="number of elements")
    unit = Parameter("", structural=True, type="string", doc='unit of u and y; "": unknown')
    u = Input(shape=lambda size: size, unit=unit, doc="vector")

    @output(unit=unit, doc="norm of the input")
    def y(u, kind):
        if kind == "2":
            return np.sqrt(u @ u)
        return np.sum(np.abs(u)) if kind == "1" else np.max(np.abs(u))
