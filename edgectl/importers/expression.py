# SPDX-License-Identifier: Apache-2.0
"""Safe evaluation of ``$(eval ..)``: a small subset of Python, with bounds."""

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping
from typing import Any

MAX_LENGTH = 1000
MAX_TEXT = 100_000
_MAX_EXPONENT = 1000
_MAX_NUMBER = 10**30
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.In: lambda left, right: left in right,
    ast.NotIn: lambda left, right: left not in right,
    ast.Is: operator.eq,
    ast.IsNot: operator.ne,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
CONSTANTS: dict[str, Any] = {"pi": math.pi, "e": math.e, "true": True, "false": False}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{each.__name__: each for each in (abs, bool, float, int, len, max, min, round, str)},
    **{name: getattr(math, name) for name in
       ("acos", "asin", "atan", "atan2", "ceil", "cos", "degrees", "exp", "floor", "hypot", "log", "radians",
        "sin", "sqrt", "tan")},
}  # fmt: skip
_METHODS = {"endswith", "lower", "lstrip", "replace", "rstrip", "split", "startswith", "strip", "upper"}


class ExpressionError(Exception):
    """The expression is not of the subset, or has no value."""


def evaluate_expression(
    text: str, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]
) -> Any:  # noqa: ANN401 - a value of the expression's own type
    """The value of ``text``, with ``names`` as variables and ``functions`` besides the built-in ones.

    Raises:
        ExpressionError: it is too long, not an expression, uses anything else, or fails.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"is longer than {MAX_LENGTH} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval")
        return _Evaluation({**CONSTANTS, **names}, {**FUNCTIONS, **functions}).value(tree.body)
    except SyntaxError as error:
        raise ExpressionError(f"is not an expression: {error.msg}") from error
    except ExpressionError:
        raise
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ExpressionError(f"has no value: {error}") from error


class _Evaluation:
    """One evaluation: a method per kind of node. Everything else is refused."""

    def __init__(self, names: Mapping[str, Any], functions: Mapping[str, Callable[..., Any]]) -> None:
        self.names, self.functions = names, functions

    def value(self, node: ast.expr) -> Any:  # noqa: ANN401
        handler = getattr(self, f"read_{type(node).__name__.lower()}", None)
        if handler is None:
            raise ExpressionError(f"{type(node).__name__} is not supported")
        return _check_size(handler(node))

    def read_constant(self, node: ast.Constant) -> Any:  # noqa: ANN401
        return node.value

    def read_name(self, node: ast.Name) -> Any:  # noqa: ANN401
        if node.id not in self.names:
            raise ExpressionError(f"{node.id} is not known")
        return self.names[node.id]

    def read_list(self, node: ast.List) -> Any:  # noqa: ANN401
        return [self.value(each) for each in node.elts]

    def read_tuple(self, node: ast.Tuple) -> Any:  # noqa: ANN401
        return tuple(self.value(each) for each in node.elts)

    def read_boolop(self, node: ast.BoolOp) -> Any:  # noqa: ANN401
        result: Any = None
        for each in node.values:
            result = self.value(each)
            if bool(result) != isinstance(node.op, ast.And):
                break
        return result

    def read_unaryop(self, node: ast.UnaryOp) -> Any:  # noqa: ANN401
        if type(node.op) not in _UNARY:
            raise ExpressionError("the operator ~ is not supported")
        return _UNARY[type(node.op)](self.value(node.operand))

    def read_binop(self, node: ast.BinOp) -> Any:  # noqa: ANN401
        if type(node.op) not in _BINARY:
            raise ExpressionError("an operator in it is not supported")
        left, right = self.value(node.left), self.value(node.right)
        if isinstance(node.op, ast.Pow) and abs(right) > _MAX_EXPONENT:
            raise ExpressionError(f"an exponent is above {_MAX_EXPONENT}")
        if isinstance(node.op, ast.Mod) and isinstance(left, str):
            raise ExpressionError("formatting with % is not supported")
        if isinstance(node.op, ast.Mult) and not all(isinstance(each, int | float) for each in (left, right)):
            raise ExpressionError("only numbers can be multiplied")
        return _BINARY[type(node.op)](left, right)

    def read_compare(self, node: ast.Compare) -> Any:  # noqa: ANN401
        left = self.value(node.left)
        for kind, operand in zip(node.ops, node.comparators, strict=True):
            right = self.value(operand)
            if not _COMPARE[type(kind)](left, right):
                return False
            left = right
        return True

    def read_ifexp(self, node: ast.IfExp) -> Any:  # noqa: ANN401
        return self.value(node.body if self.value(node.test) else node.orelse)

    def read_subscript(self, node: ast.Subscript) -> Any:  # noqa: ANN401
        if isinstance(node.slice, ast.Slice):
            raise ExpressionError("Slice is not supported")
        return self.value(node.value)[self.value(node.slice)]

    def read_call(self, node: ast.Call) -> Any:  # noqa: ANN401
        if node.keywords:
            raise ExpressionError("keyword arguments are not supported")
        words = [self.value(each) for each in node.args]
        if isinstance(node.func, ast.Attribute):
            target = self.value(node.func.value)
            if not isinstance(target, str) or node.func.attr not in _METHODS:
                raise ExpressionError(f"the method {node.func.attr} is not supported")
            if node.func.attr == "replace" and len(target) > MAX_LENGTH:
                raise ExpressionError("a text in it is too long")
            return getattr(target, node.func.attr)(*words)
        if not isinstance(node.func, ast.Name) or node.func.id not in self.functions:
            raise ExpressionError(f"the function {ast.unparse(node.func)} is not supported")
        return self.functions[node.func.id](*words)


def _check_size(value: Any) -> Any:  # noqa: ANN401
    """Refuse values that no launch file needs: they would only take time and memory."""
    too_long = isinstance(value, str | list | tuple) and len(value) > MAX_TEXT
    if too_long or (isinstance(value, int) and abs(value) > _MAX_NUMBER):
        raise ExpressionError("a value in it is too large")
    return value
