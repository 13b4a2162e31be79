"""Measurements of the project, a folder for each question: README.md lists them."""
