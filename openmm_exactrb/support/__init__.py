"""Support functions that do not concern mechanics: checks of arguments, files and the version."""
