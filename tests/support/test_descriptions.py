"""Which description belongs to a flow."""

from typing import ClassVar

from hypothesis import given
from hypothesis import strategies as st

from openmm_exactrb.support.descriptions import mismatch


@given(st.lists(st.tuples(st.booleans(), st.booleans(), st.booleans()), min_size=1, max_size=6), st.booleans())
def test_a_description_belongs_to_the_flow_that_was_last_defined_with_or_before_it(classes, of_its_own):
    """Going down the classes, each flow outdates the description, and each description describes the present flow."""

    class Base:
        symbol: ClassVar[str] = "?"

        def flow(self):
            pass

        def description(self):
            pass

    kind, valid = Base, True
    for flow, description, mixed_in in classes:
        methods = {name: lambda self: None for name, has in (("flow", flow), ("description", description)) if has}
        bases = (type("Mixin", (), methods), kind) if mixed_in else (kind,)
        kind = type("Derived", bases, {} if mixed_in else methods)
        valid = description or (valid and not flow)
    thing = kind()
    if of_its_own:
        object.__setattr__(thing, "flow", lambda: None)
        valid = False
    assert (mismatch(thing, "description", "flow") is None) == valid
