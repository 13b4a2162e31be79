# Two commands for a fresh clone: `make run` and `make test`. Both make their own virtual environment.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
ARGS ?=

.PHONY: run test lint validate benchmarks clean

run: $(VENV)/.run
	$(BIN)/python examples/dipole_fluid.py --overwrite $(ARGS)

test: $(VENV)/.test
	$(BIN)/python -m pytest -n auto $(ARGS)

lint: $(VENV)/.lint
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

validate: $(VENV)/.test
	$(BIN)/python -m pytest -n auto --validate $(ARGS)

benchmarks: $(VENV)/.test
	$(BIN)/python benchmarks/rotor_cost.py
	$(BIN)/python benchmarks/step_cost.py
	$(BIN)/python benchmarks/water.py
	$(BIN)/python benchmarks/roundoff.py

clean:
	rm -rf $(VENV) out

$(VENV)/.python: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	touch $@

$(VENV)/.run: $(VENV)/.python
	$(BIN)/python -m pip install --quiet --editable ".[plot]"
	touch $@

$(VENV)/.test: $(VENV)/.python
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	touch $@

$(VENV)/.lint: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@
