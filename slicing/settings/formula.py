"""Cura's formulas: the forms of Python expression that its files use, evaluated on the syntax tree.

No code of a file is ever executed: a node, name or function that is not listed here is an error.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from slicing.errors import DefinitionError


def _restrict_to_numbers(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """Restrict an operation to numbers, because on text and lists its result could have any length."""

    def operate(left: Any, right: Any) -> Any:
        if not isinstance(left, int | float) or not isinstance(right, int | float):
            raise TypeError(f"{operation.__name__} of {type(left).__name__} and {type(right).__name__}")
        return operation(left, right)

    return operate


_BINARY_OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: _restrict_to_numbers(operator.mul),
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: _restrict_to_numbers(operator.mod),
    ast.Pow: math.pow,  # of floats: a power of integers has no bound
}
_UNARY_OPERATORS: Mapping[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
}
_COMPARISONS: Mapping[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda item, group: item in group,
    ast.NotIn: lambda item, group: item not in group,
}
_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    f.__name__: f for f in (abs, all, any, float, int, len, map, max, min, round, str, sum)
}
_MATH_NAMES = frozenset(
    {"atan", "ceil", "cos", "floor", "log", "log10", "pi", "radians", "degrees", "sin", "sqrt", "tan"}
)


@dataclass(frozen=True, slots=True)
class Formula:
    """An expression of setting names, as a definition or a profile gives it."""

    text: str


@lru_cache(maxsize=4096)
def _parse_expression(text: str) -> ast.expr:
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise DefinitionError(f"Cura's formula {text!r} is not an expression") from None


def evaluate_formula(
    formula: Formula, lookup: Callable[[str], Any], functions: Mapping[str, Callable[..., Any]]
) -> Any:
    """Compute the value of a formula.

    Parameters
    ----------
    formula
        The expression.
    lookup
        Function that returns the value of a setting by its key, or raises KeyError if the key does not exist.
    functions
        Cura's own functions, such as ``extruderValue``, by name.

    Raises
    ------
    DefinitionError
        If the formula contains a form that is not allowed, or cannot be computed.
    """
    try:
        return _Evaluator(lookup, functions).evaluate(_parse_expression(formula.text))
    except (ArithmeticError, TypeError, ValueError) as error:
        raise DefinitionError(f"Cura's formula {formula.text!r} cannot be computed: {error}") from error


@dataclass(frozen=True, slots=True)
class _Evaluator:
    """Evaluator of parsed expressions; see `evaluate_formula` for its attributes."""

    lookup: Callable[[str], Any]
    functions: Mapping[str, Callable[..., Any]]

    def evaluate(self, node: ast.expr) -> Any:
        """Compute the value of a node; raises DefinitionError for a form that is not allowed."""
        match node:
            case ast.Constant(value=constant) if isinstance(constant, bool | int | float | str | None):
                return constant
            case ast.Name(id=name):
                return self._evaluate_name(name)
            case ast.Attribute(value=ast.Name(id="math"), attr=attribute) if attribute in _MATH_NAMES:
                return getattr(math, attribute)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY_OPERATORS:
                return _BINARY_OPERATORS[type(op)](self.evaluate(left), self.evaluate(right))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _UNARY_OPERATORS:
                return _UNARY_OPERATORS[type(op)](self.evaluate(operand))
            case ast.BoolOp(op=op, values=parts):
                return self._evaluate_boolean(isinstance(op, ast.Or), parts)
            case ast.Compare(left=left, ops=ops, comparators=rights) if all(
                type(op) in _COMPARISONS for op in ops
            ):
                return self._evaluate_comparison(left, ops, rights)
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return self.evaluate(body if self.evaluate(test) else orelse)
            case ast.List(elts=items):
                return [self.evaluate(item) for item in items]
            case ast.Tuple(elts=items):
                return tuple(self.evaluate(item) for item in items)
            case ast.Call(func=function, args=arguments, keywords=[]):
                return self._evaluate_call(function, arguments)
        raise DefinitionError(f"{ast.unparse(node)!r} is not allowed in a formula")

    def _evaluate_name(self, name: str) -> Any:
        """Find a function or a setting by its name."""
        if name in self.functions:
            return self.functions[name]
        if name in _FUNCTIONS:
            return _FUNCTIONS[name]
        try:
            return self.lookup(name)
        except KeyError:
            raise DefinitionError(f"no setting is called {name!r}") from None

    def _evaluate_boolean(self, is_or: bool, parts: list[ast.expr]) -> Any:
        """Compute ``a and b`` or ``a or b``: the first part that decides the result, else the last."""
        result = self.evaluate(parts[0])
        for part in parts[1:]:
            if bool(result) == is_or:
                break
            result = self.evaluate(part)
        return result

    def _evaluate_comparison(self, left: ast.expr, ops: list[ast.cmpop], rights: list[ast.expr]) -> bool:
        """Compute a chain of comparisons, like ``a < b <= c``."""
        low = self.evaluate(left)
        for op, right in zip(ops, rights, strict=True):
            high = self.evaluate(right)
            if not _COMPARISONS[type(op)](low, high):
                return False
            low = high
        return True

    def _evaluate_call(self, function: ast.expr, arguments: list[ast.expr]) -> Any:
        """Call a function that is allowed."""
        callee = self.evaluate(function)
        if not callable(callee):
            raise DefinitionError(f"{ast.unparse(function)} is not a function")
        return callee(*(self.evaluate(argument) for argument in arguments))
