"""No function has more than 60 lines of code or 10 parameters by position, except for kernels."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
TEXTS = {
    str(file.relative_to(ROOT)): file.read_text(encoding="utf-8")
    for folder in ("openmm_exactrb", "tests", "benchmarks")
    for file in (ROOT / folder).rglob("*.py")
    if not {"kernels", "compiled"} & {*file.relative_to(ROOT).parts}
}


def statements(node):
    """Yield all statements of a tree; those within others too."""
    left = [node]
    while left:
        for child in ast.iter_child_nodes(left.pop()):
            if not isinstance(child, ast.expr):
                yield child
                left.append(child)


def lines_of(function):
    """Return how many lines a function has without its docstring."""
    first = function.body[0]
    docstring = first.end_lineno - first.lineno + 1 if ast.get_docstring(function) else 0
    return function.end_lineno - function.lineno + 1 - docstring


def positional(function):
    """Return the parameters that a call may give by position."""
    names = [argument.arg for argument in function.args.posonlyargs + function.args.args]
    return names[1:] if names[:1] in (["self"], ["cls"]) else names


def test_functions_are_short_and_take_few_parameters_by_position():
    functions = [
        (f"{name}: {node.name}", node)
        for name, text in TEXTS.items()
        for node in statements(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    assert not {name: lines for name, function in functions if (lines := lines_of(function)) > 60}
    assert not {name: names for name, function in functions if len(names := positional(function)) > 10}
