"""Support functions that do not concern mechanics: checks of arguments, files, copies and the version."""
