"""Support that has nothing to do with mechanics: checks of arguments, files, copies, the version."""
