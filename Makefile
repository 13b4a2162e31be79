# Two commands for a fresh clone: `make run` and `make test`. Both make their own virtual environment.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
# The oldest versions that pyproject.toml allows, in an environment of their own.
LOWEST ?= .venv-lowest
ARGS ?=

.PHONY: run test coverage cuda-check library-check lowest lint docs browse linkcheck validate benchmarks paper dist clean

run: $(VENV)/.run
	$(BIN)/python examples/dipole_fluid.py --compare --overwrite $(ARGS)

test: $(VENV)/.test
	$(BIN)/python -m pytest -n auto --dist worksteal $(ARGS)

# Writes htmlcov/index.html: the lines of Python that the tests execute.
coverage: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".[coverage]"
	$(BIN)/python -m pytest -n auto --dist worksteal --cov --cov-report=html --cov-report=term:skip-covered $(ARGS)

# Compiles all kernels for CUDA, without a GPU.
cuda-check: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".[cuda-check]"
	$(BIN)/python -m pytest -n auto tests/engines/test_cuda.py $(ARGS)

# Compiles the library with sanitizers, and by clang, and runs it.
library-check: $(VENV)/.test
	$(BIN)/python -m pytest --validate tests/engines/test_sanitized.py \
		tests/engines/test_installations.py::test_clang_compiles_the_library $(ARGS)

lowest: $(LOWEST)/.test
	$(LOWEST)/bin/python -m pytest -n auto --dist worksteal -W ignore::DeprecationWarning $(ARGS)

lint: $(VENV)/.lint
	$(BIN)/ruff check
	$(BIN)/ruff check --preview --select PLW1514
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/win32
	$(BIN)/lint-imports
	$(BIN)/python docs/_ext/words.py

docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going --quiet -b html docs docs/_build/html
	$(BIN)/python docs/_ext/pages.py
	@echo "docs/_build/html/index.html"

browse: $(VENV)/.docs
	$(BIN)/python -m pip install --quiet playwright
	$(BIN)/python docs/_ext/browse.py docs/_build/html

linkcheck: $(VENV)/.docs
	$(BIN)/python -m sphinx --quiet -D plot_gallery=0 -b linkcheck docs docs/_build/linkcheck

validate: $(VENV)/.validation
	$(BIN)/python -m pytest -n auto --dist worksteal --validate $(ARGS)

benchmarks: $(VENV)/.test
	$(BIN)/python benchmarks/cost/dipole_cost.py
	$(BIN)/python benchmarks/water/droplet.py
	$(BIN)/python benchmarks/proteins/peptide.py
	$(BIN)/python benchmarks/proteins/protein.py
	$(BIN)/python benchmarks/dipoles/dipole_precision.py
	$(BIN)/python benchmarks/schemes/roundoff.py

paper: $(VENV)/.test
	$(BIN)/python benchmarks/paper/report.py $(ARGS)

dist: $(VENV)/.dist
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist
	$(BIN)/validate-pyproject pyproject.toml
	$(BIN)/cffconvert --validate
	$(BIN)/python -c "from rattler_build import Stage0Recipe as R, VariantConfig; print(R.from_file('packaging/conda/recipe.yaml').render(VariantConfig({'c_stdlib': ['sysroot']})))"

clean:
	rm -rf $(VENV) $(LOWEST) dist out examples/out docs/_build docs/examples htmlcov .coverage

$(VENV)/.python: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	touch $@

$(VENV)/.run: $(VENV)/.python
	$(BIN)/python -m pip install --quiet --editable ".[examples]"
	touch $@

$(VENV)/.test: $(VENV)/.python
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	touch $@

$(VENV)/.validation: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".[validation]"
	touch $@

$(LOWEST)/.test: pyproject.toml constraints/lowest.txt
	$(PYTHON) -m venv $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --editable ".[test]" --constraint constraints/lowest.txt
	touch $@

$(VENV)/.dist: $(VENV)/.python
	$(BIN)/python -m pip install --quiet build cffconvert check-wheel-contents py-rattler-build twine "validate-pyproject[all]"
	touch $@

$(VENV)/.docs: $(VENV)/.python
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	touch $@

$(VENV)/.lint: $(VENV)/.test
	$(BIN)/python -m pip install --quiet --editable ".[lint]"
	touch $@
