"""Vectors of a model's quantities: tuples with arithmetic for each element, on whatever arithmetic the elements have."""

import operator


class Vector(tuple):
    """Elements by number from 0; `+ - * / **` with a vector of the same size, element by element, or with a scalar."""

    __slots__ = ()

    def __neg__(self):
        return Vector(-a for a in self)


def _each(operation, swapped: bool):
    def method(self, other):
        others = other if isinstance(other, tuple | list) else [other] * len(self)
        pairs = zip(others, self, strict=True) if swapped else zip(self, others, strict=True)
        return Vector(operation(a, b) for a, b in pairs)

    return method


for _name in ("add", "sub", "mul", "truediv", "pow"):
    setattr(Vector, f"__{_name}__", _each(getattr(operator, _name), False))
    setattr(Vector, f"__r{_name}__", _each(getattr(operator, _name), True))
