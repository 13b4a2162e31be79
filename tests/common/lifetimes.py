"""What becomes of objects that a test has dropped."""

import gc


def assert_freed_without_the_garbage_collector(dropped):
    """Assert that nothing is left of the objects to which weak references are returned by `dropped`."""
    gc.collect()
    gc.disable()
    try:
        assert not any(reference() for reference in dropped())
    finally:
        gc.enable()
