"""Arithmetic: sums, gains and products of signals."""

from ..contract.block import Block
from ..contract.equations import output, requires
from ..contract.variables import Input, Parameter

__all__ = ["Gain", "MatrixGain", "Product", "Sum"]


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

    k has the unit of y over the unit of u, where both are known.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    k = Parameter(1.0, unit=unit / unit_u, doc="gain")
    u = Input(unit=unit_u, doc="input")

    @output(unit=unit, doc="k times the input")
    def y(u, k):
        return k * u


class MatrixGain(Block):
    """y = K u, for vectors u and y.

    K is p x m: u has m elements and y has p, which wires name u[0], y[0]. Zeros of K fix the type: an element of y
    depends only on the elements of u that its row of K holds. All u have one unit, and so have all y.
    """

    unit = Parameter("", structural=True, type="string", doc='unit of y; "": unknown')
    unit_u = Parameter("", structural=True, type="string", doc='unit of u; "": unknown')
    K = Parameter([[1.0]], shape=("p", "m"), zeros=True, unit=unit / unit_u, doc="matrix of gains")
    u = Input(shape=lambda m: m, unit=unit_u, doc="inputs")

    @output(shape=lambda p: p, unit=unit, doc="K times the inputs")
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
